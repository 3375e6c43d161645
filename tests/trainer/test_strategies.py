"""Every strategy computes what its base computes at the start, and trains only what is its own."""

import copy
from dataclasses import replace

import pytest
import torch

from realsim.core.errors import RealsimError
from tests.trainer.test_ppo import CONFIG, CPU, SMALL
from tests.trainer.toy import LAYOUT, PointMass
from trainer.ppo import policy as policies
from trainer.ppo.config import StrategyConfig
from trainer.ppo.policy import Policy
from trainer.ppo.runner import Runner
from trainer.ppo.strategies import STRATEGIES

OWN = {
    "full": ("encoder.", "trunk.", "log_std"),
    "last_layer": ("trunk.2.", "log_std"),
    "adapter": ("encoder.", "trunk.", "log_std"),
    "residual": ("correction.", "log_std"),
}


@pytest.fixture(scope="module")
def base() -> Policy:
    """A policy that has learnt a little, so that its normaliser and weights are not trivial."""
    env = PointMass(16)
    runner = Runner(env, policies.new(LAYOUT, SMALL, "toy", 0), CONFIG, rank=CPU)
    for _ in range(3):
        runner.iterate()
    return runner.policy


@pytest.mark.parametrize("name", list(STRATEGIES))
def test_the_same_function_at_the_start(base: Policy, name: str) -> None:
    rng = torch.Generator().manual_seed(1)
    vector, depth = torch.randn(100, 2, generator=rng), torch.rand(100, 3, 6, 8, generator=rng)
    tuned = policies.fine_tune(copy.deepcopy(base), name, StrategyConfig(start_std=None))
    with torch.no_grad():
        assert torch.equal(tuned.actor(vector, depth), base.actor(vector, depth))
    assert torch.equal(tuned.actor.log_std, base.actor.log_std)


@pytest.mark.parametrize("name", list(STRATEGIES))
def test_every_strategy_improves_on_one_terrain_and_changes_only_what_is_its_own(base: Policy, name: str) -> None:
    """The goal is always on the right: each way of fine-tuning must earn more than its base did."""
    tuned = policies.fine_tune(copy.deepcopy(base), name, StrategyConfig())
    before = copy.deepcopy(tuned.actor.state_dict())
    runner = Runner(PointMass(32, goal=1.0), tuned, replace(CONFIG, learning_rate=1e-3), rank=CPU)
    rewards = [runner.iterate()["reward"] for _ in range(10)]
    assert sum(rewards[-3:]) > 1.2 * sum(rewards[:3])
    changed = {key for key, value in tuned.actor.state_dict().items() if not torch.equal(value, before[key])}
    assert changed == {key for key in before if key.startswith(OWN[name])}


def test_exploration_noise_can_start_anew(base: Policy) -> None:
    tuned = policies.fine_tune(copy.deepcopy(base), "adapter", StrategyConfig(start_std=0.25))
    assert torch.allclose(tuned.actor.log_std.exp(), torch.tensor(0.25))


def test_a_residual_goes_on_top_of_a_residual_but_adapters_do_not(base: Policy) -> None:
    once = policies.fine_tune(copy.deepcopy(base), "residual", StrategyConfig())
    twice = policies.fine_tune(once, "residual", StrategyConfig())
    assert [name for name, _ in twice.tuned] == ["residual", "residual"]
    with pytest.raises(RealsimError, match="starts from a plain policy"):
        policies.fine_tune(twice, "adapter", StrategyConfig())
