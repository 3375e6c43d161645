"""The optional parts: style prior and symmetry."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.trainer.test_ppo import runner
from trainer.errors import TrainerError
from trainer.ppo.amp import StylePrior, style_reward
from trainer.ppo.config import AmpConfig
from trainer.ppo.loop import LoopConfig, read_rows, train
from trainer.ppo.storage import Batch
from trainer.ppo.symmetry import MirrorSamples
from trainer.tasks import Observation

AMP = AmpConfig(amp=True, amp_hidden=(16,), amp_learning_rate=3e-3)


def test_style_reward_by_hand() -> None:
    """max[0, 1 - 0.25 (D - 1)^2]: 1 at D = 1, 0 from D = -1 down and from D = 3 up."""
    judgement = torch.tensor([1.0, 0.0, -1.0, -5.0, 3.0, 9.0])
    assert torch.allclose(style_reward(judgement), torch.tensor([1.0, 0.75, 0.0, 0.0, 0.0, 0.0]))


def test_discriminator_tells_motions_apart_and_is_penalised_for_steepness() -> None:
    rng = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    prior = StylePrior(torch.randn(500, 4, generator=rng) + 1, AMP, policy_dt=0.02)
    other = torch.randn(500, 4, generator=rng) - 2
    first = prior.reward(other)
    for _ in range(40):
        prior.seen.append(other)
        losses = prior.update(rng)
    assert losses["amp_real"] > 0.5
    assert losses["amp_policy"] < -0.5
    assert prior.reward(prior.reference).mean() > 3 * prior.reward(other).mean()
    assert float(first.max()) <= AMP.amp_weight * 0.02
    steep = StylePrior(prior.reference, replace(AMP, amp_gradient_penalty=1e4), policy_dt=0.02)
    for _ in range(40):
        steep.seen.append(other)
        held = steep.update(rng)
    assert held["amp_penalty"] < 0.1 * losses["amp_penalty"]


def test_reference_motion_that_is_no_motion_is_refused() -> None:
    with pytest.raises(TrainerError, match="no usable reference motion"):
        StylePrior(torch.full((3, 4), float("nan")), AMP, 0.02)


class _WithFeatures:
    """The toy with transition features: position and velocity."""

    def __init__(self, env) -> None:
        self.env = env

    def __getattr__(self, name: str):
        return getattr(self.env, name)

    def step(self, actions: torch.Tensor):
        return replace(self.env.step(actions), amp=self.env.x.clone())


def test_training_with_a_prior_resumes_exactly(tmp_path: Path) -> None:
    def styled(seed: int = 0):
        torch.manual_seed(seed)
        prior = StylePrior(torch.randn(50, 2, generator=torch.Generator().manual_seed(1)), AMP, 0.1)
        r = runner(seed=seed, prior=prior)
        r.env = _WithFeatures(r.env)
        return r

    loop = LoopConfig(iterations=2, checkpoint_every=1, tensorboard=False, restart_at_checkpoint=True)
    whole, first, rest = styled(), styled(), styled(3)
    train(whole, loop, tmp_path / "whole")
    assert "amp_loss" in read_rows(tmp_path / "whole")[0]
    train(first, replace(loop, iterations=1), tmp_path / "parts")
    train(rest, loop, tmp_path / "parts", resume=tmp_path / "parts" / "policy.pt")
    for a, b in zip(whole.prior.layers.parameters(), rest.prior.layers.parameters(), strict=True):
        assert torch.equal(a, b)
    for a, b in zip(whole.policy.actor.parameters(), rest.policy.actor.parameters(), strict=True):
        assert torch.equal(a, b)


class ToyMirror:
    """The toy seen in a mirror: the line runs the other way."""

    def observation(self, o: Observation) -> Observation:
        return Observation(-o.actor, -o.critic, o.depth.flip(-1))

    def action(self, a: torch.Tensor) -> torch.Tensor:
        return torch.stack([-a[:, 0], a[:, 1]], -1)


def test_mirror_samples_keep_what_was_worth_and_mirror_what_was_seen_and_done() -> None:
    r = runner()
    r.iterate()
    b = r.rollout.batch(torch.arange(6))
    both = MirrorSamples(ToyMirror())(b)
    assert torch.equal(both.action[6:], ToyMirror().action(b.action))
    assert torch.equal(both.mean[:6], b.mean)
    assert torch.equal(both.observation.actor[6:], ToyMirror().observation(b.observation).actor)
    assert torch.equal(both.observation.depth[:6], b.observation.depth)
    for name in ("log_prob", "value", "returns", "advantage"):
        assert torch.equal(getattr(both, name), getattr(b, name).repeat(2))


def asymmetry(policy: torch.nn.Module, batch: Batch) -> torch.Tensor:
    """Mean squared difference between the action in the mirror and the mirrored action (Yu et al. 2018, equation 4)."""
    o, mirror = batch.observation, ToyMirror()
    seen = mirror.observation(o)
    return (policy(seen.actor, seen.depth) - mirror.action(policy(o.actor, o.depth))).square().mean()


def test_learning_from_mirror_samples_makes_a_policy_more_symmetric() -> None:
    plain, mirrored = runner(), runner(augment=MirrorSamples(ToyMirror()))
    for _ in range(8):
        plain.iterate()
        mirrored.iterate()
    batch = plain.rollout.batch(torch.arange(64))
    assert asymmetry(mirrored.policy.actor, batch) < 0.7 * asymmetry(plain.policy.actor, batch)
