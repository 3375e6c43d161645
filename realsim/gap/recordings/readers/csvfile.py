"""Tables of text, however their cells are parted (`realsim.core.text_table`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.text_table import begin, first_lines, read_text_table
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples, refuse_more
from realsim.gap.recordings.tables import table
from realsim.gap.recordings.vocabulary import split_unit

SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".dat")


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in SUFFIXES:
        return False
    lines = first_lines(path)
    if path.suffix.lower() == ".csv" and any(max(map(line.count, ",;\t")) for line in lines):
        return True
    return begin(lines)[1] < len(lines)


def read(path: Path, window: Window) -> list[Recording]:
    found = read_text_table(path, lambda cell: split_unit(f"x [{cell}]")[1], lambda size: refuse_more(path, size))
    columns = {n: v for n, v in found.columns.items() if np.isfinite(v).any()}
    dropped = [n for n in found.parts if n and n not in columns]
    if not columns and dropped:
        raise GapError("no column holds numbers", file=path, found=f"text in {', '.join(dropped[:8])}")
    if not columns:
        raise no_samples(path, "a header and one row per sample")
    notes = [*found.notes, *([f"columns of text left out: {', '.join(dropped[:8])}"] if dropped else [])]
    odd = {n: cell for n, (cell, _) in found.odd.items() if n in columns}
    notes += [f"{path.name}: {n} has values that are no numbers, the first is {c!r}" for n, c in odd.items()]
    return [Recording(path, path.stem, "csv", (table(path, "", columns, window=window),), notes=tuple(notes))]


READER = Reader("csv", "a .csv, .tsv, .txt, .dat or .log table", recognise, read)
