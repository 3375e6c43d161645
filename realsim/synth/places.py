"""Places that repeat: where one metre looks like another, a reconstruction must not take one for the other.

Every bay of a corridor, every flight of a stairwell and every stake of a row is the same solid with the same texture;
only the way that the camera came tells them apart. Each function takes a generator, and whether the camera goes
through `once` (so that nothing it sees late is what it saw early), and returns a `Place`.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from realsim.synth.solids import F64, Solid, box, rz

EYE = 1.3
"""Metres above the ground at which the camera is carried."""


@dataclass(frozen=True)
class Place:
    """Solids and the way that a camera takes through them."""

    solids: tuple[Solid, ...]
    """With one solid each of role `start` and `goal`; all stand on z = 0 or above."""
    eyes: F64
    """(K, 3) points that the camera passes, metres."""
    aims: F64
    """(K, 3) what it looks at there."""
    lamps: F64
    """(L, 3)."""


def _copy(solid: Solid, at: ArrayLike, yaw: float = 0.0) -> Solid:
    """One more of the same, texture included."""
    own = replace(solid, texture_origin=np.zeros(3))
    return own.moved(rz(yaw), np.asarray(at, float))


def _ends(start: ArrayLike, goal: ArrayLike) -> list[Solid]:
    size = (0.5, 0.5, 0.2)
    return [
        box("start_platform", size, "wood", "start").moved(np.eye(3), start),
        box("goal_platform", size, "osb", "goal").moved(np.eye(3), goal),
    ]


def _bay(pitch: float, width: float, height: float) -> list[Solid]:
    """A length of corridor along x from -pitch/2 to pitch/2: floor, two walls, and on each a door and a notice."""
    out = [box("floor", (pitch, width, 0.1), "floor", "floor").moved(np.eye(3), (0, 0, -0.1))]
    for side in (-1, 1):
        y = side * (width / 2 + 0.05)
        out.append(box(f"wall_{side}", (pitch, 0.1, height), "wall", "scenery").moved(np.eye(3), (0, y, 0)))
        door = box(f"door_{side}", (0.9, 0.06, 2.05), "painted", "scenery")
        out.append(door.moved(np.eye(3), (0.2 * side, side * width / 2, 0)))
        frame = box(f"notice_{side}", (0.5, 0.03, 0.7), "cardboard", "scenery")
        out.append(frame.moved(np.eye(3), (0.2 * side + 0.8, side * width / 2, 1.1)))
    return out


def corridor(rng: np.random.Generator, once: bool = False) -> Place:
    """A straight corridor of equal bays. The camera goes in, walks a third of the way back, and on to the end."""
    pitch, width, bays = rng.uniform(2.0, 2.6), rng.uniform(1.7, 2.2), 9
    bay = _bay(pitch, width, 2.5)
    solids = [_copy(s, (k * pitch, 0, 0)) for k in range(bays) for s in bay]
    end = box("end", (0.1, width, 2.5), "osb", "scenery")
    last = (bays - 0.5) * pitch
    solids += [end.moved(np.eye(3), (x, 0, 0)) for x in (-pitch / 2 - 0.05, last + 0.05)]
    solids += _ends((-pitch / 2 + 0.3, 0, 0), (last - 0.3, 0, 0))
    way = np.array([0.0, 1.0] if once else [0.0, 0.5, 0.28, 1.0]) * (last - 2.2)
    x = _through(way, 0.8)
    side = rng.choice([-1.0, 1.0])
    eyes = np.column_stack([x, np.full(len(x), -0.2 * side), np.full(len(x), EYE)])
    aims = np.column_stack([x + 1.5, np.full(len(x), 0.55 * side), np.full(len(x), 0.7)])
    lamps = np.column_stack([pitch * np.arange(bays), np.zeros(bays), np.full(bays, 2.4)])
    return Place(tuple(solids), eyes, aims, lamps)


def ring(rng: np.random.Generator, once: bool = False) -> Place:
    """A corridor around a square block, all four sides alike. The camera goes around and a few metres further;
    `once`, along three of the sides."""
    pitch, width, bays = rng.uniform(2.0, 2.4), rng.uniform(1.7, 2.0), 3
    inner = bays * pitch / 2
    middle = inner + width / 2
    outer = inner + width
    solids: list[Solid] = []
    for turn in range(4):
        yaw = turn * np.pi / 2
        for k in range(bays):
            R = rz(yaw)
            at = R @ [(k - (bays - 1) / 2) * pitch, -middle, 0]
            solids += [_copy(s, at, yaw) for s in _bay(pitch, width, 2.5)]
        corner = box("floor", (width, width, 0.1), "floor", "floor").moved(np.eye(3), (0, 0, -0.1))
        solids.append(_copy(corner, rz(yaw) @ [middle, -middle, 0], yaw))
        for place, along in (((middle, -outer - 0.05, 0), 0.0), ((outer + 0.05, -middle, 0), np.pi / 2)):
            wall = box("wall", (width, 0.1, 2.5), "wall", "scenery")
            solids.append(_copy(wall, rz(yaw) @ place, yaw + along))
    solids += _ends((-inner, -middle, 0), (inner, middle, 0))
    corners = middle * np.array([[-0.6, -1], [1, -1], [1, 1], [-1, 1], [-1, -1], [0.7, -1]])
    eyes, aims = [], []
    for a, b in pairwise(corners[:4] if once else corners):
        length = float(np.linalg.norm(b - a))
        along = (b - a) / length
        for s in np.arange(0.9, length - 0.2, 0.7):
            ahead = a + along * s
            look = min(s + 1.6, length) - s
            into = np.array([-along[1], along[0]]) * (1.6 - look)  # the next side, in good time
            eyes.append([*ahead, EYE])
            aims.append([*(ahead + along * look + into), 0.75])
    lamps = [[*(rz(t * np.pi / 2) @ [x, -middle, 2.4])] for t in range(4) for x in (-pitch, 0.0, pitch, middle)]
    return Place(tuple(solids), np.array(eyes), np.array(aims), np.array(lamps))


def stairwell(rng: np.random.Generator, once: bool = False) -> Place:
    """Equal flights that turn around a square well. The camera climbs, comes back down a flight, and climbs on."""
    steps, rise, tread, width = 8, rng.uniform(0.155, 0.175), rng.uniform(0.27, 0.3), rng.uniform(1.1, 1.3)
    run, flights = steps * tread, 7
    half = run / 2 + width / 2
    up = (steps + 1) * rise
    flight = [
        box(f"step_{k}", (tread, width, 0.16), "concrete", "obstacle").moved(
            np.eye(3), (-run / 2 + (k + 0.5) * tread, -half, (k + 1) * rise - 0.16)
        )
        for k in range(steps)
    ]
    landing = box("landing", (width, width, 0.16), "osb", "obstacle").moved(np.eye(3), (half, -half, up - 0.16))
    wall = box("wall", (run + 2 * width, 0.1, up + 2.5), "wall", "scenery")
    wall = wall.moved(np.eye(3), (0, -half - width / 2 - 0.05, -0.2))
    notice = box("notice", (0.6, 0.04, 0.8), "cardboard", "scenery").moved(np.eye(3), (0.3, -half - width / 2, 1.5))
    solids = [box("floor", (run + 2 * width, run + 2 * width, 0.1), "floor", "floor").moved(np.eye(3), (0, 0, -0.1))]
    eyes, aims, lamps = [], [], []
    for k in range(flights):
        yaw, z = k * np.pi / 2, k * up
        R = rz(yaw)
        solids += [_copy(s, (0, 0, z), yaw) for s in (*flight, landing, notice)]
        solids.append(_copy(wall, (0, 0, z), yaw))
        lamps.append(R @ [0, -half * 0.4, z + 2.4])
        for s in (-0.5, -0.2, 0.1, 0.4) if k < flights - 2 else ():
            eyes.append(R @ [s * run, -half + 0.1, z + EYE + (s + 0.5) * up])
            aims.append(R @ [s * run + 1.4, -half - 0.15 + max(0.0, s + 0.2), z + EYE + (s + 0.5) * up - 0.45])
    count, turn, back = len(eyes), int(0.45 * len(eyes)), int(0.25 * len(eyes))
    there, again = np.arange(turn), np.r_[turn:back:-1, back:count]
    order = np.arange(count) if once else np.concatenate([there, again])
    solids += _ends((-half, -half, 0), (half, half, 0))
    return Place(tuple(solids), np.array(eyes)[order], np.array(aims)[order], np.array(lamps))


def stake_row(rng: np.random.Generator, once: bool = False) -> Place:
    """A row of equal stakes. The camera passes them sideways, there, back and there again."""
    pitch, count = rng.uniform(0.36, 0.46), 22
    length = count * pitch
    stake = box("stake", (0.2, 0.2, rng.uniform(0.25, 0.35)), "wood", "obstacle")
    solids = [box("floor", (length + 4, 6.0, 0.1), "floor", "floor").moved(np.eye(3), (length / 2, 0, -0.1))]
    solids += [_copy(stake, (k * pitch, 0, 0)) for k in range(count)]
    wall = box("wall", (length + 4, 0.1, 2.5), "wall", "scenery")
    solids.append(wall.moved(np.eye(3), (length / 2, 1.8, 0)))
    solids += _ends((-0.6, 0, 0), ((count - 0.2) * pitch, 0, 0))
    x = _through(np.array([0.0, 1.0] if once else [0.0, 0.7, 0.15, 1.0]) * (count - 4) * pitch, 0.35)
    eyes = np.column_stack([x, np.full(len(x), -1.2), np.full(len(x), EYE)])
    aims = np.column_stack([x + 0.4, np.full(len(x), 0.1), np.full(len(x), 0.15)])
    lamps = np.array([[k * 2 * pitch, -0.5, 2.4] for k in range(count // 2)])
    return Place(tuple(solids), eyes, aims, lamps)


def _through(stops: F64, step: float) -> F64:
    """Points `step` apart along a line that turns at `stops`."""
    parts = [np.linspace(a, b, max(2, round(abs(b - a) / step)), endpoint=False) for a, b in pairwise(stops)]
    return np.append(np.concatenate(parts), stops[-1])
