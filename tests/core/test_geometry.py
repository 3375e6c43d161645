"""Laws of rotations and rigid transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from realsim.core.geometry import (
    R_to_quat,
    angle_deg,
    cross,
    exp_so3,
    fit_plane,
    invert_T,
    is_rotation,
    make_T,
    nearest_rotation,
    outside_hull,
    quat_to_R,
    transform,
)
from realsim.core.types import Intrinsics

numbers = st.floats(-2, 2, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(vectors)
def test_exp_is_a_rotation_and_log_inverts_it(w: np.ndarray) -> None:
    R = exp_so3(w)
    assert is_rotation(R, 1e-9)
    if np.linalg.norm(w) < np.pi - 1e-3:
        np.testing.assert_allclose(Rotation.from_matrix(R).as_rotvec(), w, atol=1e-7)


@given(vectors, vectors)
def test_rigid_transforms_form_a_group(w: np.ndarray, t: np.ndarray) -> None:
    T = make_T(exp_so3(w), t)
    np.testing.assert_allclose(T @ invert_T(T), np.eye(4), atol=1e-12)
    points = np.arange(12.0).reshape(4, 3)
    np.testing.assert_allclose(transform(invert_T(T), transform(T, points)), points, atol=1e-9)


@given(vectors)
def test_quaternion_round_trip(w: np.ndarray) -> None:
    R = exp_so3(w)
    np.testing.assert_allclose(quat_to_R(R_to_quat(R)), R, atol=1e-9)


def test_nearest_rotation_mends_noise_and_never_reflects() -> None:
    R = exp_so3([0.3, -0.2, 0.9])
    assert angle_deg(R.T @ nearest_rotation(R + 1e-4)) < 0.05
    assert np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -1.0]))) == pytest.approx(1)


def test_cross_products_are_numpys() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    np.testing.assert_array_equal(cross(a, b[0]), np.cross(a, b[0]))


def test_plane_of_points_on_a_plane() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1, 1, (500, 2))
    points = np.column_stack([xy, 0.2 * xy[:, 0] - 0.5 * xy[:, 1] + 3])
    n, d, rms = fit_plane(points)
    assert rms < 1e-9
    np.testing.assert_allclose(points @ n + d, 0, atol=1e-9)


def test_resized_intrinsics_keep_the_image_borders() -> None:
    K = Intrinsics(640, 480, 600.0, 610.0, 319.5, 239.5)
    half = K.resized(320, 240)
    # The left border of the first pixel is at u = -0.5 on either grid and must look in the same direction.
    assert (-0.5 - K.cx) / K.fx == pytest.approx((-0.5 - half.cx) / half.fx)
    assert (479.5 - K.cy) / K.fy == pytest.approx((239.5 - half.cy) / half.fy)


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 3), st.floats(-1, 1), st.floats(-1, 1))
def test_distance_from_a_hull(turn: float, beyond: float, x: float, y: float) -> None:
    """Of a unit square, however it is turned and in whatever order its corners come."""
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    square = np.array([[1, 1], [-1, -1], [0.2, 0.3], [1, -1], [-1, 1.0]]) @ R.T
    inside, side, corner = np.array([[0.99 * x, 0.99 * y], [1 + beyond, y], [1 + beyond, 1 + beyond]]) @ R.T
    found = outside_hull(square, np.stack([inside, side, corner]))
    assert np.allclose(found, [0, beyond, beyond * np.sqrt(2)], atol=1e-9)
