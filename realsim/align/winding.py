"""Is a mesh wound inside out? Its triangles' sides are what tells a floor from a ceiling."""

import numpy as np

from realsim.core.types import F64

CLOSED = 0.05
"""The areas of a closed surface, as vectors, add up to nothing: to at most this share of its area."""
ROOM = 1.0
"""Metres: a closed surface that faces inward and is thicker than this is a room seen from inside."""
FEW = 0.2
"""Of the level area of a terrain less than this share faces up only if all of it is turned round."""
ALONG = float(np.cos(np.radians(25)))
"""Cosine within which a normal counts as along a direction."""
LEVEL = 0.05
"""Metres: how thick a layer counts as one level."""
CLEARLY = 4.0
"""How many times more of a mesh lies behind its largest surface than before it, if that is turned round."""


def inside_out(points: F64, normals: F64, up: F64 | None) -> bool:
    """Whether all of a mesh is wound the wrong way round; False where that is not clear.

    A closed surface has a volume, whose sign tells. Of an open one little faces up, where up is known. Where it is
    not, the rest of the mesh lies behind its largest surface, which then faces neither of a file's usual directions up.

    Args:
        points: (M, 3) metres, spread evenly over the mesh.
        normals: (M, 3) unit, of their triangles.
        up: (3,) unit, or None.
    """
    if is_closed(normals):
        # Of a closed surface: a negative volume, and no room. Its thickness is its volume by the area of its shadow.
        volume = float(np.einsum("ij,ij->i", normals, points - points.mean(0)).mean()) / 3
        shadow = float(np.abs(normals @ main_direction(normals)).mean()) / 2
        return -ROOM < volume / shadow < 0
    if up is not None:
        facing = normals @ up
        upper, lower = np.mean(facing > 0.5), np.mean(facing < -0.5)
        return bool(upper < FEW * (upper + lower))
    return _rest_behind(points, normals)


def is_closed(normals: F64) -> bool:
    """Whether unit normals (M, 3), spread evenly over a surface, add up to nothing, as those of solids do."""
    return bool(np.linalg.norm(normals.mean(0)) < CLOSED)


def _rest_behind(points: F64, normals: F64) -> bool:
    side = main_direction(normals)
    side = side if np.mean(normals @ side > ALONG) > np.mean(normals @ side < -ALONG) else -side
    if max(side[2], side[1]) > ALONG:
        return False
    height, level = points @ side, normals @ side > ALONG
    if not level.any():
        return False
    layer, count = np.unique(np.floor(height[level] / LEVEL), return_counts=True)
    ground = (layer[np.argmax(count)] + 0.5) * LEVEL
    before, behind = np.mean(height > ground + 1.5 * LEVEL), np.mean(height < ground - 1.5 * LEVEL)
    return bool(behind > max(CLEARLY * before, 0.01))


def main_direction(normals: F64) -> F64:
    """(3,) unit: along which most of the area faces, one way or the other."""
    return np.linalg.eigh(normals.T @ normals)[1][:, 2]
