"""Tables into streams: columns that belong together become one field, by index, by axis, or by the joint they name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.recordings.messages import MAX_WIDTH
from realsim.gap.recordings.names import is_clock, named_unit, words
from realsim.gap.recordings.recording import Field, Stream

_AXIS = re.compile(r"^(?P<stem>.*?)[._\s\[(]*(?P<axis>[xyzw])[\])]?$")
_INDEX = re.compile(r"^(?P<head>.*?)[._\s\[(]*(?P<index>\d+)[\])]?(?P<tail>[^0-9]*)$")
_SIGNAL = {
    "q", "qd", "dq", "qdes", "pos", "position", "angle", "vel", "velocity", "speed", "tau", "torque", "effort", "cmd",
    "command", "target", "goal", "des", "desired", "ref", "action", "state", "measured", "actual", "current", "joint",
    "observation", "deg", "rad", "nm", "rpm", "per", "s", "setpoint", "load", "present",
}  # fmt: skip
"""Words that say what is measured; what is left of a column's name says where."""


def table(path: Path, name: str, columns: Mapping[str, F64], units: Mapping[str, str] | None = None) -> Stream:
    """A stream from columns (T,) or (T, K) of one table; those that look like clocks become its clocks."""
    clocks = {n: v for n, v in columns.items() if v.ndim == 1 and is_clock(n)}
    rest = {n: v for n, v in columns.items() if n not in clocks and v.ndim <= 2}
    vectors = {n: Field(v, (), named_unit(n)) for n, v in rest.items() if v.ndim == 2 and 0 < v.shape[1] <= MAX_WIDTH}
    scalars = {n: v for n, v in rest.items() if v.ndim == 1}
    fields = vectors | grouped(scalars)
    if not fields:
        raise GapError("the table has no columns of numbers", file=path, found=", ".join(list(columns)[:12]) or "none")
    if units:
        fields = {n: Field(f.values, f.labels, units.get(n, f.unit)) for n, f in fields.items()}
    return Stream(name, "table", clocks, fields)


def grouped(scalars: Mapping[str, F64]) -> dict[str, Field]:
    """Columns (T,) as fields: `acc_x acc_y acc_z`, `q_0 q_1`, `FL_hip_pos FL_calf_pos`; others stay alone."""
    left = dict(scalars)
    found: dict[str, Field] = {}
    for group, labels, stem in (*_by_axis(left), *_by_index(left), *_by_place(left)):
        members = [m for m in group.values() if m in left]
        if len(members) < len(group) or len(members) < 2:
            continue
        name = stem if stem and stem not in found else " ".join(members[:2])
        values = np.stack([left.pop(m) for m in members], axis=1)
        found[name] = Field(values, labels, named_unit(members[0]))
    return found | {n: Field(v[:, None], (), named_unit(n)) for n, v in left.items()}


_Groups = list[tuple[dict[str, str], tuple[str, ...], str]]
"""(place -> column, places, what the columns have in common) of columns that belong together."""


def _by_axis(names: Mapping[str, Any]) -> _Groups:
    stems: dict[str, dict[str, str]] = {}
    for name in names:
        match = _AXIS.match(name)
        if match and match["stem"]:
            stems.setdefault(match["stem"], {})[match["axis"]] = name
    # The order of the columns is kept: it is the order of a quaternion too.
    return [(axes, tuple(axes), stem) for stem, axes in stems.items() if {"x", "y", "z"} <= set(axes)]


def _by_index(names: Mapping[str, Any]) -> _Groups:
    stems: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        match = _INDEX.match(name)
        if match and not match["tail"].strip("._ ").isdigit():
            stems.setdefault((match["head"], match["tail"]), {})[int(match["index"])] = name
    groups = []
    for (head, tail), found in stems.items():
        indices = sorted(found)
        if len(indices) >= 2 and indices == list(range(indices[0], indices[0] + len(indices))):
            groups.append(
                ({str(i): found[i] for i in indices}, tuple(found[i] for i in indices), head.rstrip("._ ") + tail)
            )
    return groups


