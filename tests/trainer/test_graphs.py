"""The task around the physics as CUDA graphs: what a CPU can prove about it."""

from dataclasses import fields, is_dataclass, replace

import pytest
import torch

from tests.trainer.fakes import FakePhysics, course, quadruped
from tests.trainer.replays import replayed, with_replays
from tests.trainer.task_env import env_of, still
from trainer.ppo import policy as policies
from trainer.ppo.config import NetworkConfig, PPOConfig
from trainer.ppo.distributed import Rank
from trainer.ppo.runner import Runner
from trainer.tasks.parkour import ParkourConfig, ParkourEnv
from trainer.tasks.parkour.config import (
    CommandConfig,
    DepthConfig,
    ObservationConfig,
    RandomisationConfig,
    ResetConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.randomise import Known
from trainer.terrain import generate
from trainer.terrain.edges import feature_edges

EVERYTHING = ParkourConfig(
    observation=ObservationConfig(history=3, steered=True),
    command=CommandConfig(standing=0.2),
    depth=DepthConfig(frames=2, stride=2),
    termination=TerminationConfig(seconds=0.3),
    reset=ResetConfig(along=0.5),
    randomisation=RandomisationConfig(delay=(0.0, 0.1), push_seconds=0.08),
    amp=True,
    log_every=7,
)
KNOWN = Known(encoder={1: (0.0, 0.1)}, servo=frozenset({1}))
WORLDS = 11


def wander(physics):
    """Commands move the robots; some fall."""
    s = physics.state
    s.joint_vel += 0.1 * (physics.targets - s.joint_pos)
    s.joint_pos += 0.02 * s.joint_vel
    s.base_pos[:, 0] += 0.1 * s.joint_vel[:, 0].abs()
    s.foot_force.copy_(20 * (s.joint_vel[:, :4] > 0))
    s.ground_contact.copy_(s.joint_vel[:, 2] > 0.06)


@pytest.fixture(autouse=True)
def _small_sizes(monkeypatch):
    monkeypatch.setattr("trainer.graphs._SIZES", (2, 5))


def everything():
    return env_of(EVERYTHING, WORLDS, wander, terrain=course(), copies=4, rows=2, known=KNOWN, seed=3)


def on_gpu(graphs):
    from trainer.rays.warp import Caster

    lands = [generate(family, d, 0) for d in (0.2, 0.6) for family in ("stakes", "wedges")]
    physics = FakePhysics(quadruped(), lands, WORLDS, wander, "cuda")
    edges = list(map(feature_edges, lands))
    return ParkourEnv(physics, Caster(lands), edges, EVERYTHING, rows=2, known=KNOWN, seed=3, graphs=graphs)


def actions(steps):
    generator = torch.Generator().manual_seed(5)
    return [torch.randn(WORLDS, 12, generator=generator) for _ in range(steps)]


def state_of(thing, name="env", seen=None):
    """(path, tensor) of all tensors that an object of ours reaches."""
    seen = set() if seen is None else seen
    if id(thing) in seen or name.endswith((".ends", ".physics.targets", ".params", ".pushed")):
        return
    seen.add(id(thing))
    if isinstance(thing, torch.Tensor):
        yield name, thing
    elif isinstance(thing, dict):
        for key, value in thing.items():
            yield from state_of(value, f"{name}.{key}", seen)
    elif isinstance(thing, list | tuple):
        for i, value in enumerate(thing):
            yield from state_of(value, f"{name}.{i}", seen)
    elif is_dataclass(thing):
        for f in fields(thing):
            yield from state_of(getattr(thing, f.name), f"{name}.{f.name}", seen)
    elif type(thing).__module__.startswith(("trainer.", "tests.")):
        yield from state_of(vars(thing), name, seen)


def learner(env):
    config = PPOConfig(steps=6, epochs=1, minibatches=1)
    small = NetworkConfig(channels=(2,), latent=4, actor=(8,), critic=(8,))
    return Runner(env, policies.new(env.layout, small, "toy", 0), config, rank=Rank(0, 1, torch.device("cpu")))


def test_what_lives_from_step_to_step_stays_where_it_is():
    env = everything()
    runner = learner(env)
    runner.begin()
    before = {name: x.data_ptr() for name, x in state_of(vars(runner), "runner") if ".observation." not in name}
    for _ in range(3):
        runner.iterate()
    runner.begin()
    runner.iterate()
    after = {name: x.data_ptr() for name, x in state_of(vars(runner), "runner")}
    assert len(before) > 150
    assert {name for name, at in before.items() if after[name] != at} == set()


def test_replayed_steps_are_those_that_were_run():
    """Nothing waits, no shape depends on data, no number of the host is frozen: replays give the same bits."""
    one, other = everything(), everything()
    other.padded = True
    with_replays(other)
    same(one, other)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_captured_steps_are_those_that_were_run():
    same(on_gpu(graphs=False), on_gpu(graphs=True))


def same(one, other):
    """Steps of an environment, and of another one with graphs."""
    one.padded = True
    a, b = one.reset(), other.reset()
    ended, logs = 0, 0
    for action in actions(60):
        action = action.to(one.device)
        for x, y in zip(a.tensors(), b.tensors(), strict=True):
            assert torch.equal(x, y)
        left, right = one.step(action), other.step(action)
        a, b = left.observation, right.observation
        for name in ("reward", "terminated", "truncated", "amp"):
            assert torch.equal(getattr(left, name), getattr(right, name)), name
        assert str(left.log) == str(right.log)
        if one.ends is not None:
            for f in fields(one.ends):
                assert torch.equal(getattr(one.ends, f.name), getattr(other.ends, f.name)), f.name
            final = left.final_observation, right.final_observation
            assert all(torch.equal(x, y) for x, y in zip(*(o.tensors() for o in final), strict=True))
        ended, logs = ended + left.ended, logs + bool(left.log)
    assert other._looking._captured
    assert set(other._restarting._captured) >= {(2,), (5,)}
    assert ended > 20
    assert logs == 8
    mine, others = dict(state_of(one)), dict(state_of(other))
    assert [n for n, x in mine.items() if "_captured" not in n and not torch.equal(x, others[n])] == []


def test_a_replayed_learner_learns_the_same():
    def train(replays):
        env = everything()
        runner = learner(env)
        env.padded = runner.padded = True
        if replays:
            with_replays(env)
            replayed(runner._acting), replayed(runner._keeping)
        rows = []
        for i in range(5):
            rows.append({k: v for k, v in runner.iterate().items() if not k.endswith("_s")})
            if i == 2:
                runner.begin()
        assert bool(runner._acting._captured) == bool(runner._keeping._captured) == replays
        return rows, [p.clone() for p in runner.policy.actor.parameters()]

    (rows, parameters), (again, others) = train(False), train(True)
    assert str(rows) == str(again)
    assert all(map(torch.equal, parameters, others))


def test_a_padded_restart_touches_the_worlds_that_ended_only():
    env = everything()
    env.padded = True
    env.reset()
    for action in actions(4):
        env.step(action)
    env.age[[2, 7]] = env.max_steps - 1
    env._actions.zero_()
    env.physics.step(env._before(pushes=0))
    now = env._after()
    ended = (now.outcome > 0).nonzero().squeeze(-1).tolist()
    assert {2, 7} <= set(ended) < set(range(WORLDS))
    before = {name: x.clone() for name, x in state_of(env)}
    seen = now.observation.map(torch.clone)
    env._again(now, rows=WORLDS)
    others = [i for i in range(WORLDS) if i not in ended]
    touched = set()
    for name, x in [*state_of(env), *zip("abc", now.observation.tensors(), strict=True)]:
        old = before.get(name)
        old = seen.tensors()["abc".index(name)] if old is None else old
        for dim in [d for d, n in enumerate(x.shape) if n == WORLDS]:
            keep = torch.tensor(others)
            assert torch.equal(x.index_select(dim, keep), old.index_select(dim, keep)), name
            touched |= {name} if not torch.equal(x, old) else set()
    assert {"env.age", "env.origin", "env.images.ring", "env.physics.state.base_pos", "a", "b", "c"} <= touched
    assert env.age[ended].tolist() == [0] * len(ended)
    # Rows of padding are the last world's once more, with the same draws.
    ids, params = env.physics.params[-1]
    assert ids.tolist() == ended + ended[-1:] * (WORLDS - len(ended))
    padding = params.kp_scale[len(ended) - 1 :]
    assert torch.equal(padding, padding[:1].expand_as(padding))


def test_the_stepping_of_the_padded_pushes_reaches_every_world_once_a_period():
    env = env_of(replace(EVERYTHING, randomisation=RandomisationConfig(push_seconds=0.08, push=0.5)), worlds=WORLDS)
    env.padded = True
    env.reset()
    rest = torch.zeros(WORLDS)
    for _ in range(4):
        env.physics.pushed.clear()
        env.step(still(env))
        ((ids, velocity),) = env.physics.pushed
        assert len(set(ids.tolist())) == 3
        rest[ids] += (velocity[:, 0] != 0).float()
    assert rest.tolist() == [1.0] * WORLDS
