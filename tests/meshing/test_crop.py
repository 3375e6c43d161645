"""A mesh is cut exactly at the bounds, however large its triangles."""

import numpy as np
import pytest

from realsim.core.meshes import edges_of
from realsim.meshing.scan import crop
from realsim.meshing.surface import Surface

BOUNDS = np.array([[-1.0, -0.5, -0.1], [2.0, 0.7, 0.5]])


def sheet(size: float, z: float = 0.0) -> Surface:
    V = np.array([[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]])
    return Surface(V, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.array([[0, 0, 0], [200, 0, 0]] * 2, np.uint8))


def test_a_floor_of_two_triangles_fills_the_bounds() -> None:
    cut = crop(sheet(5.0), BOUNDS)
    assert cut.areas().sum() == pytest.approx(3.0 * 1.2)
    assert cut.vertices.min(0) == pytest.approx([-1, -0.5, 0])
    assert cut.vertices.max(0) == pytest.approx([2, 0.7, 0])
    assert (cut.crosses()[:, 2] > 0).all(), "the winding stays"
    assert cut.colors is not None
    assert len(cut.colors) == len(cut.vertices)


def test_what_is_inside_stays_as_it_is() -> None:
    inside = sheet(0.3)
    cut = crop(inside, BOUNDS)
    assert np.array_equal(cut.vertices, inside.vertices)
    assert np.array_equal(cut.triangles, inside.triangles)


def test_what_is_outside_goes() -> None:
    assert len(crop(sheet(5.0, z=1.0), BOUNDS).triangles) == 0


def test_neighbours_stay_neighbours() -> None:
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-3, 3, 8), np.linspace(-3, 3, 8))
    V = np.column_stack([u.ravel(), v.ravel(), 0.05 * rng.standard_normal(64)])
    k = np.arange(64).reshape(8, 8)
    a, b, c, d = (m.ravel() for m in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    cut = crop(
        Surface(V, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)), BOUNDS
    )
    edges = edges_of(cut.triangles)
    count = edges.uses
    middle = cut.vertices[edges.runs[edges.order[edges.first]]].mean(1)[count == 1]
    on_bounds = (np.abs(middle[:, :, None] - BOUNDS.T) < 1e-9).any((1, 2))
    assert on_bounds.all(), "only the bounds are open"
    assert count.max() == 2
