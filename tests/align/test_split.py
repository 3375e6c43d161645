"""Level regions that run together come apart, those that are one stay one."""

import numpy as np
import pytest

from realsim.align.platforms import _level, large
from realsim.align.split import split

Rectangle = tuple[float, float, float, float, float]
"""x, y, length, width, height."""


def surface(*tops: Rectangle, noise: float = 0.001, turn: float = 0.3, seed: int = 0) -> np.ndarray:
    """A point about every 2 cm on each top, with noise in height, turned in the plan."""
    rng = np.random.default_rng(seed)
    parts = []
    for x, y, length, width, height in tops:
        u, v = np.meshgrid(np.arange(0.01, length, 0.02), np.arange(0.01, width, 0.02))
        xy = np.column_stack([x + u.ravel(), y + v.ravel()]) + rng.uniform(-0.004, 0.004, (u.size, 2))
        parts.append(np.column_stack([xy, height + noise * rng.standard_normal(len(xy))]))
    points = np.concatenate(parts)
    c, s = np.cos(turn), np.sin(turn)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def areas(points: np.ndarray) -> list[float]:
    """m^2 of each face, the largest first."""
    return sorted((len(part) * 0.02**2 for part in split(points)), reverse=True)


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
@pytest.mark.parametrize("size", [(0.9, 0.8), (0.6, 0.32)])
def test_one_face_stays_whole(size: tuple[float, float], noise: float) -> None:
    points = surface((0, 0, *size, 0.3), noise=noise)
    (part,) = split(points)
    assert len(part) > 0.97 * len(points)


def test_a_stake_that_touches_is_left_out() -> None:
    start = (0, 0, 0.9, 0.8, 0.3)
    found = areas(surface(start, (0.9, 0.3, 0.2, 0.2, 0.3)))
    assert found == pytest.approx([0.72], abs=0.02)


def test_a_box_that_is_a_little_lower_is_another_face() -> None:
    found = areas(surface((0, 0, 0.9, 0.8, 0.3), (0.9, 0.1, 0.5, 0.45, 0.288)))
    assert found == pytest.approx([0.72, 0.225], abs=0.04)


def test_two_boxes_joined_by_a_beam_are_two() -> None:
    found = areas(surface((0, 0, 0.8, 0.8, 0.3), (0.8, 0.35, 0.5, 0.1, 0.3), (1.3, 0, 0.8, 0.8, 0.3)))
    assert found == pytest.approx([0.64, 0.64], abs=0.03)


def test_a_row_of_stakes_is_no_face() -> None:
    assert areas(surface(*((0.24 * k, 0, 0.22, 0.22, 0.3) for k in range(5)))) == []


def test_a_slope_is_no_step() -> None:
    points = surface((0, 0, 0.9, 0.8, 0.3))
    points[:, 2] += 0.07 * points[:, 0]
    (part,) = split(points)
    assert len(part) > 0.97 * len(points)


def test_a_hole_in_what_was_seen_does_not_divide() -> None:
    points = surface((0, 0, 0.9, 0.8, 0.3), turn=0)
    hole = (np.abs(points[:, 0] - 0.45) < 0.04) & (np.abs(points[:, 1] - 0.4) < 0.05)
    (part,) = split(points[~hole])
    assert len(part) > 0.97 * (~hole).sum()


def test_a_ring_of_tilted_tops_is_no_level_face() -> None:
    """As a whole it has no slope, and a band of it at one height is large enough for a platform."""
    r, turn = np.meshgrid(np.arange(0.6, 1.1, 0.02), np.arange(0, 2 * np.pi, 0.02))
    ring = np.column_stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel(), (0.25 + 0.36 * r).ravel()])
    ring = np.random.default_rng(0).permutation(ring[np.abs(ring[:, 2] - 0.55) < 0.02])
    assert large(ring[:, :2], 0.02)
    assert not _level(ring)
    assert _level(surface((0, 0, 0.6, 0.32, 0.3), noise=0.003))


def test_a_hollow_seat_that_slopes_is_a_level_face() -> None:
    """Tilted by 4.5 degrees and hollow by 1 cm, as chairs are; one of 5 cm is a bowl."""
    seat = surface((0, 0, 0.42, 0.42, 0.4), turn=0, noise=0.002)
    middle = seat[:, :2] - seat[:, :2].mean(0)
    hollow = (middle**2).sum(1) / 0.21**2
    seat[:, 2] += 0.0787 * middle[:, 0]
    assert _level(seat + np.outer(0.01 * hollow, [0, 0, 1]))
    assert not _level(seat + np.outer(0.05 * hollow, [0, 0, 1]))
