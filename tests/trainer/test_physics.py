"""The CPU engine against plain MuJoCo, and what it must notice."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from trainer import terrain as terrains
from trainer.physics import ENGINES, Physics, PhysicsConfig, WorldParams
from trainer.physics.world import world_spec
from trainer.robots import ROBOTS, TrainedRobot
from trainer.tasks.parkour import ParkourConfig, make
from trainer.tasks.parkour.config import DepthConfig


def engine(robot: TrainedRobot, lands, worlds: int, **config) -> Physics:
    return ENGINES["mujoco"](robot, lands, worlds, PhysicsConfig(threads=1, **config))


def place(physics: Physics, height: float = 0.0, land: int = 0, **where) -> None:
    """All worlds in the default pose, `height` above standing."""
    n, robot = physics.num_worlds, physics.robot
    pos = torch.tensor([where.get("x", 0.0), where.get("y", 0.0), robot.standing_height + height]).repeat(n, 1)
    quat = torch.tensor(where.get("quat", [1.0, 0.0, 0.0, 0.0])).repeat(n, 1)
    joints = torch.tensor(robot.default, dtype=torch.float32).repeat(n, 1)
    physics.reset(torch.arange(n), pos, quat, joints, torch.full((n,), land))


def default(physics: Physics) -> torch.Tensor:
    return torch.tensor(physics.robot.default, dtype=torch.float32).repeat(physics.num_worlds, 1)


@pytest.fixture(scope="module")
def quadruped() -> TrainedRobot:
    return ROBOTS["quadruped"]()


@pytest.mark.parametrize("name", list(ROBOTS))
def test_the_state_is_that_of_plain_mujoco(name: str) -> None:
    robot, land = ROBOTS[name](), terrains.generate("stakes", 0.5, 1)
    physics = engine(robot, [land], 2)
    place(physics, 0.02)
    physics.set_velocity(
        torch.arange(2), torch.tensor([[0.3, 0.1, 0.0]]).repeat(2, 1), torch.tensor([[0.1, -0.4, 0.7]]).repeat(2, 1)
    )
    model = world_spec(robot, land, len(land.boxes), physics.config).compile()
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, robot.standing_height + 0.02, 1, 0, 0, 0, *robot.default.astype(np.float32)]
    data.qpos[2] = np.float32(robot.standing_height + 0.02)
    data.qvel[:6] = np.float32([0.3, 0.1, 0, 0.1, -0.4, 0.7])
    rng = np.random.default_rng(0)
    for _ in range(8):
        target = robot.default + 0.2 * robot.action_scale * rng.normal(size=len(robot.joints))
        state = physics.step(torch.tensor(target, dtype=torch.float32).repeat(2, 1))
        data.ctrl[:] = target.astype(np.float32)
        mujoco.mj_step(model, data, nstep=4)
    torque, force = data.actuator_force.copy(), _foot_forces(model, data, robot)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(state.joint_pos[1], data.qpos[7:], atol=2e-5)
    np.testing.assert_allclose(state.base_pos[1], data.qpos[:3], atol=2e-5)
    np.testing.assert_allclose(state.joint_torque[1], torque, atol=2e-2)
    np.testing.assert_allclose(state.foot_force[1], force, atol=1.0)
    for i, foot in enumerate(robot.feet):
        np.testing.assert_allclose(state.foot_pos[1, i], data.body(foot).xpos, atol=2e-5)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, model.body(foot).id, velocity, 0)
        np.testing.assert_allclose(state.foot_ang_vel[1, i], velocity[:3], atol=2e-3)
        np.testing.assert_allclose(state.foot_lin_vel[1, i], velocity[3:], atol=1e-3)
    np.testing.assert_allclose(state.torso_pos[1], data.body(robot.torso).xpos, atol=2e-5)
    assert torch.equal(state.joint_pos[0], state.joint_pos[1])


def _foot_forces(model, data, robot: TrainedRobot) -> np.ndarray:
    total = np.zeros((len(robot.feet), 3))
    bodies = [model.body(f).id for f in robot.feet]
    for i, contact in enumerate(data.contact):
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, force)
        for geom, sign in ((contact.geom1, -1), (contact.geom2, 1)):
            if model.geom_bodyid[geom] in bodies:
                total[bodies.index(model.geom_bodyid[geom])] += sign * contact.frame.reshape(3, 3).T @ force[:3]
    return np.linalg.norm(total, axis=1)


def test_the_quadruped_stands_for_two_seconds(quadruped: TrainedRobot) -> None:
    physics = engine(quadruped, [terrains.flat()], 1)
    place(physics)
    for _ in range(100):
        state = physics.step(default(physics))
    assert state.base_pos[0, 2] > 0.85 * quadruped.standing_height
    assert state.torso_quat[0, 0] > 0.99
    assert float(state.foot_force.sum()) == pytest.approx(13.2 * 9.81, rel=0.05)
    assert float(state.joint_vel.abs().max()) < 0.05
    assert not state.other_contact.any()


def test_ground_and_bodies_that_touch_are_noticed(quadruped: TrainedRobot) -> None:
    land = terrains.generate("boxes", 0.0, 0)
    physics = engine(quadruped, [land], 1)
    place(physics)
    for _ in range(5):
        state = physics.step(default(physics))
    assert not state.ground_contact.any()
    place(physics, height=land.floor_z, y=3.0)
    for _ in range(5):
        state = physics.step(default(physics))
    assert state.ground_contact.all()
    assert not state.other_contact.any(), "feet on the ground are feet"
    place(physics, height=land.floor_z, y=3.0, quat=[0.0, 1.0, 0.0, 0.0])  # on its back
    for _ in range(25):
        state = physics.step(default(physics))
    assert state.other_contact.all()


def test_late_commands_act_later(quadruped: TrainedRobot) -> None:
    physics = engine(quadruped, [terrains.flat()], 3)
    place(physics, 1.0)
    physics.set_params(torch.arange(3), WorldParams(delay_steps=torch.tensor([0, 2, 4])))
    state = physics.step(default(physics) + 0.3)
    moved = (state.joint_pos - default(physics)).mean(dim=1)
    assert moved[0] > 2 * moved[1] > 0.01
    assert abs(float(moved[2])) < 1e-3
    later = physics.step(default(physics) + 0.3)
    assert (later.joint_pos - default(physics)).mean(dim=1)[2] > 0.01


def test_parameters_change_their_own_world_and_can_be_taken_over(quadruped: TrainedRobot) -> None:
    physics = engine(quadruped, [terrains.flat()], 3)
    place(physics)
    j = len(quadruped.joints)
    params = WorldParams(
        friction=torch.tensor([0.8]),
        mass_scale=torch.tensor([1.2]),
        payload=torch.tensor([2.0]),
        com_offset=torch.tensor([[0.02, 0.0, 0.0]]),
        kp_scale=torch.full((1, j), 0.9),
        kd_scale=torch.full((1, j), 1.1),
        armature_scale=torch.full((1, j), 1.3),
        joint_friction=torch.full((1, j), 0.2),
    )
    physics.set_params(torch.tensor([1]), params)
    for _ in range(100):
        state = physics.step(default(physics))
    weights = state.foot_force.sum(dim=1) / 9.81
    assert float(weights[0]) == pytest.approx(13.2, rel=0.05)
    assert float(weights[1]) == pytest.approx(13.2 + 0.2 * 6.2 + 2.0, rel=0.05)
    assert torch.equal(state.joint_pos[0], state.joint_pos[2])
    before = state.joint_pos[1].clone()
    place(physics)
    for _ in range(100):
        state = physics.step(default(physics))
    assert torch.equal(state.joint_pos[1], before), "a reset keeps a world's parameters"


def test_a_world_that_diverges_is_flagged_and_stays_readable(quadruped: TrainedRobot) -> None:
    physics = engine(quadruped, [terrains.flat()], 3)
    place(physics)
    targets = default(physics)
    targets[1, 0] = float("nan")
    physics.set_velocity(torch.tensor([2]), torch.tensor([[0.0, 0.0, 1e8]]), torch.tensor([[1e8, 0.0, 0.0]]))
    state = physics.step(targets)
    assert state.diverged.tolist() == [False, True, True]
    for name, value in vars(state).items():
        assert torch.isfinite(value.float()).all(), name
    physics.reset(
        torch.tensor([1, 2]),
        torch.tensor([[0.0, 0.0, 0.4]]).repeat(2, 1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(2, 1),
        default(physics)[:2],
        torch.tensor([0, 0]),
    )
    assert not physics.step(default(physics)).diverged.any()


def test_worlds_with_terrain_of_different_sizes_share_a_batch(quadruped: TrainedRobot) -> None:
    """A scene that brings its own contact geoms beside generated terrain."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[0, 0, -0.1])
    made = terrains.generate("wedges", 0.2, 0)
    scene = type(made)(**{**vars(made), "boxes": (), "contact": spec})
    physics = engine(quadruped, [made, scene], 4)
    joints = default(physics)
    pos = torch.tensor([0.0, 0.0, quadruped.standing_height]).repeat(4, 1)
    quat = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(4, 1)
    physics.reset(torch.arange(4), pos, quat, joints, torch.tensor([0, 1, 0, 1]))
    for _ in range(10):
        state = physics.step(joints)
    assert (state.foot_force.sum(dim=1) > 50).all()
    assert torch.allclose(state.base_pos[0], state.base_pos[1], atol=1e-3)
    assert torch.equal(state.base_pos[0], state.base_pos[2])


