"""The parkour environment on a double of the engine, for the tests of the task."""

import torch

from tests.trainer.fakes import BoxCaster, FakePhysics, course, quadruped
from trainer.tasks.parkour import ParkourConfig, ParkourEnv
from trainer.tasks.parkour.config import (
    CommandConfig,
    DepthConfig,
    ObservationConfig,
    RandomisationConfig,
    ResetConfig,
)
from trainer.tasks.parkour.terminations import OUTCOMES
from trainer.terrain.edges import feature_edges

QUIET = ParkourConfig(
    command=CommandConfig(speed=(0.8, 0.8)),
    observation=ObservationConfig(noise=False),
    depth=DepthConfig(use=False, noise=0.0, dropout=0.0, latency=(0, 0), mount_position=0.0, mount_rotation=0.0),
    randomisation=RandomisationConfig(use=False),
    reset=ResetConfig(position=0.0, yaw=0.0, joints=0.0, spread_ages=False),
)


def env_of(config=QUIET, worlds=4, motion=None, seed=0, terrain=None, **options):
    terrain = terrain or course()
    terrains = [terrain] * options.pop("copies", 1)
    physics = FakePhysics(quadruped(), terrains, worlds, motion)
    edges = [feature_edges(t) for t in terrains]
    return ParkourEnv(physics, BoxCaster(terrains), edges, config, seed=seed, **options)


def still(env):
    return torch.zeros(env.num_worlds, env.num_actions)


def outcome(env):
    return [OUTCOMES[k] for k in env.ends.outcome.tolist()]


def until_an_end(env, limit=1100):
    for step in range(1, limit):
        result = env.step(still(env))
        if env.ends is not None:
            return step, result
    raise AssertionError("nothing ended")
