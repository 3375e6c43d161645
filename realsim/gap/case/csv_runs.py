"""Runs as .csv files: a header, a row a sample, and a map from the contract's arrays to columns.

The map is `columns` of log.json, or columns.json beside it:

    {"time": {"column": "stamp", "unit": "us"},
     "command": {"columns": ["q1_des", "q2_des"], "unit": "deg"},
     "joint_pos": ["q1", {"column": "q2", "unit": "deg", "sign": -1}]}

A column may hold lists ("[0.1, 0.2]"): its name stands for all items, NAME[0] for the first.
Without a map, columns are found by exact name: `time`, `command_ACTUATOR`, `joint_pos_JOINT`, `base_pos_x`, ...
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, did_you_mean
from realsim.core.files import read_text
from realsim.core.types import F64
from realsim.gap.case.units import factor

MAX_BYTES = 512 * 2**20
DELIMITERS = ",;\t"
_ENTRY = ("column", "unit", "sign")
_SHARED = ("columns", "unit", "sign")


def read_csv(
    path: Path, columns: Mapping[str, Any] | None, names: Mapping[str, Sequence[str]], command_kind: str
) -> dict[str, F64]:
    """Arrays of a .csv run in the contract's units; time is (T,), all others (T, K).

    Args:
        columns: the map, or None to find columns by exact name.
        names: array -> the names of its columns in the contract (joints, actuators, axes).

    Raises:
        GapError: for a column that is not in the file (the closest ones are named), or a cell that is no number.
    """
    header, table = _table(path)
    wanted = _from_map(path, columns, names, header) if columns is not None else _by_name(header, names)
    found = {}
    for array, entries in wanted.items():
        parts = []
        for entry in entries:
            scale = float(entry.get("sign", 1))
            if "unit" in entry:
                scale *= factor(array, str(entry["unit"]), command_kind, path)
            parts.append(scale * table[:, _position(path, array, str(entry["column"]), header)])
        found[array] = parts[0] if array == "time" else np.stack(parts, axis=1)
    return found


def _by_name(header: Sequence[str], names: Mapping[str, Sequence[str]]) -> dict[str, list[dict[str, Any]]]:
    """Arrays all of whose columns have the contract's own names."""
    own = {array: [array if array == "time" else f"{array}_{n}" for n in labels] for array, labels in names.items()}
    partly = {a: cs for a, cs in own.items() if cs and (a in ("time", "command", "joint_pos") or set(cs) & set(header))}
    return {array: [{"column": c} for c in cs] for array, cs in partly.items()}


def _from_map(
    path: Path, columns: Mapping[str, Any], names: Mapping[str, Sequence[str]], header: Sequence[str]
) -> dict[str, list[dict[str, Any]]]:
    """Every array of the map as a list of entries {column, unit, sign}."""
    if not isinstance(columns, Mapping):
        raise GapError(
            "the column map is not an object", file=path, expected='{"time": "t", "joint_pos": ["q1", "q2"]}'
        )
    result = {}
    for array, said in columns.items():
        if array not in names:
            raise GapError(
                f"the column map names {array!r}, which is no array of a log",
                file=path,
                expected=f"one of {', '.join(names)}",
                hint=did_you_mean(array, names),
            )
        entries = [item for entry in _entries(path, array, said) for item in _items(entry, header)]
        if len(entries) != len(names[array]):
            raise GapError(
                f"the column map gives {array} the wrong number of columns",
                file=path,
                expected=f"{len(names[array])}: {', '.join(names[array]) or 'none, log.json names no such parts'}",
                found=str(len(entries)),
            )
        result[array] = entries
    return result


def _entries(path: Path, array: str, said: Any) -> list[dict[str, Any]]:
    """What the map says of one array: a name, an entry, a list of these, or {columns, unit, sign} for all at once."""
    shared: dict[str, Any] = {}
    listed = said if isinstance(said, list) else [said]
    if isinstance(said, Mapping) and "columns" in said:
        _check_entry(path, array, said, _SHARED)
        shared = {k: v for k, v in said.items() if k != "columns"}
        listed = said["columns"] if isinstance(said["columns"], list) else [said["columns"]]
    entries = []
    for item in listed:
        entry = {"column": item} if isinstance(item, str) else item
        if not isinstance(entry, Mapping) or not isinstance(entry.get("column"), str):
            raise GapError(
                f"the column map of {array} cannot be read",
                file=path,
                expected='a column name, {"column": NAME, "unit": UNIT, "sign": 1 or -1}, or a list of these',
                found=repr(item)[:80],
            )
        _check_entry(path, array, entry, _ENTRY)
        entries.append({**shared, **entry})
    return entries


def _items(entry: dict[str, Any], header: Sequence[str]) -> list[dict[str, Any]]:
    """The entry itself; of a column whose cells hold lists, one for each item of these."""
    name = str(entry["column"])
    if name in header:
        return [entry]
    return [entry | {"column": h} for h in header if h.startswith(f"{name}[") and h.endswith("]")] or [entry]


