"""What standing still is worth against an attempt that falls half way, by the return of either, on a course of 3 m.

The engine is a double that moves bodies as told: no gait costs anything, so that the balance is that of the task.
"""

from dataclasses import replace

import pytest
import torch

from tests.trainer.fakes import course
from tests.trainer.task_env import QUIET, env_of, outcome, still
from trainer.ppo.config import PPOConfig
from trainer.tasks.parkour.config import CommandConfig, TerminationConfig
from trainer.trainers import Scene
from trainer.trainers.ladder import helped

PAPER = replace(QUIET, command=CommandConfig(speed=(0.6, 0.6)))
HELPED = helped(Scene((course(),)), PAPER)[1]
# What comes after ten seconds weighs nothing, discounted.
HELPED = replace(HELPED, reset=PAPER.reset, termination=TerminationConfig(seconds=10.0))


def three_ways(physics) -> None:
    """At 0.6 m/s: the first falls after 2.5 s; the second stays where it is; the third stops off the start platform
    after 1 s, where nothing ends a wait before the time is over."""
    s, now = physics.state, float(physics.clock)
    physics.clock += physics.policy_dt
    speed = torch.tensor([0.6 * (now < 2.5), 0.0, 0.6 * (now < 1.0)])
    for name in ("base_pos", "torso_pos", "camera_pos"):
        getattr(s, name)[:, 0] += speed * physics.policy_dt
    s.foot_pos[..., 0] += speed[:, None] * physics.policy_dt
    s.base_lin_vel[:, 0] = speed
    s.ground_contact[0] = 2.5 <= now < 2.5 + physics.policy_dt


def first_episodes(config) -> list[tuple[float, float, str]]:
    """World -> (return, the return that PPO maximises, discounted, how it ended)."""
    env = env_of(config, worlds=3, motion=three_ways)
    env.physics.clock = 0.0
    env.reset()
    ended: dict[int, tuple[float, float, str]] = {}
    total = discounted = torch.zeros(3)
    for step in range(env.max_steps + 1):
        reward = env.step(still(env)).reward
        total, discounted = total + reward, discounted + PPOConfig().gamma ** step * reward
        for world, how in [] if env.ends is None else zip(env.ends.ids.tolist(), outcome(env), strict=True):
            ended.setdefault(world, (float(total[world]), float(discounted[world]), how))
        if len(ended) == 3:
            return [ended[k] for k in range(3)]
    raise AssertionError("the episode did not end")


@pytest.mark.parametrize(("config", "pays"), [(PAPER, False), (HELPED, True)])
def test_with_help_an_attempt_pays_more_than_to_stand_and_without_it_does_not(config, pays: bool) -> None:
    tried, stood, stopped = first_episodes(config)
    assert (tried[2], stood[2], stopped[2]) == ("ground", "stuck", "timeout")
    assert (tried[1] > 1.2 * stopped[1]) is pays
    if pays:
        assert tried[0] > 1.5 * stood[0]
        assert tried[1] > 1.5 * stood[1]
    else:
        assert stopped[0] > 4 * tried[0]
