"""What a change of values is that nobody was told of: harmless for a reason that is checked here, or `silent`.

    moved       the same frames or runs, whole, under other names or in another order
    less        some of what the sound example has and nothing else: fewer frames, runs, samples, pixels with a depth,
                optional entries of a file, figures that are only drawn
    unused      only colours of a finished scan, which decide nothing: they are painted on what is shown
    slight      no number is off by more than a thousandth of what its array spans
    exchanged   files of one kind changed places: every value is a true one, beside the wrong others. No format says
                which belongs to which; `realsim reconstruct` compares frames with one another
    plausible   a legal number within what the array spans anyway, in a format without a checksum: nothing tells it
                from a true one
    silent      any other

The first four say nothing false. `exchanged`, `plausible` and `silent` are stored one by one, with what came out.
"""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from realsim.core.files import digest

HARMLESS = ("moved", "less", "unused", "slight")
LISTED = ("exchanged", "plausible", "silent")
SLIGHT = 1e-3
"""Of the span of an array: a millimetre of a metre, below what any of the sensors resolves."""
MAY_BE_ZERO = ("depth", "colour", "confidence")
"""Images in which 0 stands for nothing seen, or for the colour of nothing."""
CLOUD = ("points", "normals", "colors")
"""A finished scan: a point whose coordinates are no numbers is none."""
Values = Mapping[str, Any]


def equal(a: Any, b: Any) -> bool:
    return key(a) == key(b)


def key(value: Any) -> str:
    return digest(value if isinstance(value, np.ndarray) else repr(value))


def explain(kind: str, sound: Values, found: Values, shorter: bool) -> str:
    """The name of a change between two readings, the first that holds.

    Args:
        shorter: whether the damaged files are the sound ones with something left out (`only_left_out`).
    """
    if kind == "captures" and not {n for n in {*sound, *found} if not _same(n, sound, found)} - {"colors"}:
        return "unused"
    if sorted(_whole(sound)) == sorted(_whole(found)):
        return "moved"
    if shorter or _fewer(sound, found):
        return "less"
    if Counter(_kinds(sound)) == Counter(_kinds(found)):
        return "exchanged"
    return _numbers(sound, found)


def _same(name: str, sound: Values, found: Values) -> bool:
    return equal(sound.get(name), found.get(name))


