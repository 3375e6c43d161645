"""Small rooms as a camera leaves them: walls with one side, furniture without undersides. Metres, floor at 0."""

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

from realsim.core.types import MeshQuality, TerrainMesh
from tests.truths.solids import block, with_floor

Sheet = tuple[list[list[float]], list[float]]
"""Four corners in order, and the direction from which it was seen."""


def corridor() -> TerrainMesh:
    """Six metres between two walls with a door's recess, open at both ends, nothing seen behind the walls."""
    high = 2.4
    left: list[Sheet] = [_wall([-3, 0.8], [3, 0.8], high, [0, -1, 0])]
    right = [
        _wall([-3, -0.8], [-0.5, -0.8], high, [0, 1, 0]),
        _wall([-0.5, -0.95], [0.5, -0.95], high, [0, 1, 0]),
        _wall([0.5, -0.8], [3, -0.8], high, [0, 1, 0]),
        _wall([-0.5, -0.8], [-0.5, -0.95], high, [1, 0, 0]),
        _wall([0.5, -0.8], [0.5, -0.95], high, [-1, 0, 0]),
    ]
    return _seen(Manifold(), [_level(-3, -0.95, 3, 0.8, 0.0), *left, *right])


def room() -> TerrainMesh:
    """Four by three metres with a ceiling, a table, a chair and a cupboard."""
    x, y, high = 2.0, 1.5, 2.5
    walls = [
        _wall([-x, y], [x, y], high, [0, -1, 0]),
        _wall([-x, -y], [x, -y], high, [0, 1, 0]),
        _wall([-x, -y], [-x, y], high, [1, 0, 0]),
        _wall([x, -y], [x, y], high, [-1, 0, 0]),
    ]
    ceiling: Sheet = ([[-x, -y, high], [x, -y, high], [x, y, high], [-x, y, high]], [0, 0, -1])
    things = _table(-0.9, 0.6) + _chair(0.6, 0.2) + [block(1.6, -1.1, 0.7, 0.7, 1.2)]
    return _seen(_union(things), [_level(-x, -y, x, y, 0.0), ceiling, *walls])


def table() -> TerrainMesh:
    """A table on a floor."""
    return _seen(_union(_table(0, 0)), [_level(-1.2, -1, 1.2, 1, 0.0)])


def chair() -> TerrainMesh:
    """A chair on a floor."""
    return _seen(_union(_chair(0, 0)), [_level(-0.8, -0.8, 0.8, 0.8, 0.0)])


def open_stairs() -> TerrainMesh:
    """Eight treads without risers between two stringers, seen from above and in front."""
    treads = [block(0.26 * k, 0, 0.26, 0.8, 0.19 * (k + 1), 0.19 * (k + 1) - 0.04) for k in range(8)]
    return _seen(_union(treads), [_level(-1, -1, 2.5, 1, 0.0)])


ROOMS: dict[str, Callable[[], TerrainMesh]] = {f.__name__: f for f in (corridor, room, table, chair, open_stairs)}


def _table(x: float, y: float) -> list[Manifold]:
    legs = [block(x + 0.5 * a, y + 0.3 * b, 0.06, 0.06, 0.72) for a in (-1, 1) for b in (-1, 1)]
    return [block(x, y, 1.2, 0.8, 0.74, 0.71), *legs]


def _chair(x: float, y: float) -> list[Manifold]:
    legs = [block(x + 0.18 * a, y + 0.18 * b, 0.04, 0.04, 0.43) for a in (-1, 1) for b in (-1, 1)]
    return [block(x, y, 0.42, 0.42, 0.45, 0.42), block(x + 0.19, y, 0.04, 0.42, 0.9, 0.43), *legs]


def _union(parts: list[Manifold]) -> Manifold:
    whole = Manifold()
    for part in parts:
        whole += part
    return whole


def _wall(a: list[float], b: list[float], high: float, seen_from: list[float]) -> Sheet:
    return [[*a, 0.0], [*b, 0.0], [*b, high], [*a, high]], seen_from


def _level(x0: float, y0: float, x1: float, y1: float, z: float) -> Sheet:
    return [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], [0, 0, 1]


def _seen(solid: Manifold, sheets: list[Sheet]) -> TerrainMesh:
    """Solids without what faces down, and sheets wound toward where they were seen from; all of it measured."""
    vertices, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    if not solid.is_empty():
        whole = with_floor(solid)
        vertices, triangles = whole.vertices, whole.triangles[:-2]
        corners = vertices[triangles]
        down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < -1e-12
        triangles = triangles[~down]
    for corners_of, seen_from in sheets:
        quad = np.array(corners_of)
        order = [[0, 1, 2], [0, 2, 3]]
        if np.cross(quad[1] - quad[0], quad[2] - quad[0]) @ seen_from < 0:
            order = [[0, 2, 1], [0, 3, 2]]
        triangles = np.concatenate([triangles, np.array(order, np.int32) + len(vertices)]).astype(np.int32)
        vertices = np.concatenate([vertices, quad])
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, 1, None)
    return TerrainMesh(vertices, triangles, None, np.zeros(len(triangles), bool), quality, "rooms", 0.0)
