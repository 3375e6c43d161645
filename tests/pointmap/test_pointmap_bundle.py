"""Depth and poses by the matches: right where they are, for any order of views and any unit, no more than told."""

import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.pointmap.test_pointmap_poses import off, seen
from training.pointmap import bundle, loss, poses
from training.pointmap.layouts import library
from training.pointmap.network import TINY, PointmapNet
from training.pointmap.scenes import Generator

GRID = (5, 8)


def wrong(seed: int, views: int, lost: float = 0.0) -> tuple[torch.Tensor, ...]:
    """(rays, log z with an error of each view's scale, that error, matches, R, t)."""
    points, matches, R, t = seen(seed, views, lost)
    assume(bool((points[..., 2] > 0.3).all()))
    error = 0.1 * torch.randn(1, views, generator=torch.Generator().manual_seed(seed + 1))
    error = error - error.mean()
    return points[..., :2] / points[..., 2:], points[..., 2].log() + error[..., None], error, matches, R, t


def solved(
    rays: torch.Tensor, log_z: torch.Tensor, matches: torch.Tensor, expected: float = 0.1
) -> tuple[torch.Tensor, ...]:
    """(what is added to log z (B, V, N), R, t, how well it is told)."""
    z = log_z.exp()[..., None]
    begun = poses.solve(torch.cat([rays * z, z], -1), matches)
    weights, R, t, told = bundle.adjust(rays, log_z, torch.full(log_z.shape[:2], expected), matches, *begun, GRID)
    return bundle.correction(weights, *GRID).flatten(2), R, t, told


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 8))
def test_perfect_matches_give_scales_and_poses(seed: int, views: int) -> None:
    rays, log_z, error, matches, R, t = wrong(seed, views)
    added, R_found, t_found, _ = solved(rays, log_z, matches)
    left = error[..., None] + added
    left = left - left.mean()
    assert float(left.abs().mean()) < 0.2 * float(error.abs().mean()) + 0.005
    size = float((error[..., None] + added).mean().exp())
    assert off((R_found, t_found / size), R, t) < 0.05


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_a_fifth_of_wrong_matches_leaves_most_of_it(seed: int) -> None:
    rays, log_z, error, matches, _, _ = wrong(seed, 4, lost=0.2)
    left = error[..., None] + solved(rays, log_z, matches)[0]
    assert float((left - left.mean()).abs().mean()) < 0.5 * float(error.abs().mean()) + 0.01


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.permutations(range(4)), st.floats(0.1, 10))
def test_order_and_unit_change_nothing_else(seed: int, order: list[int], unit: float) -> None:
    rays, log_z, _, matches, _, _ = wrong(seed, 4)
    a, R, t, told = solved(rays, log_z, matches)
    shift = torch.tensor(unit).log()
    b, R_other, t_other, told_other = solved(rays[:, order], log_z[:, order] + shift, matches[:, order][:, :, order])
    torch.testing.assert_close(b, a[:, order], atol=1e-2, rtol=0)
    torch.testing.assert_close(bundle.left(told_other), bundle.left(told[:, order]), atol=1e-2, rtol=0)
    first, other = loss.relative(R[:, order], t[:, order]), loss.relative(R_other, t_other / unit)
    for x, y in zip(first, other, strict=True):
        torch.testing.assert_close(x, y, atol=1e-2, rtol=0)


def test_nothing_is_corrected_without_doubt_or_without_matches() -> None:
    rays, log_z, _, matches, _, _ = wrong(7, 3)
    assert float(solved(rays, log_z, matches, expected=0.0)[0].abs().max()) == 0
    added, R, t, told = solved(rays, log_z, 0 * matches)
    assert float(added.abs().max()) < 1e-6
    assert float(told.abs().max()) == 0
    torch.testing.assert_close(R, torch.eye(3).expand_as(R), atol=1e-4, rtol=0)
    torch.testing.assert_close(t, torch.zeros_like(t), atol=1e-4, rtol=0)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 4), st.floats(1, 5), st.floats(0.01, 0.2))
def test_precision_is_that_of_parallax_and_of_the_other_depth(columns: int, z: float, expected: float) -> None:
    """Two views of a wall, the second moved by some patches: what it does not show, nothing is told of."""
    r, c = (x.flatten() for x in torch.meshgrid(torch.arange(5.0), torch.arange(8.0), indexing="ij"))
    rays = torch.stack([c - 3.5, r - 2], -1)[None, None].expand(1, 2, -1, -1) / 8
    match = ((r[:, None] == r) & (c[:, None] - columns == c)).float()
    matches = torch.stack([torch.stack([torch.eye(40), match]), torch.stack([match.T, torch.eye(40)])])[None]
    R, t = torch.eye(3).expand(1, 2, 3, 3), torch.tensor([[[0.0, 0, 0], [z * columns / 8, 0, 0]]])
    log_z = torch.full((1, 2, 40), z).log()
    told = bundle.adjust(rays, log_z, torch.full((1, 2), expected), matches, R, t, GRID)[3][0, 0]
    aside, along = columns / 8 / bundle.ASIDE, 1 / bundle.ALONG
    right = torch.where(c < columns, 0.0, expected**2 * (aside**2 + along**2))
    torch.testing.assert_close(told, right, rtol=0.05, atol=1e-6)


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_an_expected_error_falls_with_what_is_told_and_never_to_nothing(a: float, b: float) -> None:
    low, high = bundle.left(torch.tensor([min(a, b), max(a, b)]))
    assert float(high) + 1e-6 >= bundle.FINE**0.5
    assert float(high) <= float(low) <= float(bundle.left(torch.zeros(()))) == 1


def test_what_a_sensor_measured_stays() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    net, batch = PointmapNet(TINY), Generator(library(4, 3), 5, samples=1).batch(2, 4, 3, (32, 48))
    seeing = (batch.sensor > 0).flatten(1).any(1)
    assert seeing.any()
    assert not seeing.all()
    with torch.no_grad():
        a, b = (net(batch.images, batch.sensor, batch.K, adjusted=x) for x in (True, False))
    assert bool((a.log_error <= b.log_error)[~seeing].all())
    for name in ("log_z", "log_error", "R", "t"):
        x, y = getattr(a, name), getattr(b, name)
        torch.testing.assert_close(x[seeing], y[seeing], atol=1e-5, rtol=1e-5)
        assert float((x - y)[~seeing].abs().max()) > 1e-4
