"""What standing still is worth against an attempt that falls half way, by the return of either, on a course of 3 m.

The engine is a double that moves bodies as told: no gait costs anything, so that the balance is that of the task.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from tests.trainer.fakes import course, walk
from tests.trainer.task_env import QUIET, env_of, outcome, still
from trainer.ppo.config import PPOConfig
from trainer.tasks.parkour.config import CommandConfig
from trainer.trainers import Scene
from trainer.trainers.ladder import helped

PAPER = replace(QUIET, command=CommandConfig(speed=(0.6, 0.6)))
HELPED = helped(Scene((course(),)), PAPER)[1]
HELPED = replace(HELPED, reset=PAPER.reset)


SECONDS = torch.tensor([2.5, 0.0, 1.0])
"""How long each of three robots walks: half way and falls, not at all, off the start platform, where nothing ends a
wait before the time is over."""


def attempts():
    """A motion of the three."""
    passed = [0.0]

    def move(physics) -> None:
        passed[0] += physics.policy_dt
        on = passed[0] <= SECONDS
        walk(0.6 * on)(physics)
        physics.state.ground_contact[0] |= not on[0]

    return move


def returned(config) -> list[tuple[float, float, str]]:
    """(return, the return that PPO maximises, discounted, how it ended) of the first episode of each."""
    env = env_of(config, worlds=len(SECONDS), motion=attempts())
    total, discounted, weight, ended = torch.zeros(3), torch.zeros(3), 1.0, [""] * 3
    env.reset()
    for _ in range(env.max_steps + 1):
        first = torch.tensor([not end for end in ended])
        reward = env.step(still(env)).reward * first
        total, discounted, weight = total + reward, discounted + weight * reward, weight * PPOConfig().gamma
        if env.ends is not None:
            for world, end in zip(env.ends.ids.tolist(), outcome(env), strict=True):
                ended[world] = ended[world] or end
        if all(ended):
            return list(zip(total.tolist(), discounted.tolist(), ended, strict=True))
    raise AssertionError("the episodes did not end")


@pytest.mark.parametrize(("config", "pays"), [(PAPER, False), (HELPED, True)])
def test_with_help_an_attempt_pays_more_than_to_stand_and_without_it_does_not(config, pays: bool) -> None:
    tried, stood, stopped = returned(config)
    assert (tried[2], stood[2], stopped[2]) == ("ground", "stuck", "timeout")
    assert (tried[1] > 1.2 * stopped[1]) is pays
    if pays:
        assert tried[0] > 1.5 * stood[0]
        assert tried[1] > 1.5 * stood[1]
    else:
        assert stopped[0] > 4 * tried[0]
