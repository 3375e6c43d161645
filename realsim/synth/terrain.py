"""A whole scene: platforms at both ends of a course, the floor, and a room with walls and clutter around it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.errors import UnknownNameError
from realsim.core.geometry import make_T, transform
from realsim.core.types import F64
from realsim.synth import PLACES, TERRAINS
from realsim.synth.places import Place
from realsim.synth.solids import Solid, box, cylinder, hexahedron, rz

PLATFORM = (0.9, 0.8, 0.35)
"""Size of the start and goal platforms, metres."""
_ROOM = 2.3
"""Metres from the terrain to the walls."""


@dataclass(frozen=True)
class Terrain:
    """Solids in the simulation frame: origin at the centroid of the start platform's top, z up, x toward the goal's."""

    name: str
    solids: tuple[Solid, ...]
    """All solids, each with its role."""
    floor_z: float
    bounds: F64
    """(2, 3) of platforms and obstacles."""
    eyes: F64 | None = None
    """(K, 3) points of the camera's way where the place prescribes it, else None."""
    aims: F64 | None = None
    """(K, 3) what it looks at there, or None."""
    lamps: F64 | None = None
    """(L, 3), or None for two above the floor."""

    def of(self, *roles: str) -> list[Solid]:
        """The solids with one of these roles."""
        return [s for s in self.solids if s.role in roles]


def make_terrain(name: str, seed: int, once: bool = False) -> Terrain:
    """The terrain `name` of `TERRAINS` or `PLACES` with everything random drawn from `seed`.

    Args:
        once: the camera goes through a place of `PLACES` without coming back to where it was.

    Raises:
        UnknownNameError: no such terrain; the message lists those that are.
    """
    rng = np.random.default_rng([seed, 1])
    if name in PLACES:
        return _placed(name, PLACES[name](rng, once))
    if name not in TERRAINS:
        raise UnknownNameError("terrain", name, [*TERRAINS, *PLACES])
    obstacles, length = TERRAINS[name](rng)
    sx, sy, sz = np.asarray(PLATFORM) + rng.uniform(-0.01, 0.01, 3)
    start = box("start_platform", (sx, sy, sz), "wood", "start").moved(rz(rng.uniform(-0.02, 0.02)), (-sx / 2, 0, 0))
    size = np.asarray(PLATFORM) + rng.uniform(-0.01, 0.01, 3)
    at = (length + size[0] / 2, rng.uniform(-0.04, 0.04), 0)
    goal = box("goal_platform", size, "osb", "goal").moved(rz(rng.uniform(-0.04, 0.04)), at)
    return in_a_room(name, start, obstacles, goal, rng)


def in_a_room(
    name: str, start: Solid, obstacles: Sequence[Solid], goal: Solid, rng: np.random.Generator
) -> Terrain:  # fmt: skip
    """A course that stands on the floor z = 0, with a floor, walls and clutter around it."""
    measured = [start, *obstacles, goal]
    corners = np.vstack([s.vertices for s in measured])
    low, high = corners.min(0), corners.max(0)
    scenery = [_floor(low, high), *_walls(low, high), *_clutter(low, high, rng)]
    T = _to_sim(start, goal)
    moved = [s.moved(T[:3, :3], T[:3, 3]) for s in measured + scenery]
    placed = np.vstack([s.vertices for s in moved[: len(measured)]])
    return Terrain(name, tuple(moved), float(T[2, 3]), np.array([placed.min(0), placed.max(0)]))


def _placed(name: str, place: Place) -> Terrain:
    """A place in the simulation frame."""
    start, goal = (next(s for s in place.solids if s.role == role) for role in ("start", "goal"))
    T = _to_sim(start, goal)
    moved = tuple(s.moved(T[:3, :3], T[:3, 3]) for s in place.solids)
    V = np.vstack([s.vertices for s in moved if s.role in ("start", "goal", "obstacle")])
    way = [transform(T, p) for p in (place.eyes, place.aims, place.lamps)]
    return Terrain(name, moved, float(T[2, 3]), np.array([V.min(0), V.max(0)]), *way)


def top_centroid(platform: Solid) -> F64:
    """(3,) centroid of the level top face of a box."""
    return platform.vertices[4:].mean(0)


def _to_sim(start: Solid, goal: Solid) -> F64:
    a, b = top_centroid(start), top_centroid(goal)
    R = rz(-float(np.arctan2(b[1] - a[1], b[0] - a[0])))
    return make_T(R, -transform(make_T(R), a))


def _floor(low: F64, high: F64) -> Solid:
    x0, y0, x1, y1 = low[0] - _ROOM, low[1] - _ROOM, high[0] + _ROOM, high[1] + _ROOM
    ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    corners = np.vstack([np.column_stack([ring, np.full(4, z)]) for z in (-0.1, 0.0)])
    return hexahedron("floor", corners, "floor", "floor")


def _walls(low: F64, high: F64) -> list[Solid]:
    """Four slabs, 2.5 m high, that stand on the floor's border."""
    (x0, y0), (x1, y1) = low[:2] - _ROOM, high[:2] + _ROOM
    cx, cy, w, d = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
    places = [((w, 0.1), (cx, y0)), ((w, 0.1), (cx, y1)), ((0.1, d), (x0, cy)), ((0.1, d), (x1, cy))]
    return [
        box(f"wall_{i}", (*size, 2.5), "wall", "scenery").moved(np.eye(3), (*at, 0))
        for i, (size, at) in enumerate(places)
    ]


def _clutter(low: F64, high: F64, rng: np.random.Generator) -> list[Solid]:
    """Crates, bins and a cabinet along the walls, at least 1.2 m from the terrain."""
    out = []
    for i in range(9):
        size = rng.uniform([0.3, 0.3, 0.25], [0.8, 0.5, 0.9])
        x, side = rng.uniform(low[0] - 1.2, high[0] + 1.4), (-1) ** i
        y = (high[1] + rng.uniform(1.5, 1.9)) if side > 0 else (low[1] - rng.uniform(1.5, 1.9))
        material = str(rng.choice(["cardboard", "painted", "osb", "foam"]))
        if rng.random() < 0.3:
            solid = cylinder(f"clutter_{i}", size[1], size[2], material, "scenery")
        else:
            solid = box(f"clutter_{i}", size, material, "scenery")
        out.append(solid.moved(rz(rng.uniform(-0.5, 0.5)), (x, y, 0)))
    cabinet = box("cabinet", (0.4, 1.1, 1.7), "painted", "scenery")
    return [*out, cabinet.moved(np.eye(3), (high[0] + _ROOM - 0.35, rng.uniform(-0.8, 0.8), 0))]