def owners(found: Values) -> dict[str, dict[str, Any]]:
    """Frame or run -> its values; what belongs to none is under ''."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in found.items():
        what, of, owner = name.partition(" of ")
        own = of and owner not in ("the model", "the terrain", "frames")
        parts.setdefault(owner if own else "", {})[what if own else name] = value
    return parts


def _whole(found: Values) -> list[list[str]]:
    return [_row(part) for part in owners(found).values()]


def _row(part: Values) -> list[str]:
    return [f"{n} {key(v)}" for n, v in sorted(part.items()) if n != "name"]


def _kinds(found: Values) -> list[tuple[str, str]]:
    return [(n, key(v)) for part in owners(found).values() for n, v in part.items() if n != "name"]


def _fewer(sound: Values, found: Values) -> bool:
    """Whether every frame or run is one of the sound ones, or one with holes or fewer rows; the rest as it was."""
    a, b = owners(sound), owners(found)
    fewer = ("number of frames", "surface")
    rest = [{n: key(v) for n, v in part.get("", {}).items() if n not in (*fewer, *CLOUD)} for part in (a, b)]
    if rest[0] != rest[1] or len(b) > len(a):
        return False
    clouds = [{n: v for n, v in part.get("", {}).items() if n in CLOUD} for part in (a, b)]
    if clouds[0].keys() != clouds[1].keys() or not _holes(*clouds):
        return False
    if (surface := found.get("surface")) is not None and _rows(sound["surface"], surface) is None:
        return False
    whole = {tuple(_row(part)) for part in a.values()}
    for owner, part in b.items():
        if owner and tuple(_row(part)) not in whole and not any(_holes(other, part) for n, other in a.items() if n):
            return False
    return True


def _holes(sound: Values, found: Values) -> bool:
    """Whether arrays lost values to "nothing" (NaN; 0 in images), or all of them the same rows."""
    rows = None
    for name in sorted(sound.keys() | found.keys(), key=lambda n: n == "time"):
        if name == "name" or _same(name, sound, found) or (name == "timestamp" and found.get(name) is None):
            continue
        a, b = (np.asarray(v[name]) if name in v else np.zeros(0) for v in (sound, found))
        if a.dtype.kind not in "fiub" or b.dtype.kind not in "fiub" or not b.size:
            return False
        if a.shape != b.shape:
            rows = _rows(a, b) if rows is None else rows
            if rows is None or len(a) <= rows[-1] or len(rows) != len(b):
                return False
            # Time begins with 0, whichever sample is the first.
            a, b = (a[rows] - a[rows[0]], b - b[0]) if name == "time" else (a[rows], b)
            if not np.allclose(a, b, rtol=0, atol=1e-6 if name == "time" else 0, equal_nan=True):
                return False
        else:
            nothing = np.isnan(b) if b.dtype.kind == "f" else np.zeros(b.shape, bool)
            if name in MAY_BE_ZERO:
                nothing |= b == 0
            if not (nothing | (a == b)).all():
                return False
    return True


def _rows(a: np.ndarray, b: np.ndarray) -> list[int] | None:
    """Which rows of `a`, in order, are those of `b`; None if `b` is not a part of `a`."""
    rows, at = [], 0
    for row in b:
        while at < len(a) and not np.array_equal(a[at], row, equal_nan=True):
            at += 1
        if at == len(a):
            return None
        rows.append(at)
        at += 1
    return rows or None


def _numbers(sound: Values, found: Values) -> str:
    """slight, plausible or silent: by how far numbers are off."""
    if sound.keys() != found.keys():
        return "silent"
    worst = 0.0
    for name in found:
        if _same(name, sound, found) or name.startswith("name of "):
            continue
        try:
            a, b = np.asarray(sound[name], float), np.asarray(found[name], float)
        except (TypeError, ValueError):
            return "silent"
        if a.shape != b.shape or not a.size or not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return "silent"
        good = np.isfinite(a)
        a, b, span = a[good], b[good], float(np.ptp(a[good]))
        if b.min() < a.min() - SLIGHT * span or b.max() > a.max() + SLIGHT * span:
            return "silent"
        worst = max(worst, float(np.abs(a - b).max()) / span if span else np.inf)
    return "slight" if worst <= SLIGHT else "plausible"


# ---------------------------------------------------------------- files


def only_left_out(sound: Path, damaged: Path) -> bool:
    """Whether every damaged file is a sound one of the same name without some of its entries; some may be gone."""
    for path in damaged.rglob("*"):
        if path.is_file() and not path.is_symlink():
            before = sound / path.relative_to(damaged)
            if not before.is_file() or (
                path.read_bytes() != before.read_bytes() and not _entries(path) <= _entries(before)
            ):
                return False
        elif not path.is_dir():
            return False
    return True


def _entries(path: Path) -> Counter[str]:
    """Entries of JSON, XML or JSON lines, each with where it stands; a file of another kind is one entry."""
    try:
        if path.suffix == ".json":
            return Counter(_leaves(json.loads(path.read_bytes())))
        if path.suffix == ".jsonl":
            lines = path.read_text().splitlines()
            return Counter(f"{i} {leaf}" for i, line in enumerate(lines) for leaf in _leaves(json.loads(line)))
        if path.suffix == ".xml":
            nodes = ElementTree.parse(path).iter()
            # MuJoCo takes an empty attribute for one that is not there.
            return Counter(f"{n.tag} {k}={v}" for n in nodes for k, v in [("", "."), *n.attrib.items()] if v)
    except (ValueError, ElementTree.ParseError, RecursionError):
        pass
    return Counter([digest(path.read_bytes())])


def _leaves(tree: Any, at: str = "") -> list[str]:
    if isinstance(tree, dict):
        return [leaf for k, v in tree.items() for leaf in _leaves(v, f"{at}/{k}")]
    if isinstance(tree, list) and any(isinstance(v, dict) for v in tree):
        return [leaf for i, v in enumerate(tree) for leaf in _leaves(v, f"{at}/{i}")]
    return [] if tree is None else [f"{at}={tree!r}"]


# ---------------------------------------------------------------- in few bytes


def came_out(sound: Values, found: Values) -> list[str]:
    """At most two lines on what has other values than before."""
    changed = sorted(n for n in {*sound, *found} if not _same(n, sound, found))
    lines = [f"{n}: {_difference(sound.get(n), found.get(n))}" for n in changed[:2]]
    return lines + ([f"and {len(changed) - 2} more"] if len(changed) > 2 else [])


def _difference(before: Any, after: Any) -> str:
    if before is None or after is None:
        return f"{_brief(before)} -> {_brief(after)}"
    try:
        a, b = np.asarray(before, float), np.asarray(after, float)
    except (TypeError, ValueError):
        return _texts(repr(before), repr(after))
    if a.shape != b.shape:
        return f"{a.shape} -> {b.shape} values"
    other = np.argwhere(~((a == b) | (np.isnan(a) & np.isnan(b))))
    at = tuple(int(i) for i in other[0])
    return f"{len(other)} of {a.size} values, the first at {list(at)}: {a[at]:.6g} -> {b[at]:.6g}"


def _texts(a: str, b: str) -> str:
    at = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), 0)
    return f"{a[max(at - 30, 0) : at + 30]!r} -> {b[max(at - 30, 0) : at + 30]!r}"


def _brief(value: Any) -> str:
    return "nothing" if value is None else f"{value.shape}" if isinstance(value, np.ndarray) else repr(value)[:60]
