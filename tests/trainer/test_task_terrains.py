"""Scaled variants of a course, and settings that are refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from tests.trainer.fakes import BoxCaster, FakePhysics, course, quadruped
from trainer.errors import TrainerError
from trainer.replay import scene_model
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, check
from trainer.tasks.parkour.config import (
    CommandConfig,
    DepthConfig,
    ObservationConfig,
    RandomisationConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.randomise import sizes
from trainer.tasks.parkour.resets import Course
from trainer.terrain.changed import scaled, scaled_spec

# ---------------------------------------------------------------- terrains


def test_variants_are_scaled_courses():
    terrain = course()
    big = scaled(terrain, 1.1)
    assert np.allclose(big.goal.centre, [3.3, 0, 0])
    assert np.allclose(big.boxes[1].T[:3, 3], 1.1 * terrain.boxes[1].T[:3, 3])
    assert np.allclose(big.boxes[1].T[:3, :3], np.eye(3))
    assert big.floor_z == pytest.approx(-0.385)
    assert scaled(terrain, 1.0) is terrain
    assert sizes([terrain], RandomisationConfig()) == pytest.approx([0.95, 0.975, 1.0, 1.025, 1.05])
    assert sizes([terrain] * 200, RandomisationConfig()) == [1.0]
    assert sizes([terrain], RandomisationConfig(use=False)) == [1.0]


def test_the_goal_is_where_its_platform_lies():
    goal = replace(course().goal, size=np.array([2.0, 0.6]), yaw=np.pi / 2)
    terrains = [course(), scaled(replace(course(), goal=goal), 1.1)]
    places = Course.of(terrains, torch.device("cpu"))
    along_y, along_x = torch.tensor([[3.3, 0.9]]), torch.tensor([[4.2, 0.0]])
    turned = torch.tensor([1])
    assert places.on_goal(along_y, along_y[:, None], turned).tolist() == [True]
    assert places.on_goal(along_x, along_x[:, None], turned).tolist() == [False]
    # Without yaw the borders are exactly what they were.
    points = torch.rand(2000, 2, generator=torch.Generator().manual_seed(0)) * 1.2 + torch.tensor([2.4, -0.6])
    straight = ((points - places.goal[0, :2]).abs() <= places.goal_half[0]).all(-1)
    assert torch.equal(places.on_goal(points, points[:, None], torch.zeros(2000, dtype=torch.long)), straight)


def test_a_mark_is_turned_with_its_platform():
    goal = replace(course().goal, yaw=0.5)
    model = scene_model(quadruped(), replace(course(), goal=goal), (64, 64))
    start, end = model.geom_quat[model.geom_bodyid == 0][-2:]
    assert start == pytest.approx([1, 0, 0, 0])
    assert end == pytest.approx([np.cos(0.25), 0, 0, np.sin(0.25)])


def test_a_replay_draws_what_a_scene_collides_with():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.2, 0.3], group=3)
    model = scene_model(quadruped(), replace(course(), contact=spec), (64, 64))
    shown = model.geom_group[model.geom_bodyid == 0]
    assert len(shown) >= 4  # ground, box, two marks
    assert (shown < 3).all()


def test_a_scaled_scene_collides_where_its_mesh_is():
    spec = mujoco.MjSpec()
    corners = np.array([[x, y, z] for x in (0, 0.4) for y in (0, 0.3) for z in (0, 0.2)])
    spec.add_mesh(name="part", uservert=corners.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="part", pos=[1.0, 0, 0])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.2, 0.3], pos=[0, 2.0, 0])
    reach = []
    for contact in (spec, scaled_spec(spec, 1.5)):
        model = contact.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        at = [np.array([3.0, 0.15, 0.1]) * (1 if contact is spec else 1.5), np.array([0, 9.0, 0])]
        to = [np.array([-1.0, 0, 0]), np.array([0, -1.0, 0])]
        geom = np.zeros(1, np.int32)
        hit = [p + d * mujoco.mj_ray(model, data, p, d, None, 1, -1, geom) for p, d in zip(at, to, strict=True)]
        reach.append((hit[0][0], hit[1][1]))
    assert reach[0] == pytest.approx((1.4, 2.2))
    assert reach[1] == pytest.approx((2.1, 3.3))


@pytest.mark.parametrize("ratio", [0.1, 100.0, float("nan")])
def test_a_wrong_scale_is_refused(ratio):
    with pytest.raises(TrainerError):
        check(scaled(course(), ratio))


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (CommandConfig, {"speed": (0.9, 0.5)}),
        (ObservationConfig, {"history": 0}),
        (DepthConfig, {"near": 3.0}),
        (TerminationConfig, {"seconds": 0.0}),
        (RandomisationConfig, {"kp": (0.0, 1.0)}),
    ],
)
def test_senseless_settings_are_refused(kind, values):
    with pytest.raises(TrainerError, match=kind.__name__):
        kind(**values)


def test_a_camera_is_needed_for_depth():
    physics = FakePhysics(replace(quadruped(), camera=None), [course()], 2)
    with pytest.raises(TrainerError, match="no depth camera"):
        ParkourEnv(physics, BoxCaster([course()]), [np.zeros((0, 2, 3))], ParkourConfig())