def test_a_robots_own_limbs_collide_when_asked(quadruped: TrainedRobot) -> None:
    """Hips turned inwards beyond their range: the legs cross."""
    touched = {}
    for self_collision in (False, True):
        physics = engine(quadruped, [terrains.flat()], 1, self_collision=self_collision)
        place(physics, 1.0)
        crossed = default(physics)
        crossed[0, [0, 6]], crossed[0, [3, 9]] = -0.8, 0.8
        for _ in range(15):
            state = physics.step(crossed)
        touched[self_collision] = bool(state.other_contact[0]) or float(state.foot_force.sum()) > 0
    assert touched == {False: False, True: True}


@pytest.mark.parametrize("name", list(ROBOTS))
def test_no_robot_touches_itself_in_its_default_pose(name: str) -> None:
    """Otherwise training with self-collision would begin with a penalty that nothing can lower."""
    robot = ROBOTS[name]()
    physics = engine(robot, [terrains.flat()], 1, self_collision=True)
    place(physics, 1.0)
    state = physics.step(default(physics))
    assert not state.other_contact[0]
    assert float(state.foot_force.sum()) == 0.0


@pytest.mark.parametrize("asked", [False, True])
def test_the_task_says_whether_links_collide(asked: bool) -> None:
    for physics in (None, PhysicsConfig(threads=1), PhysicsConfig(threads=1, self_collision=True)):
        task = ParkourConfig(self_collision=asked, depth=DepthConfig(use=False))
        env = make(task, [terrains.flat()], robot="quadruped", worlds=1, physics=physics)
        assert env.physics.config.self_collision == (asked or (physics is not None and physics.self_collision))


