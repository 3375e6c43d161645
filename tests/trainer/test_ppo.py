"""Laws of the learner: hand-computed returns, exact resume, learning a small task."""

import math
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from tests.trainer.toy import LAYOUT, PointMass
from trainer.ppo import loop
from trainer.ppo import policy as policies
from trainer.ppo.algorithm import PPO, clipped_value_loss, explained_variance, surrogate
from trainer.ppo.config import NetworkConfig, PPOConfig
from trainer.ppo.distributed import Rank
from trainer.ppo.gaussian import SMALLEST
from trainer.ppo.loop import LoopConfig, read_rows, train
from trainer.ppo.normaliser import LARGEST, MEMORY, Normaliser
from trainer.ppo.runner import Runner
from trainer.ppo.storage import Rollout, advantages

BOUNDS = (math.log(SMALLEST), math.log(PPOConfig.std_limits[0]))
CPU = Rank(0, 1, torch.device("cpu"))
SMALL = NetworkConfig(channels=(8,), latent=16, actor=(32, 32), critic=(32, 32))
CONFIG = PPOConfig(steps=16, epochs=4, networks=SMALL)
BRIEF = replace(CONFIG, steps=2, epochs=1)
"""Where it does not matter what is learnt."""


def runner(config: PPOConfig = CONFIG, worlds: int = 16, seed: int = 0, **kwargs) -> Runner:
    env = PointMass(worlds, seed=seed)
    return Runner(env, policies.new(env.layout, config.networks, "toy", seed), config, rank=CPU, seed=seed, **kwargs)