def _by_place(names: Mapping[str, Any]) -> _Groups:
    """Columns of which every name is a place and the same words of a signal: hip_pos, knee_pos."""
    stems: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        parts = words(name)
        signal = tuple(w for w in parts if w in _SIGNAL)
        place = "_".join(w for w in parts if w not in _SIGNAL)
        if signal and place:
            stems.setdefault(signal, {})[place] = name
    return [(found, tuple(found), "_".join(signal)) for signal, found in stems.items() if len(found) >= 2]


def cells(path: Path, name: str, values: Sequence[Any]) -> F64 | None:
    """A column of any cells as numbers: (T,) of numbers, (T, K) of lists (also written as text); None for text.

    Raises:
        GapError: lists of different lengths.
    """
    rows = [_cell(v) for v in values]
    wide = next((len(r) for r in rows if isinstance(r, list)), 0)
    if wide:
        odd = next((i for i, r in enumerate(rows) if isinstance(r, list) and len(r) != wide), None)
        if odd is not None:
            raise GapError(
                f"the lists in column {name!r} have different lengths", file=path, expected=f"{wide} numbers",
                found=f"{len(rows[odd])} in row {odd + 1}",  # type: ignore[arg-type]
            )  # fmt: skip
        if wide > MAX_WIDTH:
            return None
        blank = [np.nan] * wide
        return np.array([r if isinstance(r, list) else blank for r in rows], dtype=np.float64)
    if sum(r is not None for r in rows) < 0.5 * len(rows):
        return None
    return np.array([np.nan if r is None else r for r in rows], dtype=np.float64)


EMPTY = ("", "nan", "null", "none", "na", "n/a", "-")
"""How a cell says that there is no number."""


def odd_cell(values: Sequence[Any], column: F64) -> str | None:
    """The first cell that is neither a number nor empty; None if there is none. `column` is what `cells` made."""
    for k in np.flatnonzero(np.isnan(column.reshape(len(column), -1)).all(axis=1)).tolist():
        text = "" if values[k] is None else str(values[k]).strip()
        if text.strip("[]() ").split(",")[0].strip().lower() not in EMPTY:
            return text[:40]
    return None


def _cell(value: Any) -> float | list[float] | None:
    """A number, a list of numbers, or None for what is neither (a text, an empty cell)."""
    if isinstance(value, str):
        text = value.strip()
        if text.startswith(("[", "(")):
            inner = text.strip("[]() ")
            value = inner.replace(";", ",").split(",") if "," in inner or ";" in inner else inner.split()
        else:
            try:
                return float(text)
            except ValueError:
                return {"true": 1.0, "false": 0.0, "nan": np.nan}.get(text.lower())
    if isinstance(value, (bool, int, float, np.number)):
        try:
            return float(value)
        except OverflowError:  # a whole number of hundreds of digits
            return None
    if isinstance(value, (list, tuple, np.ndarray)):
        try:
            return [float(v) if v is not None else np.nan for v in np.ravel(np.asarray(value, dtype=object))]
        except (TypeError, ValueError, OverflowError):
            return None
    return None


def rows(path: Path, items: Sequence[Mapping[str, Any]], notes: list[str]) -> dict[str, F64]:
    """Records (JSON objects) as columns; nested objects get dotted names. What is no number is noted."""
    flat = [_flat(item) for item in items]
    names = list(dict.fromkeys(n for row in flat[:200] for n in row))
    found = {}
    for name in names:
        values = [row.get(name) for row in flat]
        column = cells(path, name, values)
        if column is not None:
            found[name] = column
            if (odd := odd_cell(values, column)) is not None:
                notes.append(f"{path.name}: {name} has values that are no numbers, the first is {odd!r}")
    return found


def _flat(item: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in item.items():
        name = f"{place}.{key}" if place else str(key)
        if isinstance(value, Mapping):
            result |= _flat(value, name)
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            parts = [_flat(v) for v in value]  # equal parts, such as motors: every number is a list with one of each
            result |= {f"{name}.{inner}": [p.get(inner) for p in parts] for inner in parts[0]}
        else:
            result[name] = value
    return result
