"""Laws of the network and of its loss: order of views, scale, choice of frame."""

from dataclasses import replace

import pytest
import torch

from realsim.core.errors import RealsimError
from training.pointmap import cameras, loss
from training.pointmap.layouts import library
from training.pointmap.network import TINY, PointmapNet, Prediction, Shape, count
from training.pointmap.scenes import Batch, Generator

SIZE = (32, 48)


@pytest.fixture(scope="module")
def batch() -> Batch:
    torch.set_num_threads(1)
    return Generator(library(8, 3), 5, samples=1).batch(2, 4, 3, SIZE)


@pytest.fixture
def net() -> PointmapNet:
    torch.manual_seed(0)
    made = PointmapNet(TINY)
    for name, p in made.named_parameters():  # so that nothing is hidden behind heads that begin near zero
        if p.ndim > 1 and ("last.2" in name or "pose.2" in name):
            torch.nn.init.normal_(p, std=0.1)
    return made


def perfect(batch: Batch, scale: float = 1.0) -> Prediction:
    z = batch.depth.clamp(min=0.05)
    rays = cameras.rays(batch.K, batch.size)[..., :2]
    return Prediction(
        rays,
        z.log() + torch.tensor(scale).log(),
        torch.zeros_like(z),
        batch.T[..., :3, :3],
        scale * batch.T[..., :3, 3],
        loss.partners(batch)[0].clamp(min=1e-6).log(),
    )


def test_the_order_of_views_is_the_order_of_answers(net: PointmapNet, batch: Batch) -> None:
    order = [2, 0, 1]
    a = net(batch.images, batch.sensor, batch.K)
    b = net(batch.images[:, order], batch.sensor[:, order], batch.K[:, order])
    # Matches of a network that has learnt nothing are chance: rounding tells in what they are adjusted to.
    for name, off in {"rays": 1e-3, "log_z": 1e-3, "log_error": 5e-3, "R": 1e-3, "t": 1e-3}.items():
        torch.testing.assert_close(getattr(b, name), getattr(a, name)[:, order], atol=off, rtol=1e-3)


def test_views_are_not_looked_at_alone(net: PointmapNet, batch: Batch) -> None:
    alone = net(batch.images[:, :1], batch.sensor[:, :1], batch.K[:, :1]).log_z
    together = net(batch.images, batch.sensor, batch.K).log_z[:, :1]
    assert (alone - together).abs().max() > 1e-4


def test_a_larger_sensor_unit_is_a_larger_answer(net: PointmapNet, batch: Batch) -> None:
    """With depth the answer is in its unit, exactly."""
    a = net(batch.images, batch.sensor, batch.K)
    b = net(batch.images, 3 * batch.sensor, batch.K)
    seen = (batch.sensor > 0).flatten(1).any(1)
    assert seen.any()
    torch.testing.assert_close(b.points()[seen], 3 * a.points()[seen], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(b.t[seen], 3 * a.t[seen], atol=1e-3, rtol=1e-3)


def test_inputs_may_be_absent(net: PointmapNet, batch: Batch) -> None:
    out = net(batch.images, torch.zeros_like(batch.sensor), torch.zeros_like(batch.K))
    assert out.points().isfinite().all()
    R = out.R
    torch.testing.assert_close(R @ R.transpose(-1, -2), torch.eye(3).expand_as(R), atol=1e-5, rtol=0)
    assert torch.linalg.det(R).min() > 0.99


def test_the_truth_has_no_loss_in_any_scale_and_any_frame(batch: Batch) -> None:
    right = perfect(batch)
    G = cameras.look_at(torch.tensor([1.0, 2, 3]), torch.tensor([0.0, 0.5, 1]), torch.tensor(0.7))
    moved = G @ batch.T
    shifted = replace(right, R=moved[..., :3, :3], t=moved[..., :3, 3])
    for out in (right, perfect(batch, 0.3), shifted):
        parts = loss.terms(out, batch)
        for name in ("depth", "slope", "rays", "rotation", "translation"):
            assert abs(float(parts[name])) < 2e-3, name


def test_every_error_has_its_term(batch: Batch) -> None:
    right = perfect(batch)
    wrong = {
        "depth": replace(right, log_z=right.log_z + 0.2 * torch.linspace(-1, 1, SIZE[1])),
        "slope": replace(right, log_z=right.log_z + 0.2 * torch.linspace(-1, 1, SIZE[1])),
        "rays": replace(right, rays=right.rays + 0.1),
        "rotation": replace(right, R=right.R[:, [1, 0, 2]]),
        "translation": replace(right, t=2 * right.t),
        "matches": replace(right, matches=right.matches.roll(1, -1)),
    }
    base = loss.terms(right, batch)
    for name, out in wrong.items():
        assert float(loss.terms(out, batch)[name]) > float(base[name]) + 1e-3, name


def test_the_likelihood_is_best_where_the_expected_error_is_the_error(batch: Batch) -> None:
    off = 0.1 * torch.where(torch.arange(SIZE[1]) % 2 == 0, 1.0, -1.0)
    values = []
    for expected in (0.02, 0.1, 0.5):
        out = perfect(batch)
        at = torch.full_like(out.log_z, expected / loss.REFERENCE).log()
        values.append(float(loss.terms(replace(out, log_z=out.log_z + off, log_error=at), batch)["likelihood"]))
    assert values[1] < min(values[0], values[2])


def test_the_network_that_ships_has_the_size_that_was_asked_for() -> None:
    assert 5e6 < count(PointmapNet()) < 20e6
    with pytest.raises(RealsimError, match="shape"):
        Shape(dim=33, heads=2)