def test_advantages_by_hand() -> None:
    """Two worlds, three steps, gamma 0.5, lambda 0.5; the second world ends after its second step."""
    reward = torch.tensor([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    value = torch.tensor([[4.0, 4.0], [6.0, 6.0], [8.0, 8.0]])
    done = torch.tensor([[False, False], [False, True], [False, False]])
    last = torch.tensor([10.0, 10.0])
    # deltas, first world: 1+3-4=0, 2+4-6=0, 3+5-8=0; second: 0, 2-6=-4, 0
    expected = torch.tensor([[0.0, -1.0], [0.0, -4.0], [0.0, 0.0]])
    assert torch.equal(advantages(reward, value, done, last, 0.5, 0.5), expected)


class _EndsAtOnce(PointMass):
    """Every episode runs out of time after one step, at a state far from where the next one starts."""

    def step(self, actions: torch.Tensor):
        step = super().step(actions)
        far = step.observation.map(lambda x: torch.full_like(x, 0.5))
        return replace(
            step, reward=torch.ones(self.num_worlds), terminated=torch.zeros(self.num_worlds, dtype=torch.bool),
            truncated=torch.ones(self.num_worlds, dtype=torch.bool), final_observation=far,
        )  # fmt: skip


def test_runner_uses_the_true_last_observation() -> None:
    env = _EndsAtOnce(4)
    r = Runner(env, policies.new(LAYOUT, SMALL, "toy", 0), CONFIG, rank=CPU)
    r.begin()
    far = env.step(torch.zeros(4, 2)).final_observation
    with torch.no_grad():
        value = r.policy.critic.of(far)
    r._collect()
    assert torch.allclose(r.rollout.returns, (1 + CONFIG.gamma * value).expand(CONFIG.steps, -1), atol=1e-6)


def test_stacks_gathered_from_single_frames_are_those_that_were_seen() -> None:
    r = runner(worlds=5)
    for _ in range(3):  # frames reach back into the iteration before, over resets too
        if r.observation is None:
            r.begin()
        stacks = []
        see = r.rollout.see

        def record(step, observation, see=see, stacks=stacks):
            stacks.append(observation.depth.clone())
            return see(step, observation)

        r.rollout.see = record
        r._collect()
        r.rollout.see = see
        assert torch.equal(r.rollout.frames.gather(torch.arange(16 * 5)), torch.cat(stacks))
        r.rollout.carry()


def test_unknown_stride_keeps_whole_stacks() -> None:
    rollout = Rollout(2, 3, replace(LAYOUT, depth_stride=0), CPU.device)
    rollout.restart()
    env = PointMass(3)
    seen = [rollout.see(t, env.reset()).depth for t in range(2)]
    assert torch.equal(rollout.frames.gather(torch.arange(6)), torch.cat(seen))


def test_normaliser_matches_the_moments_of_all_data_and_freezes() -> None:
    data = torch.randn(7, 50, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 100.0, 1e-2]) + 40
    normaliser = Normaliser(3)
    for batch in data:
        normaliser.update(batch)
    flat = data.reshape(-1, 3).double()
    assert torch.allclose(normaliser.moments[0], flat.mean(0), rtol=1e-6)
    assert torch.allclose(normaliser.moments[1], flat.var(0, unbiased=False), rtol=1e-4)
    normaliser.frozen = True
    before = normaliser.mean.clone()
    normaliser.update(data[0] + 1000)
    assert torch.equal(normaliser.mean, before)


def test_losses_by_hand() -> None:
    ratio, advantage = torch.tensor([1.5, 1.5, 0.5, 0.5]), torch.tensor([1.0, -1.0, 1.0, -1.0])
    assert surrogate(ratio, advantage, 0.2).item() == pytest.approx((-1.2 + 1.5 - 0.5 + 0.8) / 4)
    value, old, returns = torch.tensor([2.0]), torch.tensor([0.0]), torch.tensor([3.0])
    assert clipped_value_loss(value, old, returns, 0.2).item() == pytest.approx(2.8**2)


def test_learning_rate_stays_in_its_bounds() -> None:
    ppo = runner(worlds=2).ppo
    for kl, bound in ((1.0, 1e-5), (1e-6, 1e-2)):
        for _ in range(30):
            ppo._adapt(torch.tensor(kl))
        assert ppo.learning_rate.item() == pytest.approx(bound)


@pytest.mark.parametrize(("bound", "weight"), [(0, 0.1), (1, -0.1)])
def test_noise_at_its_bound_can_learn_again(bound: int, weight: float) -> None:
    """Far outside at first; an entropy bonus, or malus, then pulls it back in."""
    r = runner(replace(CONFIG, entropy_weight=weight, learning_rate=1e-3, schedule="fixed"), worlds=2)
    log_std = r.policy.actor.log_std
    log_std.data.fill_((-9.0, 9.0)[bound])
    r.ppo = PPO(r.policy.actor, r.policy.critic, r.config)
    assert torch.allclose(log_std, torch.tensor(BOUNDS[bound]))
    r.iterate()
    assert ((log_std > BOUNDS[0]) & (log_std < BOUNDS[1])).all()
    r.ppo.learning_rate.fill_(100.0)
    r.policy.actor.requires_grad_(False)
    log_std.requires_grad_(True)
    r.rollout.advantage.zero_()
    r.ppo.update(r.rollout, r.rng)
    assert (torch.tensor(BOUNDS[0]) <= log_std).all()
    assert (log_std <= torch.tensor(BOUNDS[1])).all()


def test_the_largest_noise_falls_and_a_tuned_policy_has_the_last_from_the_start() -> None:
    config = replace(CONFIG, std_limits=(1.0, 0.5), std_iterations=2)
    assert [config.std_limit(i, tuned=False) for i in (0, 1, 2, 9)] == [1.0, 0.75, 0.5, 0.5]
    assert config.std_limit(0, tuned=True) == 0.5
    r = runner(replace(config, entropy_weight=1.0), groups={"first": (0,), "all": (0, 1)})  # entropy pulls it up
    rows = [r.iterate() for _ in range(3)]
    assert [row["std_limit"] for row in rows] == [1.0, 0.75, 0.5]
    assert rows[2]["std"] == pytest.approx(0.5) == pytest.approx(rows[2]["std/first"])
    assert set(rows[0]) >= {"explained_variance", "clip_fraction", "gradient/policy", "gradient/critic", "std/all"}


def test_the_critic_has_a_rate_of_its_own_that_a_resume_keeps() -> None:
    r = runner(replace(CONFIG, critic_rate=5e-4))
    r.iterate()
    again = runner(replace(CONFIG, critic_rate=2e-4))
    again.ppo.load_state_dict(r.ppo.state_dict())
    policy, critic = again.ppo.optimiser.param_groups
    assert policy["lr"] is again.ppo.learning_rate
    assert critic["lr"] == 2e-4


def test_explained_variance_by_hand() -> None:
    returns = torch.tensor([1.0, 2.0, 3.0])
    assert explained_variance(returns, returns).item() == 1.0
    assert explained_variance(torch.full((3,), 7.0), returns).item() == pytest.approx(0.0)
    assert explained_variance(-returns, returns).item() == pytest.approx(-3.0)


def test_the_normaliser_clips_and_forgets() -> None:
    n = Normaliser(1)
    n.update(torch.zeros(10, 1))
    assert n(torch.tensor([[1e6]])).item() == LARGEST
    n.count.fill_(MEMORY)
    for _ in range(3):
        n.update(torch.ones(10, 1))
    assert n.count.item() == MEMORY
    assert n.mean.item() == pytest.approx(3 * 10 / MEMORY, rel=1e-3)


@pytest.mark.parametrize("restart", [False, True])
def test_worlds_go_on_after_a_checkpoint_unless_asked(tmp_path: Path, restart: bool) -> None:
    r = runner()
    began = []
    begin = r.begin
    r.begin = lambda: (began.append(r.iteration), begin())
    train(r, LoopConfig(iterations=4, checkpoint_every=2, tensorboard=False, restart_at_checkpoint=restart), tmp_path)
    assert began == ([0, 2, 4] if restart else [0])


def test_an_interrupted_run_is_kept_up_to_the_last_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where checkpoints are rare, one is written whenever half a minute has passed."""
    monkeypatch.setattr(loop, "SAVED_S", 0.0)
    r = runner(BRIEF, worlds=4)
    iterate = r.iterate

    def interrupted() -> dict[str, float]:
        if r.iteration == 3:
            raise KeyboardInterrupt
        return iterate()

    monkeypatch.setattr(r, "iterate", interrupted)
    config = LoopConfig(iterations=5, checkpoint_every=100, tensorboard=False)
    with pytest.raises(KeyboardInterrupt, match=r"--resume .*policy\.pt"):
        train(r, config, tmp_path)
    rest = runner(BRIEF, worlds=4)
    train(rest, config, tmp_path, resume=tmp_path / "policy.pt")
    assert [row["iteration"] for row in read_rows(tmp_path)] == [0, 1, 2, 3, 4]


def test_point_mass_is_learnt_from_depth() -> None:
    """Only the image says where the goal is; 2.0 would be a whole episode on it, doing nothing earns 0.0."""
    r = runner(worlds=64)
    rows = [r.iterate() for _ in range(30)]
    assert rows[0]["return"] < 0.3
    assert rows[-1]["return"] > 1.3


def test_resume_is_exact(tmp_path: Path) -> None:
    config = LoopConfig(iterations=4, checkpoint_every=2, tensorboard=False, restart_at_checkpoint=True)
    whole, first, rest = runner(), runner(), runner(seed=5)
    train(whole, config, tmp_path / "whole")
    train(first, replace(config, iterations=2), tmp_path / "parts")
    train(rest, config, tmp_path / "parts", resume=tmp_path / "parts" / "policy.pt")
    rows, again = read_rows(tmp_path / "whole"), read_rows(tmp_path / "parts")
    assert [row["iteration"] for row in again] == [0, 1, 2, 3]
    assert [row["value_loss"] for row in again] == [row["value_loss"] for row in rows]
    for a, b in ((whole.policy.actor, rest.policy.actor), (whole.policy.critic, rest.policy.critic)):
        for (name, x), y in zip(a.state_dict().items(), b.state_dict().values(), strict=True):
            assert torch.equal(x, y), name
    assert torch.equal(whole.env.level, rest.env.level)
    assert whole.ppo.learning_rate == rest.ppo.learning_rate


def test_another_learning_rate_is_begun_with_on_a_resume() -> None:
    """As after a divergence; the same one, or none, leaves what the schedule made of it."""
    old = runner(replace(CONFIG, learning_rate=1e-3), worlds=2)
    old.ppo.learning_rate.fill_(4e-4)
    for asked, expected in ((2e-4, 2e-4), (None, 4e-4), (1e-3, 4e-4)):
        ppo = runner(replace(CONFIG, learning_rate=asked), worlds=2).ppo
        ppo.load_state_dict(old.ppo.state_dict())
        assert ppo.learning_rate.item() == pytest.approx(expected)
        assert ppo.optimiser.param_groups[0]["lr"] is ppo.learning_rate
    before = {name: value for name, value in old.ppo.state_dict().items() if name != "asked_rate"}
    ppo.load_state_dict(before)
    assert ppo.learning_rate.item() == pytest.approx(1e-3)


def test_iterations_to_the_target_and_stop(tmp_path: Path) -> None:
    rates = iter([0.1, 0.5, 0.98, 1.0])
    config = LoopConfig(iterations=9, evaluate_every=1, stop_at_target=True)
    history = train(runner(worlds=4), config, tmp_path, evaluate=lambda policy: next(rates))
    assert history.evaluations == [(0, 0.1), (1, 0.5), (2, 0.98)]
    assert history.to_target(0.97) == 2
    assert (tmp_path / "policy.pt").is_file()
    assert list((tmp_path / "events").iterdir())
    assert [row["success"] for row in read_rows(tmp_path) if "success" in row] == [0.1, 0.5, 0.98]


def test_evaluations_take_no_more_than_their_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(loop, "time", SimpleNamespace(perf_counter=lambda: now[0], monotonic=time.monotonic))
    r = runner(BRIEF, worlds=4)
    iterate = r.iterate

    def second() -> dict[str, float]:
        now[0] += 1
        return iterate()

    def five_seconds(policy: object) -> float:
        now[0] += 5
        return 0.5

    monkeypatch.setattr(r, "iterate", second)
    config = LoopConfig(iterations=40, evaluate_every=2, evaluate_share=0.2, tensorboard=False)
    history = train(r, config, tmp_path, evaluate=five_seconds)
    # The one before the training does not count. 5 s are a fifth of 25 s, of which 20 are training.
    assert [iteration for iteration, _ in history.evaluations] == [0, 2, 20, 40]


def test_a_policy_is_written_where_nothing_is_left_to_train(tmp_path: Path) -> None:
    config = LoopConfig(iterations=1, evaluate_every=1, stop_at_target=True, tensorboard=False)
    at_once = train(runner(worlds=4), config, tmp_path / "at_once", evaluate=lambda policy: 0.99)
    assert at_once.evaluations == [(0, 0.99)]
    assert read_rows(tmp_path / "at_once") == [{"iteration": 0, "success": 0.99}]
    file = tmp_path / "at_once" / "policy.pt"
    train(runner(worlds=4), replace(config, stop_at_target=False), tmp_path / "on", resume=file)
    rows = read_rows(tmp_path / "on")
    assert [row.get("success") for row in rows] == [0.99, None]
    again = runner(worlds=4, seed=1)
    train(again, config, tmp_path / "again", resume=tmp_path / "on" / "policy.pt")
    done, over = (torch.load(tmp_path / name / "policy.pt", weights_only=True) for name in ("on", "again"))
    assert over["training"]["iteration"] == 1
    assert all(torch.equal(value, over["actor"][name]) for name, value in done["actor"].items())
