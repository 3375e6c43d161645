"""Runs as .csv files: a header, a row a sample, and a map from the contract's arrays to columns.

The map is `columns` of log.json, or columns.json beside it:

    {"time": {"column": "stamp", "unit": "us"},
     "command": {"columns": ["q1_des", "q2_des"], "unit": "deg"},
     "joint_pos": ["q1", {"column": "q2", "unit": "deg", "sign": -1}]}

A column may hold lists ("[0.1, 0.2]"): its name stands for all items, NAME[0] for the first.
Without a map, columns are found by exact name: `time`, `command_ACTUATOR`, `joint_pos_JOINT`, `base_pos_x`, ...
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, did_you_mean, refuse_unknown
from realsim.core.text_table import read_text_table
from realsim.core.types import F64
from realsim.gap.case.units import unit_factor

_ENTRY = ("column", "unit", "sign")
_SHARED = ("columns", "unit", "sign")


def read_csv(
    path: Path,
    columns: Mapping[str, Any] | None,
    names: Mapping[str, Sequence[str]],
    command_kind: str,
    warnings: list[str],
) -> dict[str, F64]:
    """Arrays of a .csv run in the contract's units; time is (T,), all others (T, K).

    Args:
        columns: the map, or None to find columns by exact name.
        names: array -> the names of its columns in the contract (joints, actuators, axes).
        warnings: get what was mended.

    Raises:
        GapError: for a column that is not in the file (the closest ones are named), or a cell that is no number.
    """
    table = _table(path, warnings)
    if columns is None:  # arrays all of whose columns have the contract's own names
        own = {array: [array if array == "time" else f"{array}_{n}" for n in labels] for array, labels in names.items()}
        always = ("time", "command", "joint_pos")
        wanted = {
            a: [{"column": c} for c in cs] for a, cs in own.items() if cs and (a in always or set(cs) & set(table))
        }
    elif isinstance(columns, Mapping):
        wanted = {array: _entries(path, array, given, names, list(table)) for array, given in columns.items()}
    else:
        expected = '{"time": "t", "joint_pos": ["q1", "q2"]}'
        raise GapError("the column map is not an object", file=path, expected=expected)
    found = {}
    for array, entries in wanted.items():
        parts = []
        for entry in entries:
            name, scale = entry["column"], float(entry.get("sign", 1))
            if "unit" in entry:
                scale *= unit_factor(array, str(entry["unit"]), command_kind, path)
            if name not in table:
                hints = [did_you_mean(name, table), "columns.json beside log.json maps names"]
                raise GapError(
                    f"column {name!r} of {array} is not in the file", file=path,
                    expected=f"one of {', '.join(list(table)[:40])}", hint=" ".join(filter(None, hints)),
                )  # fmt: skip
            parts.append(scale * table[name])
        found[array] = parts[0] if array == "time" else np.stack(parts, axis=1)
    return found


def _entries(
    path: Path, array: str, given: Any, names: Mapping[str, Sequence[str]], header: Sequence[str]
) -> list[dict[str, Any]]:
    """What the map has for one array as {column, unit, sign} for each of its columns.

    Args:
        given: a name, an entry, a list of these, or {columns, unit, sign} for all at once.
    """
    refuse_unknown(array, names, f"the column map names {array!r}, which is no array of a log", path)
    shared: dict[str, Any] = {}
    if isinstance(given, Mapping) and "columns" in given:
        _check_entry(path, array, given, _SHARED)
        shared = {k: v for k, v in given.items() if k != "columns"}
        given = given["columns"]
    entries = []
    for item in given if isinstance(given, list) else [given]:
        entry = {"column": item} if isinstance(item, str) else item
        if not isinstance(entry, Mapping) or not isinstance(entry.get("column"), str):
            raise GapError(
                f"the column map of {array} cannot be read", file=path, found=repr(item)[:80],
                expected='a column name, {"column": NAME, "unit": UNIT, "sign": 1 or -1}, or a list of these',
            )  # fmt: skip
        _check_entry(path, array, entry, _ENTRY)
        # Of a column whose cells hold lists, one for each item of these.
        items = [h for h in header if h.startswith(f"{entry['column']}[") and h.endswith("]")]
        found = items if items and entry["column"] not in header else [entry["column"]]
        entries += [{**shared, **entry, "column": column} for column in found]
    if len(entries) != len(names[array]):
        raise GapError(
            f"the column map gives {array} the wrong number of columns", file=path, found=str(len(entries)),
            expected=f"{len(names[array])}: {', '.join(names[array]) or 'none, log.json names no such parts'}",
        )  # fmt: skip
    return entries


def _check_entry(path: Path, array: str, entry: Mapping[str, Any], known: Sequence[str]) -> None:
    odd = [k for k in entry if k not in known]
    if odd or entry.get("sign", 1) not in (1, -1):
        raise GapError(
            f"the column map of {array} has unknown entries", file=path, found=repr(dict(entry))[:80],
            expected=f"only {', '.join(known)}; sign is 1 or -1", hint=did_you_mean(odd[0], known) if odd else None,
        )  # fmt: skip


def _table(path: Path, warnings: list[str]) -> dict[str, F64]:
    """Column -> (T,) numbers, empty cells NaN; a column whose cells hold lists is one for each item: NAME[0], ..."""
    read = read_text_table(path)
    if not read.header:
        raise GapError("the file has no header", file=path, expected="names of the columns in the first line")
    # Text columns (a mode, a note) are borne; they are refused by name only if the map wants them.
    for name, (cell, row) in read.odd.items():
        message, found = f"column {name!r} holds text among numbers", f"{cell!r} in row {row}"
        raise GapError(message, file=path, found=found, hint="leave a missing value empty")
    if not read.columns:
        raise GapError("the file has no samples", file=path, expected="a header and one row per sample")
    warnings += read.notes
    items = {n: {n: v} if v.ndim == 1 else {f"{n}[{k}]": c for k, c in enumerate(v.T)} for n, v in read.columns.items()}
    return {name: column for found in items.values() for name, column in found.items()}
