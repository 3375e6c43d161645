"""Laws of least squares: the optimum of scipy, of a linear problem in closed form, and of poses in any gauge."""

import numpy as np
import pytest
import scipy.optimize
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix

from realsim.core.geometry import exp_so3
from realsim.core.least_squares import Normal, cauchy, differences, least_squares

seeds = st.integers(0, 10_000)


def linear(seed: int, rows: int = 30, size: int = 4) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((rows, size)), rng.standard_normal(rows)


@given(seeds)
def test_a_linear_problem_with_a_prior_has_its_closed_form(seed: int) -> None:
    A, b = linear(seed)
    mean, sigma, start = np.random.default_rng(seed).uniform(0.5, 2, (3, 4))
    for J in (A, csr_matrix(A)):
        found = least_squares(lambda x, J=J: (A @ x - b, J), start, prior=(start - mean, sigma))
        assert found is not None
        exact = np.linalg.solve(A.T @ A + np.diag(sigma**-2), A.T @ b + mean / sigma**2)
        np.testing.assert_allclose(found.state, exact, atol=1e-6)


def bent(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, samples of a * exp(-b t) + c with outliers, and the start."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform([1, 0.5, -1], [3, 2, 1])
    t = np.linspace(0, 3, 60)
    y = a * np.exp(-b * t) + c + 0.05 * rng.standard_normal(60)
    y[rng.choice(60, 5)] += 2
    return t, y, np.array([a + 0.3, b + 0.2, c - 0.1])


@settings(deadline=None, max_examples=20)
@given(seeds, st.booleans(), st.booleans())
def test_the_optimum_is_that_of_scipy(seed: int, robust: bool, bounded: bool) -> None:
    t, y, start = bent(seed)
    low, high = (start - 0.2, start + 0.1) if bounded else (start - np.inf, start + np.inf)

    def residual(x: np.ndarray) -> np.ndarray:
        return (x[0] * np.exp(-x[1] * t) + x[2] - y) / 0.05

    theirs = scipy.optimize.least_squares(
        residual, start, bounds=(low, high), loss="cauchy" if robust else "linear", f_scale=2.0, xtol=1e-12, ftol=1e-12
    )
    assume(theirs.success)  # some draws are all but a line: the rate goes to zero, and neither ends
    loss = {"loss": cauchy(2.0)} if robust else {}
    ours = least_squares(
        differences(residual, np.full(3, 1e-5)), start, bounds=(low, high), iterations=300, least_gain=1e-13, **loss
    )
    assert ours is not None
    assert ours.cost <= 2 * theirs.cost * (1 + 1e-5)
    assert ((low <= ours.state) & (ours.state <= high)).all()


@given(seeds)
def test_a_turn_is_found_through_its_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, true = rng.standard_normal((10, 3)), exp_so3(rng.uniform(-1, 1, 3))
    Q = P @ true.T

    def model(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = P @ R.T
        return (moved - Q).ravel(), np.stack([np.cross(axis, moved).ravel() for axis in np.eye(3)], axis=1)

    found = least_squares(model, np.eye(3), move=lambda R, w: exp_so3(w) @ R, tolerance=1e-12, least_gain=1e-15)
    assert found is not None
    np.testing.assert_allclose(found.state, true, atol=1e-6)


@given(seeds, st.integers(1, 5))
def test_eliminated_points_change_nothing(seed: int, points: int) -> None:
    rng = np.random.default_rng(seed)
    cameras, size = 7, 7 + 3 * points
    rows = []
    for k in range(points):
        J = np.zeros((8, size))
        J[:, :cameras], J[:, cameras + 3 * k : cameras + 3 * k + 3] = (
            rng.standard_normal((8, cameras)),
            rng.normal(size=(8, 3)),
        )
        rows.append(J)
    J = np.vstack([*rows, np.eye(size)])
    b = rng.standard_normal((size, 2))
    found = Normal(csr_matrix(J.T @ J), 3 * points).solve(b)
    np.testing.assert_allclose(found, np.linalg.solve(J.T @ J, b), atol=1e-8)


def test_rows_of_a_group_are_outliers_together() -> None:
    _, weight = cauchy(1.0, np.array([0, 0, 1]))(np.array([0.0, 3.0, 0.0]))
    np.testing.assert_allclose(weight, [0.1, 0.1, 1.0])


def test_unknown_rows_have_no_say() -> None:
    A, b = linear(3)
    holes = np.where(np.arange(len(b)) % 3 == 0, np.nan, b)
    found = least_squares(lambda x: (A @ x - holes, A), np.zeros(4))
    assert found is not None
    known = np.isfinite(holes)
    np.testing.assert_allclose(found.state, np.linalg.lstsq(A[known], b[known], rcond=None)[0], atol=1e-6)


@pytest.mark.parametrize("impossible", [0.0, 0.5])
def test_an_impossible_state_is_no_answer(impossible: float) -> None:
    def model(x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return None if x[0] <= impossible else (x - 0.25, np.eye(1))

    found = least_squares(model, np.array([0.5]))
    assert found is None if impossible == 0.5 else found is not None and abs(found.state[0] - 0.25) < 1e-6
