"""Rooms at their real size as a reconstruction leaves them: one-sided, blurred, uneven, with places that nobody saw.

A signed distance field of boxes of air and of things in them, blurred by noise that is even over two voxels, meshed by
marching cubes; then blobs of it and all undersides lower than a table are taken out. Everything follows from a seed.
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from realsim.core.types import MeshQuality, TerrainMesh

F32 = NDArray[np.float32]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner, metres; the floor is at 0."""
BAND = 3
"""Voxels beside the surface in which the field is a distance."""
UNSEEN = 0.25
"""Metres: how far apart unseen places are decided."""
LOW = 1.0
"""Metres: undersides below this are not seen."""


def corridor() -> TerrainMesh:
    """35 x 21 m, three arms 2 m wide with doors, 2.6 m high, six things in them; some 670,000 triangles."""
    high = 2.6
    air: list[Box] = [((0, 0, 0), (35, 2.2, high)), ((32.8, 0, 0), (35, 21, high)), ((15, 2, 0), (17, 12, high))]
    for x in 2 + 3.5 * np.arange(9):
        air.append(((x, -0.15, 0), (x + 0.95, 0.1, 2.1)))
        if not 14 < x < 18:
            air.append(((x + 1.5, 2.1, 0), (x + 2.45, 2.35, 2.1)))
    air += [((34.9, y, 0), (35.15, y + 0.95, 2.1)) for y in 3 + 3.5 * np.arange(5)]
    things: list[Box] = [
        ((5, 1.75, 0), (6.6, 2.3, 0.45)),
        ((20, 1.8, 0), (21.5, 2.3, 0.8)),
        ((25, -0.1, 0.1), (26.2, 0.12, 0.7)),
        ((33, 10, 0), (33.5, 11.5, 1.9)),
        ((34.4, 14, 0), (34.8, 14.4, 0.45)),
        ((15.1, 6, 0), (15.6, 7.2, 0.75)),
    ]
    return _made(air, things, voxel=0.045, uneven=0.005, noise=0.009, seed=1, seen=0.97)


def hall() -> TerrainMesh:
    """20 x 14 m and 4.5 m high with twelve pillars, benches, a platform of two steps and a passage, from a LiDAR."""
    air: list[Box] = [((0, 0, 0), (20, 14, 4.5)), ((19.9, 5, 0), (24, 8, 3.0))]
    things: list[Box] = [
        ((5 * i + 2.3, 4 * j + 1.8, 0), (5 * i + 2.7, 4 * j + 2.2, 4.7)) for i in range(4) for j in range(3)
    ]
    things += [((1 + 3 * k, 12.2, 0), (2.6 + 3 * k, 12.9, 0.45)) for k in range(6)]
    things += [((8, 6, 0), (10, 8, 0.15)), ((8.3, 6.3, 0), (9.7, 7.7, 0.3))]
    return _made(air, things, voxel=0.06, uneven=0.006, noise=0.012, seed=2, seen=0.95)


def kitchen() -> TerrainMesh:
    """4.2 x 3.4 m: counters, wall units, a fridge, a table with four chairs, ten things on the counter."""
    things: list[Box] = [
        ((-0.1, -0.1, 0), (2.4, 0.6, 0.88)),
        ((-0.1, -0.1, 0.84), (2.4, 0.62, 0.91)),
        ((-0.1, -0.1, 1.45), (2.4, 0.35, 2.1)),
        ((2.3, -0.1, 0), (3.0, 0.62, 1.9)),
        ((-0.1, 0.5, 0), (0.6, 2.4, 0.88)),
    ]
    things += _table(2.0, 1.7, 1.3, 0.8, 0.74)
    for x, y in ((2.1, 1.2), (2.8, 1.2), (2.1, 2.6), (2.8, 2.6)):
        back = y + 0.36 if y > 2 else y
        things += [*_table(x, y, 0.4, 0.4, 0.45), ((x, back, 0.4), (x + 0.4, back + 0.04, 0.9))]
    rng = np.random.default_rng(3)
    for _ in range(10):
        x, y = rng.uniform([0.1, 0.1], [2.0, 0.4])
        a, b, c = rng.uniform(0.05, 0.2, 3)
        things.append(((x, y, 0.8), (x + a, y + b, 0.91 + c)))
    return _made([((0, 0, 0), (4.2, 3.4, 2.5))], things, voxel=0.02, uneven=0.005, noise=0.005, seed=3, seen=0.97)


