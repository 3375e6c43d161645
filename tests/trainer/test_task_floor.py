"""Help for a beginner: a floor that is raised at first, and starts along the course. And what is not counted then."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.trainer.task_env import QUIET, env_of, still
from trainer.errors import TrainerError
from trainer.physics import PhysicsConfig
from trainer.physics.mujoco import MujocoPhysics
from trainer.tasks.parkour import make
from trainer.tasks.parkour.config import DepthConfig, FloorConfig, ResetConfig
from trainer.tasks.parkour.floor import RaisedFloor
from trainer.terrain import flat, generate

RAISED = FloorConfig(share=1.0)


def heights(config: FloorConfig, difficulties: list[float], seconds: float = 0.0) -> list[float]:
    terrains = [generate("boxes", d, 0) for d in difficulties]
    floor = RaisedFloor(config, terrains, len(terrains), torch.device("cpu"))
    ids = torch.arange(len(terrains))
    return floor.reset(ids, ids, seconds, torch.Generator().manual_seed(0)).tolist()


def test_the_floor_sinks_with_difficulty_and_with_time():
    assert heights(RAISED, [0.0, 0.5, 1.0]) == pytest.approx([-0.06, -0.205, -0.35])
    assert heights(replace(RAISED, difficulty=0.5), [0.0, 0.5, 1.0]) == pytest.approx([-0.06, -0.35, -0.35])
    timed = replace(RAISED, difficulty=0.0, seconds=10.0)
    assert heights(timed, [1.0], 0.0) == pytest.approx([-0.06])
    assert heights(timed, [1.0], 5.0) == pytest.approx([-0.205])
    assert heights(timed, [1.0], 50.0) == pytest.approx([-0.35])
    assert heights(replace(RAISED, share=0.0), [0.0]) == pytest.approx([-0.35])
    with pytest.raises(TrainerError, match="must sink"):
        FloorConfig(share=0.5, difficulty=0.0)


def test_the_share_of_raised_floors_is_what_was_asked_for_and_flat_ground_has_none():
    terrains = [generate("boxes", 0.2, 0), flat()]
    floor = RaisedFloor(replace(RAISED, share=0.3), terrains, 4000, torch.device("cpu"))
    terrain = (torch.arange(4000) % 2).long()
    floor.reset(torch.arange(4000), terrain, 0.0, torch.Generator().manual_seed(0))
    assert floor.raised[terrain == 0].float().mean().item() == pytest.approx(0.3, abs=0.04)
    assert not floor.raised[terrain == 1].any()


def test_touching_a_raised_floor_costs_ends_nothing_and_is_no_success():
    config = replace(QUIET, floor=RAISED, log_every=5)
    env = env_of(config, worlds=3, copies=6, rows=6, terrain=generate("boxes", 0.2, 1))
    env.reset()
    env.curriculum.row[:] = 2
    env.floor.raised[1] = False  # one world without help
    env.physics.state.ground_contact[:2] = True
    result = env.step(still(env))
    assert result.terminated.tolist() == [False, True, False]
    assert result.reward[0] < result.reward[2] - 0.03
    env.physics.state.ground_contact[:] = False
    env.on_goal[:] = 5.0
    env.course.goal_half[:] = 100.0
    env.step(still(env))
    assert env.curriculum.row[2] == 3
    assert env.curriculum.row[0] < 3  # who touched the floor is not moved up


def test_the_engine_lets_robots_stand_on_the_raised_floor():
    from trainer.robots.quadruped import quadruped

    robot, terrain = quadruped(), generate("stakes", 0.9, 3)
    physics = MujocoPhysics(robot, [terrain], 2, PhysicsConfig(threads=1))
    ids = torch.arange(2)
    base = torch.tensor([[0.0, 3.0, robot.standing_height - 0.04]]).repeat(2, 1)  # beside the course
    upright, joints = torch.tensor([[1.0, 0, 0, 0]] * 2), torch.tensor(robot.default).float().repeat(2, 1)
    physics.reset(ids, base, upright, joints, torch.zeros(2, dtype=torch.long), torch.tensor([-0.06, terrain.floor_z]))
    for _ in range(25):
        state = physics.step(joints)
    assert state.ground_contact.tolist() == [True, True]
    assert state.base_pos[0, 2].item() == pytest.approx(robot.standing_height - 0.06, abs=0.03)
    assert state.base_pos[1, 2].item() == pytest.approx(robot.standing_height + terrain.floor_z, abs=0.05)
    physics.reset(ids, base, upright, joints, torch.zeros(2, dtype=torch.long))
    for _ in range(25):
        state = physics.step(joints)
    assert state.base_pos[0, 2].item() == pytest.approx(robot.standing_height + terrain.floor_z, abs=0.05)


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
    from trainer.tasks.parkour.tally import Tally

    tally = Tally(env.rewards.names, [t.family for t in terrains], 4, torch.device("cpu"))
    ids = torch.tensor([0, 0, 1, 1])
    from trainer.tasks.parkour.terminations import OUTCOMES, SUCCESS

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
