"""What standing still is worth against an attempt that falls half way, by the return of either, on a course of 3 m.

The engine is a double that moves bodies as told: no gait costs anything, so that the balance is that of the task.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.trainer.fakes import course, walk
from tests.trainer.task_env import QUIET, env_of, outcome, still
from trainer.ppo.config import PPOConfig
from trainer.tasks.parkour.config import CommandConfig
from trainer.trainers import Scene
from trainer.trainers.ladder import helped

PAPER = replace(QUIET, command=CommandConfig(speed=(0.6, 0.6)))
HELPED = helped(Scene((course(),)), PAPER)[1]
HELPED = replace(HELPED, reset=PAPER.reset)


def until(seconds: float, then=lambda physics: None):
    """A motion: walk at 0.6 m/s for a time, then do something else."""
    ahead, passed = walk(0.6), [0.0]

    def move(physics) -> None:
        passed[0] += physics.policy_dt
        if passed[0] <= seconds:
            ahead(physics)
        else:
            physics.state.base_lin_vel.zero_()
            then(physics)

    return move


def fall(physics) -> None:
    physics.state.ground_contact.fill_(True)


def returned(config, motion) -> tuple[float, float, str]:
    """(return, the return that PPO maximises, discounted, how it ended) of the first episode."""
    env, total, discounted, weight = env_of(config, worlds=1, motion=motion), 0.0, 0.0, 1.0
    env.reset()
    for _ in range(env.max_steps + 1):
        reward = float(env.step(still(env)).reward[0])
        total, discounted, weight = total + reward, discounted + weight * reward, weight * PPOConfig().gamma
        if env.ends is not None:
            return total, discounted, outcome(env)[0]
    raise AssertionError("the episode did not end")


@pytest.mark.parametrize(("config", "pays"), [(PAPER, False), (HELPED, True)])
def test_with_help_an_attempt_pays_more_than_to_stand_and_without_it_does_not(config, pays: bool) -> None:
    tried = returned(config, until(2.5, fall))
    stood = returned(config, until(0.0))
    stopped = returned(config, until(1.0))  # off the start platform, where nothing ends a wait before the time is over
    assert (tried[2], stood[2], stopped[2]) == ("ground", "stuck", "timeout")
    assert (tried[1] > 1.2 * stopped[1]) is pays
    if pays:
        assert tried[0] > 1.5 * stood[0]
        assert tried[1] > 1.5 * stood[1]
    else:
        assert stopped[0] > 4 * tried[0]
