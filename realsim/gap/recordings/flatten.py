"""Whatever lies in whatever, of a message, a record or a structure, as one value for each dotted name."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from realsim.core.text_table import MAX_WIDTH

NAMED = ("name", "joint", "joint_name", "label")
"""Members by which a part of a list says which one it is."""
SECONDS, NANOSECONDS = ("sec", "secs"), ("nanosec", "nsecs", "nsec")


def flatten(part: Any, place: str = "") -> dict[str, Any]:
    """Values below a part, by dotted names: `imu_state.gyroscope`. A time in two members is one number of s.

    Parts of a list that name themselves have their names in those of their values, in any order: `joints.knee.q`. Of
    equal parts of numbers, such as motors, each name is a list with an entry a part; other parts are counted.
    """
    found: dict[str, Any] = {}
    for name, value in members(part):
        full = f"{place}.{name}".strip(".")
        listed = isinstance(value, (list, tuple)) or (
            isinstance(value, np.ndarray) and value.dtype == object and value.ndim > 0
        )
        items = list(value) if listed and 0 < len(value) <= MAX_WIDTH else []
        if is_part(value):
            inner = flatten(value, full)
            found |= inner if (moment := _moment(inner)) is None else {full: moment}
        elif items and all(map(is_part, items)):
            found |= {f"{full}.{n}".strip("."): v for n, v in _of_parts([flatten(i) for i in items]).items()}
        else:
            found[full] = value
    return found


def _of_parts(parts: list[dict[str, Any]]) -> dict[str, Any]:
    names = [next((str(p[key]) for key in NAMED if isinstance(p.get(key), (str, int)) and p[key]), "") for p in parts]
    deep = len(parts) == 1 or any(isinstance(v, (list, tuple, np.ndarray)) for v in parts[0].values())
    if not (all(names) and len(set(names)) == len(names)):
        if not deep:
            return {inner: [p.get(inner) for p in parts] for inner in parts[0]}
        names = [str(k) for k in range(1, len(parts) + 1)] if len(parts) > 1 else [""]
    return {f"{n}.{inner}".strip("."): v for n, p in zip(names, parts, strict=True) for inner, v in p.items()}


def members(part: Any) -> Iterator[tuple[str, Any]]:
    """Name and value of what a mapping or a message holds."""
    if isinstance(part, Mapping):
        yield from ((str(k), v) for k, v in part.items())
        return
    names = getattr(part, "__dataclass_fields__", None) or getattr(part, "__slots__", ()) or vars(part)
    yield from ((n, getattr(part, n)) for n in names if not n.startswith("_"))


def is_part(value: Any) -> bool:
    return isinstance(value, Mapping) or hasattr(value, "__dict__") or hasattr(value, "__slots__")


def _moment(values: dict[str, Any]) -> float | None:
    """s of a moment of ROS, seconds and nanoseconds; None of other values."""
    if [type(v) for v in values.values()] != [int, int]:
        return None
    (first, whole), (second, rest) = ((n.rpartition(".")[2], v) for n, v in values.items())
    return whole + 1e-9 * rest if first in SECONDS and second in NANOSECONDS else None