def test_ground_that_gives_and_places_that_slip_change_the_model(quadruped: TrainedRobot) -> None:
    """Softer contacts let the robot sink in; a slippery geom of a scene keeps its share of the drawn friction."""
    contact = mujoco.MjSpec()
    for name, x, mu in (("dry", 0.0, 1.0), ("wet", 2.0, 0.3)):
        box = contact.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.9, 0.5, 0.1], pos=[x, 0, -0.1]
        )
        box.friction = [mu, 0.005, 0.0001]
    land = replace(terrains.flat(), contact=contact, floor_z=-0.3)
    physics = engine(quadruped, [land], 3)
    place(physics)
    params = WorldParams(friction=torch.tensor([0.8]), contact_time=torch.tensor([0.1]))
    physics.set_params(torch.tensor([1]), params)
    for _ in range(50):
        state = physics.step(default(physics))
    model = physics._model(1)
    wet, dry = model.geom("scene0/wet").id, model.geom("scene0/dry").id
    assert model.geom_friction[[dry, wet], 0] == pytest.approx([0.8, 0.24])
    assert model.geom_priority[wet] == 1
    assert model.geom_solref[dry, 0] == pytest.approx(0.12)
    sunk = (state.base_pos[0, 2] - state.base_pos[1, 2]).item()
    assert sunk > 0.005
    assert torch.equal(state.base_pos[0], state.base_pos[2])
