"""CSV with a header: `,` `;` or tab; cells may be empty, text, or lists (`[0.1, 0.2]`)."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import check_size
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, Window, first_line, in_window, no_samples, refuse_more
from realsim.gap.recordings.tables import cells, odd_cell, table

MAX_BYTES = 2 * 2**30
MAX_NAME = 60
"""Bytes of a column's name; a first line of longer ones is prose."""
BLOCK = 50_000
"""Rows that are text at the same time."""


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in (".csv", ".tsv", ".txt", ".log"):
        return False
    head = first_line(path)
    cells = head.split(max((b",", b";", b"\t"), key=head.count))
    return b"\0" not in head and len(cells) > 1 and max(map(len, cells)) <= MAX_NAME


def read(path: Path, window: Window) -> list[Recording]:
    check_size(path, MAX_BYTES)
    notes: list[str] = []
    try:
        with path.open(encoding="utf-8-sig", newline="", errors="strict") as file:
            columns, dropped, odd = _columns(path, file, notes)
    except UnicodeDecodeError as error:
        raise GapError("not a text file", file=path, expected="UTF-8 text", found=str(error)) from error
    except csv.Error as error:
        raise GapError("a row cannot be read", file=path, found=str(error)) from error
    if not columns and dropped:
        raise GapError("no column holds numbers", file=path, found=f"text in {', '.join(dropped[:8])}",
                       hint="write decimal points, not commas")  # fmt: skip
    if not columns:
        raise no_samples(path, "a header and one row per sample")
    columns = trimmed(columns, window)
    notes += [f"{path.name}: columns of text left out: {', '.join(dropped[:8])}"] if dropped else []
    notes += [f"{path.name}: {n} has values that are no numbers, the first is {c!r}" for n, c in odd.items()]
    return [Recording(path, path.stem, "csv", (table(path, "", columns),), notes=tuple(notes))]


def trimmed(columns: dict[str, F64], window: Window) -> dict[str, F64]:
    """The rows of a window, by the first column that is a clock in s (`Window` asks for one)."""
    if window.whole:
        return columns
    from realsim.gap.recordings.names import is_clock, seconds_of

    name = next((n for n, v in columns.items() if is_clock(n) and v.ndim == 1), None)
    if name is None:
        raise GapError("a time window is requested, but the table has no time", found=", ".join(list(columns)[:12]))
    keep = in_window(seconds_of(name, columns[name])[0], window)
    return {n: v[keep] for n, v in columns.items()}


def _columns(path: Path, lines: Iterator[str], notes: list[str]) -> tuple[dict[str, F64], list[str], dict[str, str]]:
    """(columns of numbers, names of the others, columns with a cell that is no number and that cell).

    In blocks of rows, so that no more than one block is text.
    """
    head = next(lines, "")
    delimiter = max(",;\t", key=head.count)
    header = [h.strip() for h in next(csv.reader([head.lstrip("# ")], delimiter=delimiter))]
    if len(set(header)) < len(header):
        raise GapError("the header names a column twice", file=path, found=", ".join(sorted(header))[:200])
    if sum(_number(h) for h in header) > len(header) / 2:
        raise GapError("the file has no header", file=path, expected="names of the columns in the first line")
    parts: dict[str, list[F64]] = {name: [] for name in header}
    block: list[list[str]] = []
    dropped: list[str] = []
    odd: dict[str, str] = {}
    read, size = 1, 0
    for row in csv.reader(lines, delimiter=delimiter):
        read += 1
        if not row:
            continue
        if len(row) < len(header) and next(lines, None) is None:
            notes.append(f"{path.name}: the last row is cut off: it is left out")
            break
        if len(row) != len(header):
            raise GapError(
                "a row has the wrong number of cells", file=path, expected=f"{len(header)}, as in the header",
                found=f"{len(row)} in row {read}",
                hint="put lists in quotation marks; write decimal points, not commas",
            )  # fmt: skip
        block.append(row)
        if len(block) == BLOCK:
            size += _take(path, header, block, parts, dropped, odd)
            refuse_more(path, size)
            block = []
    if block:
        _take(path, header, block, parts, dropped, odd)
    whole = {n: np.concatenate(p) for n, p in parts.items() if p and n not in dropped}
    return whole, [n for n in dropped if n], {n: c for n, c in odd.items() if n in whole}


def _take(
    path: Path,
    header: list[str],
    block: list[list[str]],
    parts: dict[str, list[F64]],
    dropped: list[str],
    odd: dict[str, str],
) -> int:
    size = 0
    for i, name in enumerate(header):
        if not name or name in dropped:  # a column without a name is a table's index
            continue
        column = cells(path, name, [row[i] for row in block])
        if column is None or (parts[name] and column.ndim != parts[name][0].ndim):
            if parts[name] and all(not row[i].strip() for row in block):
                column = np.full((len(block), *parts[name][0].shape[1:]), np.nan)  # nothing more was logged
            else:
                dropped.append(name)
                continue
        if name not in odd and (cell := odd_cell([row[i] for row in block], column)) is not None:
            odd[name] = cell
        parts[name].append(column)
        size += column.size
    return size


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


READER = Reader("csv", "a .csv, .tsv, .txt or .log file whose first line names the columns", recognise, read)
