"""Starts along the course, and what is not counted then."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.trainer.task_env import QUIET, env_of, still
from trainer.physics import PhysicsConfig
from trainer.tasks.parkour import make
from trainer.tasks.parkour.config import DepthConfig, ResetConfig
from trainer.tasks.parkour.tally import Tally
from trainer.tasks.parkour.terminations import OUTCOMES, SUCCESS
from trainer.terrain import generate


def test_starts_along_the_course_stand_on_footholds_and_count_for_nothing():
    config = replace(QUIET, reset=replace(ResetConfig(), along=1.0), depth=DepthConfig(use=False), log_every=1)
    terrains = [generate("boxes", 0.3, 1), generate("stakes", 0.0, 2)]
    env = make(config, terrains, robot="g1", worlds=6, physics=PhysicsConfig(threads=1), rows=2, seed=1)
    env.reset()
    assert env.elsewhere.all()
    assert (env.stances.count > 0).all()
    x = env.physics.state.base_pos[:, 0]
    assert ((x > 0.4) & (x < 3.5)).all()
    for _ in range(5):
        env.step(still(env))
    assert env.physics.state.base_pos[:, 2].min() > 0.5  # they stand
    before = env.curriculum.row.clone()
    env.physics.state.ground_contact[:] = True
    terrain = env.terrain_ids.clone()
    step = env.physics.step
    env.physics.step = lambda targets: (step(targets), env.physics.state.ground_contact.fill_(True))[0]
    result = env.step(still(env))
    assert result.terminated.all()
    assert torch.equal(env.curriculum.row, before)
    assert np.isnan(result.log["success"])
    assert len(terrain) == 6


def test_stances_have_all_of_both_soles_on_one_level():
    terrain = generate("stakes", 0.0, 2)
    config = replace(QUIET, reset=replace(ResetConfig(), along=0.5))
    env = make(config, [terrain], robot="g1", worlds=2, physics=PhysicsConfig(threads=1))
    valid = env.stances.pose[0, : env.stances.count[0]]
    tops = np.array([[*b.T[:2, 3], *b.size[:2], b.T[2, 3] + b.size[2] / 2] for b in terrain.boxes])
    assert len(valid) > 3
    for x, y, z, _yaw in valid.tolist():
        near = tops[np.hypot(tops[:, 0] - x, tops[:, 1] - y) < 0.6]
        assert np.abs(near[:, 4] - z).min() < 0.01


def test_figures_of_each_family_are_logged_by_themselves():
    terrains = [replace(generate(f, 0.2, 1), name=f) for f in ("boxes", "wedges")]
    env = env_of(replace(QUIET, log_every=1), worlds=4, terrain=terrains[0])

    tally = Tally(env.rewards.names, [t.family for t in terrains], 4, torch.device("cpu"))
    ids = torch.tensor([0, 0, 1, 1])
    outcome = torch.tensor([SUCCESS, OUTCOMES.index("ground"), 0, OUTCOMES.index("tilt")])
    covered = torch.tensor([1.0, 0.5, 0.9, 0.1])
    waiting = torch.tensor([True, False, False, False])
    tally.add(torch.zeros(len(tally.terms)), outcome, covered, torch.tensor([10.0, 4.0, 1.0, 2.0]), ids, waiting)
    log = tally.report(torch.tensor([3, 5, 1, 1]), ids, {"physics/overflowed": 0.0}, 1.0)
    assert log["family/boxes/success"] == 0.5
    assert log["family/boxes/end/ground"] == 0.5
    assert log["family/wedges/end/tilt"] == 1.0
    assert (log["family/boxes/row"], log["family/wedges/row"]) == (4.0, 1.0)
    assert (log["family/boxes/episodes"], log["family/wedges/episodes"]) == (2.0, 1.0)
    assert log["family/boxes/covered"] == pytest.approx(0.75)
    assert log["success"] == pytest.approx(1 / 3)
    assert log["episode/covered"] == pytest.approx(1.6 / 3)
    assert log["episode/seconds"] == pytest.approx(16 / 3)
    assert log["episode/waiting"] == pytest.approx(0.25)
