"""Poses from matches: exact where the matches are, and of the views in any order."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from training.pointmap import loss, poses


def seen(seed: int, views: int, lost: float = 0.0, places: int = 40) -> tuple[torch.Tensor, ...]:
    """(points, matches, R, t): places in front of cameras in random order, a share `lost` of them matched wrongly."""
    draw = torch.Generator().manual_seed(seed)
    q = torch.randn(1, views, 4, generator=draw) * 0.15 + torch.tensor([1.0, 0, 0, 0])
    R = poses.matrix(q / q.norm(dim=-1, keepdim=True))
    t = 0.3 * torch.randn(1, views, 3, generator=draw)
    world = torch.rand(places, 3, generator=draw) * torch.tensor([2.0, 2, 2]) + torch.tensor([-1.0, -1, 2])
    points = (world[None, None] - t[:, :, None]) @ R
    order = [torch.randperm(places, generator=draw) for _ in range(views)]
    points = torch.stack([points[0, v][order[v]] for v in range(views)])[None]
    matches = torch.zeros(1, views, views, places, places)
    for i in range(views):
        for j in range(views):
            partner = torch.argsort(order[j])[order[i]]
            wrong = torch.rand(places, generator=draw) < lost
            partner = torch.where(wrong, torch.randint(0, places, (places,), generator=draw), partner)
            matches[0, i, j, torch.arange(places), partner] = 0.9
    return points, matches, R, t


def off(found: tuple[torch.Tensor, torch.Tensor], R: torch.Tensor, t: torch.Tensor) -> float:
    """Largest error of relative rotations (chord) and translations (m)."""
    a, b = loss.relative(*found), loss.relative(R, t)
    return max(float((a[0] - b[0]).abs().max()), float((a[1] - b[1]).abs().max()))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_perfect_matches_give_the_poses(seed: int, views: int) -> None:
    points, matches, R, t = seen(seed, views)
    assert off(poses.solve(points, matches), R, t) < 2e-3


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_a_fifth_of_wrong_matches_does_little(seed: int) -> None:
    points, matches, R, t = seen(seed, 3, lost=0.2)
    assert off(poses.solve(points, matches), R, t) < 0.05


def test_views_that_share_nothing_are_reached_through_others() -> None:
    points, matches, R, t = seen(3, 4)
    for i in range(4):
        for j in range(4):
            if abs(i - j) > 1:
                matches[:, i, j] = 0
    assert off(poses.solve(points, matches), R, t) < 2e-3


def test_without_matches_nothing_moves() -> None:
    points, matches, _, _ = seen(5, 3)
    R, t = poses.solve(points, 0 * matches)
    torch.testing.assert_close(R, torch.eye(3).expand_as(R), atol=1e-4, rtol=0)
    torch.testing.assert_close(t, torch.zeros_like(t), atol=1e-4, rtol=0)
