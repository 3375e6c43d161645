"""Tables of text: `,` `;` tab or blanks between cells; cells may be empty, text, lists (`[0.1, 0.2]`) or times of day.

Lines before the header, a line of units below it, and a header that is missing are told by where the numbers begin.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import check_size
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples, refuse_more
from realsim.gap.recordings.tables import cells, is_number, odd_cell, table
from realsim.gap.recordings.vocabulary import split_unit

MAX_BYTES = 2 * 2**30
BLOCK = 50_000
"""Rows that are text at the same time."""
PREAMBLE = 60
"""Lines in which the numbers must begin."""
SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".dat")
ENCODINGS = ("utf-8-sig", "cp1252")
_BLANKS = re.compile(r"(?:^#)?[ ]+")


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in SUFFIXES:
        return False
    lines = _head(path)
    if path.suffix.lower() == ".csv" and any(max(map(line.count, ",;\t")) for line in lines):
        return True
    return _begin(lines)[1] < len(lines)


def read(path: Path, window: Window) -> list[Recording]:
    check_size(path, MAX_BYTES)
    for encoding in ENCODINGS:
        notes: list[str] = []
        try:
            with path.open(encoding=_encoding(path) or encoding, newline="", errors="strict") as file:
                columns, dropped, odd = _columns(path, file, notes)
            break
        except UnicodeError as error:
            if encoding == ENCODINGS[-1] or b"\0" in path.open("rb").read(4096):
                raise GapError("not a text file", file=path, expected="UTF-8 text", found=str(error)) from error
        except csv.Error as error:
            raise GapError("a row cannot be read", file=path, found=str(error)) from error
    if not columns and dropped:
        raise GapError("no column holds numbers", file=path, found=f"text in {', '.join(dropped[:8])}")
    if not columns:
        raise no_samples(path, "a header and one row per sample")
    notes += [f"columns of text left out: {', '.join(dropped[:8])}"] if dropped else []
    notes += [f"{path.name}: {n} has values that are no numbers, the first is {c!r}" for n, c in odd.items()]
    return [Recording(path, path.stem, "csv", (table(path, "", columns, window=window),), notes=tuple(notes))]


def _encoding(path: Path) -> str:
    """UTF-16 by its mark, as Excel writes it; else nothing."""
    with path.open("rb") as file:
        return "utf-16" if file.read(2) in (b"\xff\xfe", b"\xfe\xff") else ""


def _head(path: Path) -> list[str]:
    """The first lines of a text file; none of a binary one."""
    with path.open("rb") as file:
        data = file.read(65536)
    marked = _encoding(path)
    if not marked and b"\0" in data:
        return []
    return data.decode(marked or "cp1252", errors="replace").splitlines()[:PREAMBLE]


def _begin(lines: list[str]) -> tuple[str, int]:
    """(what parts the cells, the first line of numbers); the number of lines where none is."""
    for k, line in enumerate(lines):
        for delimiter in (*sorted(",;\t", key=line.count, reverse=True), " "):
            found = _split(line, delimiter)
            filled = [c for c in found if c.strip()]
            if len(filled) > 1 and sum(map(is_number, filled)) >= max(2, 0.5 * len(filled)):
                return delimiter, k
    return max(",;\t", key=lines[0].count) if lines else ",", len(lines)


def _split(line: str, delimiter: str) -> list[str]:
    return next(csv.reader([_BLANKS.sub(" ", line.strip()) if delimiter == " " else line], delimiter=delimiter), [])


def _columns(path: Path, lines: Iterator[str], notes: list[str]) -> tuple[dict[str, F64], list[str], dict[str, str]]:
    """(columns of numbers, names of the others, columns with a cell that is no number and that cell).

    In blocks of rows, so that no more than one block is text.
    """
    head = [line for _, line in zip(range(PREAMBLE), lines, strict=False)]
    delimiter, first = _begin(head)
    first = 1 if first == len(head) else first
    lines = chain(head[first:], lines)
    if delimiter == " ":
        lines = (_BLANKS.sub(" ", line.strip()) for line in lines)
    header = _header(path, head[:first], delimiter, len(_split(head[first], delimiter)) if first < len(head) else 0)
    if not head[:first] or header[0] == "column_1":
        notes.append(f"there is no header: the columns are called column_1 to column_{len(header)}")
    parts: dict[str, list[F64]] = {name: [] for name in header}
    block: list[list[str]] = []
    dropped: list[str] = []
    odd: dict[str, str] = {}
    read, size = first, 0
    for row in csv.reader(lines, delimiter=delimiter):
        read += 1
        if not row or row == [""]:
            continue
        if len(row) < len(header) and next(lines, None) is None:
            notes.append(f"{path.name}: the last row is cut off: it is left out")
            break
        if len(row) != len(header):
            raise GapError(
                "a row has the wrong number of cells", file=path, expected=f"{len(header)}, as in the header",
                found=f"{len(row)} in row {read}",
                hint="put lists in quotation marks; write decimal points where commas part the cells",
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


def _header(path: Path, above: list[str], delimiter: str, width: int) -> list[str]:
    """Names of the columns from the lines above the numbers: the last of as many cells, with a line of units."""
    rows = [_split(line.lstrip("# "), delimiter) for line in above]
    rows = [[c.strip() for c in row] for row in rows if len(row) == width or not width]
    if not rows:
        return [f"column_{k + 1}" for k in range(width)]
    header = rows[-1]
    units = [split_unit(f"x [{c.strip('[]()')}]")[1] for c in header]
    if len(rows) > 1 and all(u or not c or c in ("-", "[-]") for u, c in zip(units, header, strict=True)):
        header = [f"{name} [{unit}]" if unit else name for name, unit in zip(rows[-2], units, strict=True)]
    twice = sorted({h for h in header if h and header.count(h) > 1})
    if twice:
        raise GapError("the header names a column twice", file=path, found=", ".join(twice)[:200],
                       hint="give each column a name of its own in the first line")  # fmt: skip
    return header


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


READER = Reader("csv", "a .csv, .tsv, .txt, .dat or .log table", recognise, read)
