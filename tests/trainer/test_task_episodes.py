"""Ends, resets, broken worlds and repeatability of the parkour task."""

from dataclasses import fields, replace

import pytest
import torch

from tests.trainer.fakes import course, walk
from tests.trainer.task_env import QUIET, env_of, outcome, still, until_an_end
from trainer.errors import TrainerError
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import (
    CommandConfig,
    RandomisationConfig,
    ResetConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.terminations import CAUSES, OUTCOMES


def test_standing_at_the_start_ends_after_four_seconds():
    env = env_of(worlds=1)
    env.reset()
    step, result = until_an_end(env)
    assert outcome(env) == ["stuck"]
    assert step * env.policy_dt == pytest.approx(4.0, abs=0.05)
    assert result.terminated.all()
    assert not result.truncated.any()


def test_told_to_stand_nobody_is_stuck_and_time_runs_out():
    config = replace(QUIET, command=CommandConfig(standing=1.0), termination=TerminationConfig(seconds=5.0))
    env = env_of(config, worlds=1)
    env.reset()
    step, result = until_an_end(env)
    assert outcome(env) == ["timeout"]
    assert step == env.max_steps == 250
    assert result.truncated.all()


def test_arriving_and_staying_succeeds():
    def go(physics):
        if physics.state.base_pos[0, 0] < 3.0:
            walk(1.0)(physics)

    env = env_of(worlds=1, motion=go)
    env.reset()
    _, result = until_an_end(env)
    assert outcome(env) == ["success"]
    assert result.truncated.all()
    assert env.ends.covered.item() == pytest.approx(1.0, abs=0.02)
    assert env.ends.position[0, 0].item() == pytest.approx(3.0, abs=0.05)


def test_running_through_is_no_success():
    env = env_of(replace(QUIET, termination=TerminationConfig(seconds=4.0)), worlds=1, motion=walk(1.5))
    env.reset()
    until_an_end(env)
    assert "success" not in outcome(env)


@pytest.mark.parametrize(
    ("field", "row", "expected"),
    [("ground_contact", True, "ground"), ("diverged", True, "diverged"), ("torso_quat", (0.7, 0.714, 0, 0), "tilt")],
)
def test_failures(field, row, expected):
    env = env_of()
    env.reset()
    getattr(env.physics.state, field)[2] = torch.tensor(row)
    result = env.step(still(env))
    assert env.ends.ids.tolist() == [2]
    assert outcome(env) == [expected]
    assert result.terminated.tolist() == [False, False, True, False]
    assert set(CAUSES) < set(OUTCOMES)


def test_ground_may_be_touched_where_the_terrain_allows_but_not_lain_on():
    env = env_of(terrain=course(ground_fails=False))
    env.reset()
    env.physics.state.ground_contact[:] = True
    env.step(still(env))
    assert env.ends is None
    env.physics.state.base_pos[1, 2] = 0.05
    env.step(still(env))
    assert env.ends.ids.tolist() == [1]
    assert outcome(env) == ["collapsed"]


def test_the_final_observation_is_that_of_the_end_and_the_next_that_of_a_new_start():
    def drift(physics):
        physics.state.joint_vel += 1.0

    config = replace(QUIET, command=CommandConfig(standing=1.0), termination=TerminationConfig(seconds=1.0))
    config = replace(config, depth=replace(QUIET.depth, use=True, frames=2, stride=2))
    env = env_of(config, motion=drift)
    fresh = env.reset()
    env.age[:2] = 10  # two worlds end ten steps before the others
    _, result = until_an_end(env)
    assert result.truncated.tolist() == [True, True, False, False]
    last = result.final_observation
    # 40 steps in, joint speeds have been counted up to 40; a fresh start is at rest.
    velocity = slice(3 + 3 + 3 + 12, 3 + 3 + 3 + 24)
    assert (last.critic[:2, velocity] == 40).all()
    assert (result.observation.critic[:2, velocity] == 0).all()
    assert torch.equal(result.observation.actor[:2], fresh.actor[:2])
    assert torch.equal(result.observation.depth[:2], fresh.depth[:2])
    assert (result.observation.critic[2:, velocity] == 40).all()
    assert env.age.tolist() == [0, 0, 40, 40]


def test_first_ages_are_spread():
    env = env_of(replace(QUIET, reset=ResetConfig(spread_ages=True)), worlds=64)
    env.reset()
    assert env.age.float().std() > 100
    assert torch.equal(env.shortened, env.age > 0)


def test_a_first_episode_that_was_cut_short_is_no_failure():
    """At a random age at first, it runs out of time sooner; what it reached by then counts, and so do whole ones."""
    config = replace(QUIET, reset=ResetConfig(position=0.0, yaw=0.0, joints=0.0), log_every=5)
    config = replace(config, termination=TerminationConfig(seconds=1.0), command=CommandConfig(standing=1.0))
    env = env_of(config, worlds=4, copies=6, rows=6)
    env.reset()
    env.curriculum.row[:] = 3
    env.age[:] = torch.tensor([48, 46, 0, 10])
    env.shortened = env.age > 0
    env.on_goal[1] = 5.0  # on the goal since long ago, and still there
    env.course.goal_half[:] = 100.0
    env.on_goal[[0, 2, 3]] = -100.0
    log = [env.step(still(env)).log for _ in range(5)][-1]
    assert env.curriculum.row.tolist() == [3, 4, 3, 3]
    assert (log["success"], log["end/timeout"]) == (1.0, 0.0)
    assert env.shortened.tolist() == [False, False, False, True]
    env.on_goal[:] = -100.0
    log = [env.step(still(env)).log for _ in range(45)][-1]
    assert env.curriculum.row.tolist() == [3, 4, 2, 3]  # the whole one moves down
    assert log["end/timeout"] == 1.0


# ---------------------------------------------------------------- broken worlds


def test_a_broken_world_is_reset_and_counted_and_poisons_nothing():
    env = env_of(replace(QUIET, log_every=10, divergence_limit=0.5))
    env.reset()
    for name in ("base_pos", "joint_pos", "joint_vel", "foot_pos", "foot_lin_vel"):
        getattr(env.physics.state, name)[1] = float("nan")
    env.physics.state.diverged[1] = True
    result = env.step(still(env))
    for o in (result.observation, result.final_observation):
        assert o.actor.isfinite().all()
        assert o.critic.isfinite().all()
    assert result.reward.isfinite().all()
    env.physics.overflowed = 7
    logs = [env.step(still(env)).log for _ in range(9)]
    assert not any(logs[:-1])  # figures are fetched once an interval
    assert logs[-1]["physics/diverged"] == 1
    assert logs[-1]["physics/overflowed"] == 7
    assert [text.split()[0] for text in env.warnings] == ["7", "1"]


def test_a_log_has_the_same_names_whether_an_episode_ended_or_not():
    env = env_of(replace(QUIET, log_every=5))
    env.reset()
    quiet = [env.step(still(env)).log for _ in range(5)][-1]
    env.physics.state.ground_contact[1] = True
    ended = [env.step(still(env)).log for _ in range(5)][-1]
    assert set(quiet) == set(ended)
    assert quiet["success"] != quiet["success"]  # not a number: nothing to count
    assert (ended["success"], ended["end/ground"]) == (0.0, 1.0)


def test_too_many_broken_worlds_stop_the_training():
    def break_all(physics):
        physics.state.diverged[:] = True

    env = env_of(replace(QUIET, log_every=5), motion=break_all)
    env.reset()
    with pytest.raises(TrainerError, match="diverges too often"):
        for _ in range(5):
            env.step(still(env))


# ---------------------------------------------------------------- randomness


def test_the_same_seed_gives_the_same_run_and_another_another():
    def run(seed):
        env = env_of(ParkourConfig(), motion=walk(0.5), seed=seed)
        env.reset()
        return [env.step(torch.full((4, 12), 0.1)) for _ in range(20)]

    a, b, c = run(1), run(1), run(2)
    for x, y in zip(a, b, strict=True):
        assert torch.equal(x.observation.actor, y.observation.actor)
        assert torch.equal(x.observation.depth, y.observation.depth)
        assert torch.equal(x.reward, y.reward)
    assert not torch.equal(a[0].observation.actor, c[0].observation.actor)


def test_a_saved_state_continues_exactly():
    env = env_of(ParkourConfig(), copies=6, rows=3)
    env.reset()
    env.step(still(env))
    saved = env.state_dict()
    first = env.reset()
    other = env_of(ParkourConfig(), copies=6, rows=3, seed=99)
    other.load_state_dict(saved)
    second = other.reset()
    assert torch.equal(first.actor, second.actor)
    assert torch.equal(first.depth, second.depth)
    assert torch.equal(env.terrain_ids, other.terrain_ids)
    other.load_state_dict(saved, seed=5)
    assert not torch.equal(first.actor, other.reset().actor)


def test_randomised_parameters_lie_in_their_ranges():
    env = env_of(replace(ParkourConfig(), depth=QUIET.depth), worlds=200)
    env.reset()
    _, params = env.physics.params[-1]
    c = env.config.randomisation
    for name, (low, high) in {"friction": c.friction, "mass_scale": c.mass, "kp_scale": c.kp, "kd_scale": c.kd}.items():
        drawn = getattr(params, name)
        assert drawn.min() >= low
        assert drawn.max() <= high
        assert drawn.std() > 0
    assert set(params.delay_steps.tolist()) == {0, 1, 2, 3, 4}
    # Softer ground is an option: nobody requested it.
    assert [f.name for f in fields(params) if getattr(params, f.name) is None] == ["contact_time"]


def test_every_world_is_pushed_once_in_a_period():
    config = replace(QUIET, randomisation=RandomisationConfig(push_seconds=0.2))
    env = env_of(config, worlds=23)
    env.reset()
    for _ in range(10):
        env.step(still(env))
    pushed = torch.cat([ids for ids, _ in env.physics.pushed])
    assert sorted(pushed.tolist()) == list(range(23))
    assert max(v[:, :2].abs().max() for _, v in env.physics.pushed) <= 0.5


def test_style_transitions_do_not_span_a_reset():
    def count(physics):
        physics.state.joint_vel += 1.0

    env = env_of(replace(QUIET, amp=True), motion=count)
    env.reset()
    first = env.step(still(env)).amp
    width = env.step(still(env)).amp.shape[1] // 2
    env.age[0] = env.max_steps - 1
    result = env.step(still(env))
    speed = slice(9 + 12, 9 + 24)
    assert (first[:, :width][:, speed] == 0).all()
    assert (first[:, width:][:, speed] == 1).all()
    assert (result.amp[:, :width][:, speed] == 2).all()
    assert (result.amp[:, width:][:, speed] == 3).all()
    after = env.step(still(env)).amp
    assert after[0, :width][speed].tolist() == [0.0] * 12  # the start of the new episode
    assert after[1, :width][speed].tolist() == [3.0] * 12
