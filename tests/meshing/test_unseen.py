"""What no camera saw, and from where it would come into view."""

from dataclasses import replace

import numpy as np

from realsim.core.types import AlignedScene, Platform
from realsim.meshing.surface import Surface
from realsim.meshing.unseen import unseen

from .scenes import Box, one_side, scene


def level(x0: float, y0: float, x1: float, y1: float, z: float = 0.0) -> Surface:
    """A rectangle that faces up."""
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def wall(x0: float, x1: float, y: float, high: float) -> Surface:
    corners = np.array([[x0, y, 0.0], [x1, y, 0], [x1, y, high], [x0, y, high]])
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def joined(*parts: Surface) -> Surface:
    counts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    triangles = np.concatenate([p.triangles + n for p, n in zip(parts, counts, strict=False)]).astype(np.int32)
    return Surface(np.concatenate([p.vertices for p in parts]), triangles)


def with_ends(aligned: AlignedScene) -> AlignedScene:
    def end(x: float, role: str) -> Platform:
        outline = np.array([[x - 0.3, -0.3], [x + 0.3, -0.3], [x + 0.3, 0.3], [x - 0.3, 0.3]])
        return Platform(np.array([x, 0, 0]), np.array([0.6, 0.6, 0.2]), 0.0, 0.36, outline, role)

    return replace(aligned, platforms=(end(0.0, "start"), end(3.0, "goal")))


def test_the_place_named_sees_what_is_missing() -> None:
    """A wall hides the ground to the left of it: it is seen from the left, and from nowhere on the right."""
    aligned = with_ends(scene([Box((-0.1, -0.1, 0.0), (0.1, 0.1, 0.1))], one_side()))
    seen = joined(level(-1, -2, 4, 0), wall(-1, 4, 0.0, 1.2))
    found = unseen(aligned, seen, level(0, 0.05, 3, 0.45))
    assert found["look_from"][1] > 0.0
    assert found["share"] > 0.9


def test_areas_on_the_way_and_beside_it() -> None:
    aligned = with_ends(scene([Box((-0.1, -0.1, 0.0), (0.1, 0.1, 0.1))], one_side()))
    fine = joined(*(level(0.1 * k, -0.5, 0.1 * k + 0.1, 0.5) for k in range(30)))
    beside = level(0.0, 1.0, 3.0, 2.0)
    found = unseen(aligned, fine, beside)
    assert np.isclose(found["area_m2"], 6.0)
    assert np.isclose(found["unseen_m2"], 3.0)
    assert np.isclose(found["way_area_m2"], 3.0)
    assert found["way_unseen_m2"] == 0
    assert "look_from" not in found
    assert "way_area_m2" not in unseen(replace(aligned, platforms=()), fine, beside)
