"""What a board prints on its serial port, `t:20 goal:0.1,0.2 q:0.1,0.2`: names beside their numbers in each line.

Other lines (greetings, warnings, one cut off at the start) lie between them.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from realsim.core.text_table import first_lines
from realsim.core.types import F64
from realsim.gap.recordings.readers.csvfile import SUFFIXES
from realsim.gap.recordings.recording import Reader, Recording, Window, refuse_more
from realsim.gap.recordings.tables import table

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PAIR = re.compile(rf"([A-Za-z_](?:[\w./ ]|\[[\w./ ]*\])*?)\s*[:=]\s*({_NUMBER}(?:,{_NUMBER})*)(?=[\s,;]|$)")
LEAST_LINES = 5


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in SUFFIXES:
        return False
    found = Counter(filter(None, map(_layout, first_lines(path))))
    return max(found.values(), default=0) >= LEAST_LINES


def read(path: Path, window: Window) -> list[Recording]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = [line for line in file if line.strip()]
    layouts = list(map(_layout, lines))
    (usual, count), *_ = Counter(filter(None, layouts)).most_common()
    refuse_more(path, count * sum(width for _, width in usual))
    kept = [_pairs(line) for line, layout in zip(lines, layouts, strict=True) if layout == usual]
    columns: dict[str, F64] = {}
    for k, (name, width) in enumerate(usual):
        values = np.array([[float(v) for v in pairs[k][1].split(",")] for pairs in kept])
        columns[name] = values[:, 0] if width == 1 else values
    left = len(lines) - count
    notes = (f"{path.name}: {left} lines without {', '.join(n for n, _ in usual)} are left out",) if left else ()
    return [Recording(path, path.stem, "plotter", (table(path, "", columns, window=window),), notes=notes)]


def _pairs(line: str) -> list[tuple[str, str]]:
    return _PAIR.findall(line.strip())


def _layout(line: str) -> tuple[tuple[str, int], ...]:
    """(name, how many numbers) of all that a line holds beside words; () for a line with other numbers."""
    pairs = _pairs(line)
    names = [n for n, _ in pairs]
    if len(pairs) < 2 or len(set(names)) < len(names) or re.search(r"\d", _PAIR.sub("", line)):
        return ()
    return tuple((n, v.count(",") + 1) for n, v in pairs)


READER = Reader("plotter", "lines of names and numbers from a serial port (.txt, .log)", recognise, read)