def closet() -> TerrainMesh:
    """2 x 1.5 m with a chest, for tests."""
    air: Box = ((0, 0, 0), (2, 1.5, 2.4))
    return _made([air], [((-0.1, -0.1, 0), (0.6, 1.6, 0.5))], voxel=0.03, uneven=0.004, noise=0.006, seed=4, seen=0.98)


LARGE: dict[str, Callable[[], TerrainMesh]] = {
    "corridor, 35 x 21 m": corridor,
    "hall, 20 x 14 m": hall,
    "kitchen, furnished": kitchen,
}


def _table(x: float, y: float, length: float, width: float, high: float) -> list[Box]:
    legs = [(x + a * (length - 0.06), y + b * (width - 0.06)) for a in (0, 1) for b in (0, 1)]
    top: Box = ((x, y, high - 0.04), (x + length, y + width, high))
    return [top, *(((u, v, 0.0), (u + 0.06, v + 0.06, high)) for u, v in legs)]


def _made(
    air: Iterable[Box], things: Iterable[Box], *, voxel: float, uneven: float, noise: float, seed: int, seen: float
) -> TerrainMesh:
    """A mesh of what is air, less what things take of it.

    Args:
        voxel: metres. uneven: metres RMS that the surface is off. noise: metres of noise that the mesh states.
        seen: share of the surface that was seen.
    """
    from skimage.measure import marching_cubes

    air = list(air)
    # Where two solids only touch, the noise would open caves that nobody sees; things go into the floor.
    things = [((x, y, z or -0.3), upper) for (x, y, z), upper in things]
    corners = np.array(air)
    lower, upper = corners[:, 0].min(0) - 4 * voxel, corners[:, 1].max(0) + 4 * voxel
    axes = [np.arange(low, high + voxel, voxel, dtype=np.float32) for low, high in zip(lower, upper, strict=True)]
    shape = tuple(len(a) for a in axes)
    field: F32 = np.full(shape, BAND * voxel, np.float32)  # positive in what is solid
    for boxes, sign, keep in ((air, 1, np.minimum), (things, -1, np.maximum)):
        for box in boxes:
            window, off = _distance(box, axes, lower, voxel)
            field[window] = keep(field[window], sign * off)
    np.clip(field, -BAND * voxel, BAND * voxel, out=field)
    rng = np.random.default_rng(seed)
    bumps = ndimage.gaussian_filter(rng.standard_normal(shape, dtype=np.float32), 2.0, mode="wrap")
    vertices, faces, _, _ = marching_cubes(field + bumps * (uneven / bumps.std()), 0.0)
    vertices = (lower + vertices * voxel).astype(float)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(1)
    if normal[middle[:, 2] < BAND * voxel][:, 2].mean() < 0:  # the floor faces up
        faces, normal = faces[:, ::-1], -normal
    under = (normal[:, 2] < -0.5 * np.linalg.norm(normal, axis=1)) & (middle[:, 2] < LOW)
    blobs = ndimage.gaussian_filter(rng.standard_normal(((upper - lower) // UNSEEN + 2).astype(int)), 1.0)
    at = ((middle - lower) / UNSEEN).astype(int)
    hidden = blobs[tuple(np.clip(at, 0, np.array(blobs.shape) - 1).T)] > np.quantile(blobs, seen)
    used, index = np.unique(faces[~under & ~hidden], return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    quality = MeshQuality(len(used), len(faces), False, True, 0, 0, 1, None)
    return TerrainMesh(vertices[used], faces, None, np.zeros(len(faces), bool), quality, "made", voxel, noise)


def _distance(box: Box, axes: list[F32], lower: NDArray[np.float64], voxel: float) -> tuple[tuple[slice, ...], F32]:
    """(window of the grid about a box, metres outside its nearest face there; negative inside)."""
    window = tuple(
        slice(max(int((a - o) / voxel) - BAND - 1, 0), int((b - o) / voxel) + BAND + 3)
        for a, b, o in zip(*box, lower, strict=True)
    )
    off = [np.maximum(a - axis[part], axis[part] - b) for a, b, axis, part in zip(*box, axes, window, strict=True)]
    x, y, z = np.ix_(*off)
    return window, np.maximum(np.maximum(x, y), z)
