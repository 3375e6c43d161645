"""rsl_rl behind the hook: one update of its PPO is one of ours."""

from dataclasses import replace
from importlib.util import find_spec

import pytest
import torch

from tests.trainer.test_losses import ToyMirror, asymmetry
from tests.trainer.test_ppo import CONFIG, CPU, SMALL
from tests.trainer.toy import LAYOUT, PointMass
from trainer.ppo import gaussian
from trainer.ppo import policy as policies
from trainer.ppo.runner import Runner
from trainer.trainers import find

pytestmark = pytest.mark.skipif(find_spec("rsl_rl") is None, reason="rsl-rl-lib is not installed (extra: rsl-rl)")
ONE = replace(CONFIG, steps=8, epochs=2, minibatches=1, entropy_weight=0.01, critic_rate=None, std_limits=(2.0, 2.0))


class _Blind(PointMass):
    """The toy without its camera and without time-outs (both learners treat terminations alike, time-outs not)."""

    def __init__(self, worlds: int) -> None:
        super().__init__(worlds, max_steps=10**6)
        self.layout = replace(LAYOUT, depth=None, depth_stride=0)

    def step(self, actions):
        step = super().step(actions)
        return replace(step, observation=replace(step.observation, depth=None))

    def reset(self):
        return replace(super().reset(), depth=None)


def theirs(runner: Runner):
    """rsl_rl's own networks with our weights, its storage with our samples."""
    from rsl_rl.algorithms import PPO as RslPPO
    from rsl_rl.models import MLPModel
    from rsl_rl.storage import RolloutStorage
    from tensordict import TensorDict

    env, net = runner.env, SMALL
    groups = {"actor": torch.zeros(env.num_worlds, 2), "critic": torch.zeros(env.num_worlds, 3)}
    obs = TensorDict(groups, batch_size=[env.num_worlds])
    sets = {"actor": ["actor"], "critic": ["critic"]}
    std = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "init_std": 1.0, "std_type": "log"}
    actor = MLPModel(obs, sets, "actor", 2, net.actor, "elu", distribution_cfg=std)
    critic = MLPModel(obs, sets, "critic", 1, net.critic, "elu")
    for model, ours in ((actor, runner.policy.actor), (critic, runner.policy.critic)):
        linears = [m for m in model.mlp if isinstance(m, torch.nn.Linear)]
        for linear, block in zip(linears, ours.trunk, strict=True):
            linear.load_state_dict(block.layer.state_dict())
    storage = RolloutStorage("rl", env.num_worlds, ONE.steps, obs, [2])
    ppo = RslPPO(
        actor, critic, storage, ONE.epochs, ONE.minibatches, ONE.clip, ONE.gamma, ONE.lam, ONE.value_weight,
        ONE.entropy_weight, ONE.first_rate(tuned=False), ONE.max_gradient, desired_kl=ONE.desired_kl,
    )  # fmt: skip
    return ppo


def test_one_update_is_the_same() -> None:
    from tensordict import TensorDict

    env = _Blind(64)
    runner = Runner(env, policies.new(env.layout, SMALL, "toy", 0), ONE, rank=CPU)
    runner.begin()
    other = theirs(runner)
    runner._collect()
    ours, storage = runner.rollout, other.storage
    storage.observations["actor"].copy_(ours.actor)
    storage.observations["critic"].copy_(ours.critic)
    for name, value in (
        ("actions", ours.action),
        ("values", ours.value[..., None]),
        ("actions_log_prob", ours.log_prob[..., None]),
        ("rewards", ours.reward[..., None]),
        ("dones", ours.done[..., None].byte()),
    ):
        getattr(storage, name).copy_(value)
    storage.distribution_params = (ours.mean, ours.log_std.exp().expand_as(ours.mean))
    last = {"actor": runner.observation.actor, "critic": runner.observation.critic}
    other.compute_returns(TensorDict(last, batch_size=[64]))
    assert torch.allclose(storage.returns.squeeze(-1), ours.returns, atol=1e-5)
    assert torch.allclose(storage.advantages.squeeze(-1), ours.advantage, atol=1e-5)
    other.update()
    runner.ppo.update(ours, runner.rng)
    assert other.learning_rate == pytest.approx(runner.ppo.learning_rate.item(), rel=1e-5)
    assert other.learning_rate != ONE.first_rate(tuned=False)
    for model, net in ((other.actor, runner.policy.actor), (other.critic, runner.policy.critic)):
        linears = [m for m in model.mlp if isinstance(m, torch.nn.Linear)]
        for linear, block in zip(linears, net.trunk, strict=True):
            assert torch.allclose(linear.weight, block.layer.weight, atol=1e-5)
            assert torch.allclose(linear.bias, block.layer.bias, atol=1e-5)
    assert torch.allclose(
        other.actor.distribution.log_std_param, gaussian.bounded(runner.policy.actor.log_std, 2.0), atol=1e-5
    )


def test_it_trains_our_networks_with_depth(capsys: pytest.CaptureFixture[str]) -> None:
    from trainer.trainers.rsl_rl import build

    env = PointMass(64)
    policy = policies.new(env.layout, SMALL, "toy", 0)
    before = {k: v.clone() for k, v in policy.actor.state_dict().items()}
    runner = build(env, policy, CONFIG, None)
    policy.actor.log_std.data.fill_(9.0)
    runner.alg.optimizer.step()
    assert torch.allclose(policy.actor.log_std.exp(), torch.tensor(1.0))
    policy.actor.log_std.data.copy_(before["log_std"])
    runner.learn(6)
    changed = {k for k, v in policy.actor.state_dict().items() if not torch.equal(v, before[k])}
    assert {k for k in before if k.startswith(("encoder", "trunk", "log_std"))} <= changed
    assert runner.alg.storage.rewards.mean() > 1.5 * 0.002
    assert find("rsl_rl").__module__ == "trainer.trainers.rsl_rl"


def test_mirror_samples_make_its_policy_more_symmetric() -> None:
    from trainer.trainers.rsl_rl import build

    def learned(kind) -> float:
        env = PointMass(64)
        policy = policies.new(env.layout, SMALL, "toy", 0)
        config = replace(CONFIG, symmetry=kind)
        build(env, policy, config, None, mirror=ToyMirror()).learn(8)
        seen = Runner(PointMass(64), policy, CONFIG, rank=CPU)
        seen.begin()
        seen._collect()
        return asymmetry(policy.actor, seen.rollout.batch(torch.arange(64))).item()

    assert learned("augmentation") < 0.7 * learned("none")
