"""The checks fire on meshes made wrong by hand, and stay quiet on sound ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from realsim.meshing.clean import canonical, tidy, uncrossed, weld
from realsim.meshing.decimate import decimate, hausdorff
from realsim.meshing.quality import check, degenerate, non_manifold
from realsim.meshing.surface import Surface, components, drop_islands, first_of_each


def cube(offset: float = 0.0, size: float = 1.0) -> Surface:
    V = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * size + offset
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    T = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Surface(V, np.array(T, np.int32))


def both(a: Surface, b: Surface) -> Surface:
    return Surface(
        np.concatenate([a.vertices, b.vertices]), np.concatenate([a.triangles, b.triangles + len(a.vertices)])
    )


def bumpy(n: int = 60) -> Surface:
    """An open sheet of 2 n^2 triangles over the unit square, waves of 3 cm."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    V = np.stack([x, y, 0.03 * np.sin(7 * x) * np.cos(5 * y)], -1).reshape(-1, 3)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    lower, upper = np.stack([i, i + n + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + 1], 1)
    return Surface(V, np.concatenate([lower, upper]).astype(np.int32))


def test_a_cube_is_sound() -> None:
    q = check(cube(size=2.0))
    assert (q.watertight, q.manifold, q.self_intersections, q.degenerate, q.components) == (True, True, 0, 0, 1)
    assert q.volume_m3 == pytest.approx(8.0)


def test_a_hole_a_flip_and_a_fin_are_found() -> None:
    c = cube()
    hole = check(c.where(np.arange(12) != 3))
    assert not hole.watertight
    assert hole.manifold
    assert hole.volume_m3 is None
    flipped = c.triangles.copy()
    flipped[0] = flipped[0, ::-1]
    assert non_manifold(Surface(c.vertices, flipped))[0] == 3
    fin = Surface(np.vstack([c.vertices, [[0.5, -1, 0.5]]]), np.vstack([c.triangles, [[0, 1, 8]]]).astype(np.int32))
    assert non_manifold(fin)[0] == 1
    assert not check(fin).manifold


def test_cubes_that_touch_at_a_corner_are_not_manifold_until_tidied() -> None:
    pair = weld(both(cube(), cube(offset=1.0)), 1e-6)
    assert len(pair.vertices) == 15
    assert non_manifold(pair) == (0, 1)
    clean = tidy(pair)
    assert len(clean.vertices) == 16
    assert check(clean).manifold


def test_self_intersections_are_counted_and_few_of_them_removed() -> None:
    crossed = both(cube(), cube(offset=0.5))
    assert check(crossed).self_intersections > 0
    assert check(uncrossed(crossed)).self_intersections > 0  # half of a mesh is never thrown away
    # a needle that pierces the sheet between its vertices
    needle = Surface(
        np.array([[0.503, 0.507, -0.2], [0.503, 0.507, 0.2], [0.5035, 0.5, 0.2]]), np.array([[0, 1, 2]], np.int32)
    )
    pierced = both(bumpy(), needle)
    assert check(pierced).self_intersections > 0
    assert check(uncrossed(pierced)).self_intersections == 0


def test_degenerate_triangles_are_found_and_removed() -> None:
    c = cube()
    V = np.vstack([c.vertices, [[0, 0, 0.5]]])
    bad = Surface(V, np.vstack([c.triangles, [[0, 1, 8], [2, 2, 3]]]).astype(np.int32))
    assert degenerate(bad).tolist() == [False] * 12 + [True, True]
    assert check(tidy(bad)).watertight


def test_islands_go_by_area_and_the_largest_stays() -> None:
    pair = both(cube(), cube(offset=5.0, size=0.1))
    assert components(pair.triangles)[0] == 2
    left, gone = drop_islands(pair, 0.1)
    assert (len(left.triangles), gone) == (12, 1)
    assert len(drop_islands(cube(size=0.1), 1.0)[0].triangles) == 12


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31))
def test_canonical_order_forgets_the_order_of_the_input(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = bumpy(5)
    p = rng.permutation(len(s.vertices))
    t = np.argsort(p)[s.triangles][rng.permutation(len(s.triangles))]
    t = np.take_along_axis(t, (rng.integers(3, size=(len(t), 1)) + np.arange(3)) % 3, axis=1)
    a, b = canonical(s), canonical(Surface(s.vertices[p], t.astype(np.int32)))
    assert a.vertices.tobytes() == b.vertices.tobytes()
    assert a.triangles.tobytes() == b.triangles.tobytes()


@settings(max_examples=6, deadline=None)
@given(st.integers(200, 5000), st.sampled_from([0.0002, 0.001, 0.005]))
def test_decimation_is_within_its_bound(target: int, bound: float) -> None:
    sheet = bumpy()
    result = decimate(sheet, target, bound, seed=1)
    assert hausdorff(sheet, result.surface, seed=2) <= 1.2 * bound  # other samples than those that were bounded
    assert result.error <= bound
    if result.within:
        assert len(result.surface.triangles) <= target
    border = result.surface.vertices
    assert np.allclose(border.min(0)[:2], 0, atol=bound)
    assert np.allclose(border.max(0)[:2], 1, atol=bound)


@given(
    arrays(np.int64, st.tuples(st.integers(0, 30), st.integers(2, 3)), elements=st.sampled_from([0, 1, 2, 7, 2**40]))
)
def test_first_rows_are_those_of_numpy(rows: np.ndarray) -> None:
    assert np.array_equal(first_of_each(rows), np.unique(rows, axis=0, return_index=True)[1])
