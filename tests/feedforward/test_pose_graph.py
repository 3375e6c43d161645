"""Laws of the pose graph and of the adjustment of poses and points."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.core.geometry import invert_T
from realsim.feedforward.rgbd.features import Tracks
from realsim.feedforward.rgbd.pose_graph import (
    Edge,
    adjoint,
    chain_poses,
    components,
    exp_se3,
    log_se3,
    optimise,
    whitening,
)
from realsim.feedforward.rgbd.refine import adjust_to_features

ROOT = whitening(0.01, 0.005)


def random_poses(n: int, seed: int, spread: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return exp_se3(np.concatenate([rng.normal(0, spread, (n, 3)), rng.normal(0, 0.5, (n, 3))], 1))


def ring(T: np.ndarray, noise: float = 0.0, seed: int = 0, reach: int = 2) -> list[Edge]:
    """Edges to the next `reach` poses around a closed ring."""
    rng = np.random.default_rng(seed)
    n = len(T)
    pairs = [(i, (i + k) % n) for i in range(n) for k in range(1, reach + 1)]
    wrong = exp_se3(noise * rng.standard_normal((len(pairs), 6)))
    return [Edge(i, j, invert_T(T[i]) @ T[j] @ E, 1.0, ROOT) for (i, j), E in zip(pairs, wrong, strict=True)]


@given(st.integers(0, 1000))
def test_exp_and_log_are_inverse(seed: int) -> None:
    d = np.random.default_rng(seed).normal(0, 0.8, (4, 6))
    assert np.allclose(log_se3(exp_se3(d)), d, atol=1e-9)


@given(st.integers(0, 1000))
def test_adjoint_moves_a_step_to_the_other_side(seed: int) -> None:
    T, d = random_poses(3, seed), 1e-6 * np.random.default_rng(seed).standard_normal((3, 6))
    moved = exp_se3((adjoint(T) @ d[..., None])[..., 0]) @ T
    assert np.allclose(T @ exp_se3(d), moved, atol=1e-10)


@given(st.integers(0, 1000))
def test_exact_edges_give_exact_poses_in_any_order(seed: int) -> None:
    T = random_poses(8, seed)
    edges = ring(T)
    np.random.default_rng(seed).shuffle(edges)
    found = chain_poses(8, edges)
    assert np.allclose(found, invert_T(T[0]) @ T, atol=1e-8)
    found, chi = optimise(found, edges)
    assert np.allclose(found, invert_T(T[0]) @ T, atol=1e-7)
    assert chi.max() < 1e-5


def test_the_gauge_does_not_matter() -> None:
    T = random_poses(10, 1)
    edges = ring(T, noise=0.01)
    start = chain_poses(10, edges)
    G = random_poses(1, 9)[0]
    here, chi_here = optimise(start, edges)
    there, chi_there = optimise(G @ start, edges)
    assert np.allclose(G @ here, there, atol=1e-6)
    assert np.allclose(chi_here, chi_there, atol=1e-4)


def test_closing_the_loop_beats_the_tree() -> None:
    T = random_poses(20, 2)
    edges = ring(T, noise=0.01, reach=3)
    truth = invert_T(T[0]) @ T
    tree = chain_poses(20, edges)
    found, _ = optimise(tree, edges)

    def rms(X: np.ndarray) -> float:
        return float(np.sqrt(((X[:, :3, 3] - truth[:, :3, 3]) ** 2).sum(1).mean()))

    assert rms(found) < 0.7 * rms(tree)


def test_a_false_edge_is_seen_and_does_no_harm() -> None:
    T = random_poses(12, 3)
    edges = ring(T, noise=0.001, reach=3)
    edges.append(Edge(0, 6, random_poses(1, 5)[0], 0.1, ROOT))
    found, chi = optimise(chain_poses(12, edges), edges)
    assert chi.argmax() == len(edges) - 1
    assert chi[-1] > 20 * np.median(chi)
    assert np.abs(found - invert_T(T[0]) @ T).max() < 0.03


def test_components_are_ordered_by_size() -> None:
    eye = np.eye(4)
    edges = [Edge(0, 1, eye, 1, ROOT), Edge(3, 4, eye, 1, ROOT), Edge(4, 5, eye, 1, ROOT)]
    assert [p.tolist() for p in components(7, edges)] == [[3, 4, 5], [0, 1], [2], [6]]
    assert np.isnan(chain_poses(7, edges)[3]).all()


# ---------------------------------------------------------------- adjustment of poses and points


def problem(seed: int, cameras: int = 6, points: int = 200) -> tuple[np.ndarray, Tracks]:
    """Cameras that look at a cloud about 2 m away, exact measurements in image and depth."""
    rng = np.random.default_rng(seed)
    X = rng.uniform([-1, -1, 1.5], [1, 1, 3], (points, 3))
    T = exp_se3(np.concatenate([rng.normal(0, 0.2, (cameras, 3)), rng.normal(0, 0.1, (cameras, 3))], 1))
    p, c = (a.ravel() for a in np.meshgrid(np.arange(points), np.arange(cameras), indexing="ij"))
    P = np.einsum("mab,ma->mb", T[c, :3, :3], X[p] - T[c, :3, 3])
    return T, Tracks(c, p, P[:, :2] / P[:, 2:], P[:, 2].copy(), np.full(len(c), 500.0), points, p)


def errors(found: np.ndarray, T: np.ndarray) -> float:
    """Largest difference of the cameras, seen from the first one."""
    return float(np.abs(invert_T(found[0]) @ found - invert_T(T[0]) @ T).max())


@pytest.mark.parametrize("seed", [0, 1])
def test_an_adjustment_recovers_an_injected_perturbation(seed: int) -> None:
    T, tracks = problem(seed)
    start = T @ exp_se3(0.02 * np.random.default_rng(seed + 10).standard_normal((len(T), 6)))
    step, _ = adjust_to_features(start, tracks)
    assert errors(step.state.T, T) < 1e-4
    assert np.abs(step.track_residual[:, :2]).max() < 0.1


def test_an_adjustment_is_not_led_by_outliers() -> None:
    T, tracks = problem(3)
    rng = np.random.default_rng(0)
    wrong = rng.random(len(tracks.z)) < 0.05
    xy = tracks.xy + 0.1 * rng.standard_normal(tracks.xy.shape) * wrong[:, None]
    step, left = adjust_to_features(T, replace(tracks, xy=xy))
    assert errors(step.state.T, T) < 1e-3
    assert len(left.z) <= (~wrong).sum()
