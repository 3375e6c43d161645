"""What stands in a scene: boxes, cylinders and ellipsoids on the floor z = 0, one function a kind of scene.

The parkour courses are those of `trainer.terrain`; the rest is stairs, ramps, furniture and clutter. Layouts are made
once on the CPU; the GPU picks, scales, mirrors and thins them for every batch (`scenes.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.geometry import exp_so3
from trainer.terrain import FAMILIES, generate

F64 = NDArray[np.float64]
Rng = np.random.Generator
SLOTS = {"box": 40, "cylinder": 8, "ellipsoid": 6}
"""Primitives of each kind in a scene at most, in this order."""


@dataclass(frozen=True)
class Item:
    """A primitive: the unit cube, cylinder (along z) or ball, stretched by `half`, turned by `R`, moved to `centre`."""

    kind: str
    centre: F64
    """(3,) metres."""
    half: F64
    """(3,) half extents, metres."""
    R: F64
    """(3, 3)."""


def item(kind: str, centre: tuple[float, ...], half: tuple[float, ...], yaw: float = 0.0, tilt: float = 0.0) -> Item:
    """A primitive turned by `yaw` about z after `tilt` about its own y, radians."""
    R = exp_so3([0.0, 0.0, yaw]) @ exp_so3([0.0, tilt, 0.0])
    return Item(kind, np.asarray(centre, float), np.asarray(half, float), R)


def course(rng: Rng) -> list[Item]:
    """A parkour course of any family and difficulty, its middle at the origin; some square stakes become round."""
    family = str(rng.choice(list(FAMILIES)))
    terrain = generate(family, float(rng.uniform()), int(rng.integers(2**31)))
    middle = (terrain.start.centre + terrain.goal.centre) / 2
    out = []
    for box in terrain.boxes:
        centre = box.T[:3, 3] - [middle[0], middle[1], terrain.floor_z]
        square = abs(box.size[0] - box.size[1]) < 0.1 * box.size[0] and box.T[2, 2] > 0.999
        kind = "cylinder" if square and rng.random() < 0.3 else "box"
        out.append(Item(kind, centre, box.size / 2, box.T[:3, :3]))
    return out + (clutter(rng, 4, ring=1.3) if rng.random() < 0.6 else [])


def stairs(rng: Rng) -> list[Item]:
    """A flight up to a landing, on some occasions down again, with or without a wall beside it."""
    count, rise, tread = int(rng.integers(3, 11)), rng.uniform(0.08, 0.2), rng.uniform(0.22, 0.36)
    width, down = rng.uniform(0.7, 1.8), rng.random() < 0.4
    heights = [(k + 1) * rise for k in range(count)]
    heights += heights[::-1] if down else [heights[-1]] * 2
    out, x = [], -len(heights) * tread / 2
    for k, h in enumerate(heights):
        long = tread if down or k < count else 0.6
        out.append(item("box", (x + long / 2, 0, h / 2), (long / 2, width / 2, h / 2)))
        x += long
    if rng.random() < 0.4:
        out.append(item("box", (0, width / 2 + 0.08, 1.2), (2.0, 0.08, 1.2)))
    return out + clutter(rng, int(rng.integers(0, 6)), ring=width / 2 + 0.4)


def ramps(rng: Rng) -> list[Item]:
    """Tilted slabs and blocks, sunk so far that no gap opens below them."""
    out = []
    for k in range(int(rng.integers(2, 6))):
        half = (rng.uniform(0.3, 0.9), rng.uniform(0.25, 0.8), rng.uniform(0.15, 0.4))
        where = (rng.uniform(-1.5, 1.5), rng.uniform(-0.8, 0.8), rng.uniform(-0.1, 0.15))
        out.append(item("box", where, half, rng.uniform(-np.pi, np.pi) if k else 0.0, rng.uniform(0.1, 0.5)))
    return out + clutter(rng, int(rng.integers(0, 8)), ring=0.9)


def furniture(rng: Rng) -> list[Item]:
    """Tables, shelves, cupboards, stools and chairs about a free middle, or a chair in it."""
    out: list[Item] = []
    for _ in range(int(rng.integers(2, 5))):
        angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.8, 2.6)
        at = np.array([far * np.cos(angle), far * np.sin(angle), 0.0])
        build = (_table, _shelf, _cupboard, _stool, _chair)[int(rng.integers(5))]
        if build is _chair and rng.random() < 0.5:
            at = at * 0.2
        yaw = exp_so3([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        out += [Item(i.kind, at + yaw @ i.centre, i.half, yaw @ i.R) for i in build(rng)]
    return out + clutter(rng, int(rng.integers(2, 10)), ring=0.2)


def clutter(rng: Rng, count: int | None = None, ring: float = 0.0) -> list[Item]:
    """Boxes, cylinders and balls of all sizes, beyond `ring` metres to the sides; some stand on others, some lean."""
    out: list[Item] = []
    for _ in range(int(rng.integers(6, 24)) if count is None else count):
        size = np.exp(rng.uniform(np.log(0.05), np.log(0.5), 3)) * [1, 1, 1.3]
        side = ring + abs(rng.normal(0, 0.9))
        x, y = rng.normal(0, 1.3), side * rng.choice([-1.0, 1.0]) if ring else rng.normal(0, 1.1)
        kind = str(rng.choice(["box", "box", "box", "cylinder", "ellipsoid"]))
        if kind != "box":
            size[1] = size[0]
        base = 0.0
        if out and rng.random() < 0.2:
            below = out[int(rng.integers(len(out)))]
            x, y, base = below.centre[0], below.centre[1], below.centre[2] + below.half[2]
        tilt = float(rng.normal(0, 0.3)) if rng.random() < 0.15 else 0.0
        lying = np.pi / 2 if kind == "cylinder" and rng.random() < 0.25 else 0.0
        up = size[0] if lying else size[2]
        out.append(item(kind, (x, y, base + up), tuple(size), rng.uniform(-np.pi, np.pi), tilt + lying))
    return out


def _table(rng: Rng) -> list[Item]:
    a, b, h = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.5), rng.uniform(0.4, 0.8)
    leg = rng.uniform(0.02, 0.05)
    corners = [(sx * (a - leg), sy * (b - leg)) for sx in (-1, 1) for sy in (-1, 1)]
    top = item("box", (0, 0, h), (a, b, rng.uniform(0.012, 0.03)))
    return [top, *(item("box", (x, y, h / 2), (leg, leg, h / 2)) for x, y in corners)]


def _shelf(rng: Rng) -> list[Item]:
    wide, deep, floors = rng.uniform(0.3, 0.6), rng.uniform(0.12, 0.25), int(rng.integers(3, 6))
    step = rng.uniform(0.25, 0.4)
    boards = [item("box", (0, 0, (k + 0.3) * step), (wide, deep, 0.012)) for k in range(floors)]
    sides = [item("box", (s * wide, 0, floors * step / 2), (0.012, deep, floors * step / 2)) for s in (-1, 1)]
    return boards + sides


def _cupboard(rng: Rng) -> list[Item]:
    half = (rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.35), rng.uniform(0.3, 1.0))
    return [item("box", (0, 0, half[2]), half)]


def _stool(rng: Rng) -> list[Item]:
    r, h = rng.uniform(0.12, 0.2), rng.uniform(0.3, 0.6)
    seat, pole = item("cylinder", (0, 0, h), (r, r, 0.03)), item("cylinder", (0, 0, h / 2), (0.03, 0.03, h / 2))
    return [seat, pole, item("cylinder", (0, 0, 0.015), (r, r, 0.015))]


def _chair(rng: Rng) -> list[Item]:
    """Seat, leaning back, four thin legs, some with arms."""
    a, h, leg = rng.uniform(0.2, 0.28), rng.uniform(0.38, 0.5), rng.uniform(0.01, 0.025)
    lean, tall = rng.uniform(0.0, 0.35), rng.uniform(0.2, 0.35)
    back = item("box", (-a - tall * np.sin(lean), 0, h + tall * np.cos(lean)), (0.015, a, tall), tilt=-lean)
    legs = [item("box", (sx * a, sy * a, h / 2), (leg, leg, h / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    arms = [item("box", (0, s * a, h + 0.2), (a, leg, 0.015)) for s in (-1, 1)] if rng.random() < 0.6 else []
    posts = [item("box", (a, s * a, h + 0.1), (leg, leg, 0.1)) for s in (-1, 1)] if arms else []
    return [item("box", (0, 0, h), (a, a, 0.02), tilt=rng.uniform(-0.15, 0.05)), back, *legs, *arms, *posts]


LAYOUTS: dict[str, tuple[float, Callable[[Rng], list[Item]]]] = {
    "course": (0.40, course),
    "stairs": (0.12, stairs),
    "ramps": (0.10, ramps),
    "furniture": (0.20, furniture),
    "clutter": (0.18, clutter),
}
"""Kind of scene -> its share, and what makes it."""


@dataclass(frozen=True)
class Library:
    """Padded arrays of `S` layouts, P = sum of SLOTS primitives each."""

    centre: NDArray[np.float32]
    """(S, P, 3)."""
    half: NDArray[np.float32]
    """(S, P, 3)."""
    R: NDArray[np.float32]
    """(S, P, 3, 3)."""
    there: NDArray[np.bool_]
    """(S, P) whether the slot is filled."""
    kind: tuple[str, ...]
    """Of each layout."""


def library(count: int, seed: int, kinds: tuple[str, ...] = tuple(LAYOUTS)) -> Library:
    """Layouts by their shares; layout i of a seed is the same whatever the count.

    Raises:
        RealsimError: fewer than one, or a kind that is not there.
    """
    if strange := [k for k in kinds if k not in LAYOUTS]:
        raise RealsimError("no such kind of scene", expected=", ".join(LAYOUTS), found=", ".join(strange))
    if count < 1 or not kinds:
        raise RealsimError("a library needs layouts", expected="one or more", found=str(count))
    slots = sum(SLOTS.values())
    centre, half = np.zeros((count, slots, 3), np.float32), np.ones((count, slots, 3), np.float32)
    R = np.tile(np.eye(3, dtype=np.float32), (count, slots, 1, 1))
    there, names = np.zeros((count, slots), bool), []
    shares = np.array([LAYOUTS[k][0] for k in kinds])
    first = dict(zip(SLOTS, np.cumsum([0, *SLOTS.values()]), strict=False))
    for s in range(count):
        rng = np.random.default_rng([seed, s])
        names.append(str(rng.choice(list(kinds), p=shares / shares.sum())))
        used = dict.fromkeys(SLOTS, 0)
        for one in LAYOUTS[names[-1]][1](rng):
            if used[one.kind] < SLOTS[one.kind]:  # what comes last, clutter, is left out of a full scene
                p = first[one.kind] + used[one.kind]
                centre[s, p], half[s, p], R[s, p], there[s, p] = one.centre, one.half, one.R, True
                used[one.kind] += 1
    return Library(centre, half, R, there, tuple(names))
