"""Where a scanner stood is told by what hides behind what."""

import numpy as np

from realsim.capture.standpoint import stood_at


def room_from(position: np.ndarray, count: int = 40_000) -> np.ndarray:
    """Points where rays from a position meet a room of 6 x 4 x 2.5 m with a pillar in it."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    lower, upper = np.array([-3, -2, -1.2]), np.array([3, 2, 1.3])
    with np.errstate(divide="ignore"):
        t = np.where(way > 0, (upper - position) / way, (lower - position) / way).min(1)
        low, high = np.array([1.0, 0.5, -1.2]), np.array([1.4, 0.9, 1.3])
        near, far = (low - position) / way, (high - position) / way
    near, far = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
    t = np.where((near < far) & (near > 0), np.minimum(t, near), t)
    return position + t[:, None] * way


def test_a_scan_tells_its_own_standpoint() -> None:
    assert stood_at(room_from(np.zeros(3)), np.zeros(3))
    assert not stood_at(room_from(np.array([-0.8, 0.4, 0.2])), np.zeros(3))


def test_nobody_stands_beside_or_below_a_terrain() -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-2, 2, (20_000, 2)), np.zeros(20_000)])
    assert not stood_at(floor + np.array([0, 0, 1.0]), np.zeros(3))
    assert not stood_at(floor + np.array([0, 0, -1.0]), np.zeros(3))
    assert not stood_at(floor[:100], np.zeros(3))