def _check_entry(path: Path, array: str, entry: Mapping[str, Any], known: Sequence[str]) -> None:
    odd = [k for k in entry if k not in known]
    if odd or entry.get("sign", 1) not in (1, -1):
        raise GapError(
            f"the column map of {array} has unknown entries",
            file=path,
            expected=f"only {', '.join(known)}; sign is 1 or -1",
            found=repr(dict(entry))[:80],
            hint=did_you_mean(odd[0], known) if odd else None,
        )


def _position(path: Path, array: str, column: str, header: Sequence[str]) -> int:
    if column not in header:
        raise GapError(
            f"column {column!r} of {array} is not in the file",
            file=path,
            expected=f"one of {', '.join(header[:40])}",
            hint=" ".join(filter(None, [did_you_mean(column, header), "columns.json beside log.json maps names"])),
        )
    return list(header).index(column)


def _table(path: Path) -> tuple[list[str], F64]:
    """(header, (T, K) numbers); empty cells are NaN."""
    lines = read_text(path, MAX_BYTES).splitlines()
    lines = [line for line in lines if line.strip()]
    if len(lines) < 2:
        raise GapError("the file has no samples", file=path, expected="a header and one row per sample")
    delimiter = max(DELIMITERS, key=lines[0].count)
    header = [h.strip() for h in _cells(path, [lines[0].lstrip("# ")], delimiter, 1)[0]]
    twice = sorted({h for h in header if header.count(h) > 1})
    if twice:
        raise GapError("the header names a column twice", file=path, found=", ".join(twice))
    if sum(_is_number(h) for h in header) > len(header) / 2:
        raise GapError("the file has no header", file=path, expected="names of the columns in the first line")
    try:  # plain numbers throughout: by far the fastest way
        table = np.loadtxt(lines[1:], delimiter=delimiter, ndmin=2, comments=None)
        if table.shape[1] == len(header):
            return header, table
    except ValueError:
        pass  # empty cells, text or damage: cell by cell, so that the message can name it
    rows = _cells(path, lines[1:], delimiter, 2)
    for number, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise GapError(
                "a row has the wrong number of cells",
                file=path,
                expected=f"{len(header)}, as in the header",
                found=f"{len(row)} in row {number}",
                hint="decimal commas? Write decimal points" if len(row) > len(header) else None,
            )
    header, rows = _unpacked(path, header, rows)
    return header, _numbers(path, header, rows)


def _unpacked(path: Path, header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Columns whose cells hold lists ("[0.1, 0.2]") as one column an item: NAME[0], NAME[1], ..."""
    names: list[str] = []
    columns: list[list[str]] = []
    for c, name in enumerate(header):
        cells = [row[c].strip() for row in rows]
        first = next((cell for cell in cells if cell), "")
        if not first.startswith(("[", "(")):
            names.append(name)
            columns.append(cells)
            continue
        lists = [cell.strip("[]()").replace(",", " ").replace(";", " ").split() for cell in cells]
        count = max(map(len, lists))
        wrong = next((i for i, items in enumerate(lists) if len(items) not in (0, count)), None)
        if wrong is not None:
            raise GapError(
                f"the lists of column {name!r} differ in length",
                file=path,
                expected=f"{count} items in each cell",
                found=f"{len(lists[wrong])} in row {wrong + 2}",
            )
        names += [f"{name}[{k}]" for k in range(count)]
        columns += [[items[k] if items else "" for items in lists] for k in range(count)]
    return names, [list(row) for row in zip(*columns, strict=True)]


def _cells(path: Path, lines: Sequence[str], delimiter: str, first: int) -> list[list[str]]:
    """The cells of each line; `first` is the number of the first row."""
    rows: list[list[str]] = []
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            if reader.line_num > len(rows) + 1:  # an open quotation mark turns all rows up to the next into one cell
                raise csv.Error("the cell continues in the next row")
            rows.append(row)
    except csv.Error as error:
        raise GapError(
            "a cell does not end in its row",
            file=path,
            expected="each quotation mark closed in its own row",
            found=f"{error}, from row {first + len(rows)} on",
        ) from error
    return rows


def _numbers(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> F64:
    table = np.full((len(rows), len(header)), np.nan)
    for column, name in enumerate(header):
        cells = [row[column].strip() for row in rows]
        try:
            table[:, column] = [float(c) if c else np.nan for c in cells]
        except ValueError:
            # Text columns (a mode, a note) are borne; they are refused by name only if the map asks for them.
            wrong = [i for i, c in enumerate(cells) if c and not _is_number(c)]
            if len(wrong) < 0.5 * len(cells):
                raise GapError(
                    f"column {name!r} holds text among numbers",
                    file=path,
                    found=f"{cells[wrong[0]]!r} in row {wrong[0] + 2}",
                    hint="leave a missing value empty; write decimal points, not commas",
                ) from None
    return table


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
