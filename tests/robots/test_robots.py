"""Robots are what their tables say, once compiled."""

import re
import sys

import mujoco
import numpy as np
import pytest
import trimesh

from realsim.core.errors import ExportError, MissingExtraError, UnknownNameError
from realsim.robots import ROBOTS, load
from realsim.robots.g1 import action_scale, g1, pd_gains, table
from realsim.robots.menagerie import from_mjcf


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return g1().spec.compile()


def on_plane(name: str) -> mujoco.MjModel:
    spec = load(name).spec
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    return spec.compile()


@pytest.mark.parametrize("name", list(ROBOTS))
def test_feet_touch_the_ground_and_it_stands_for_a_second(name: str) -> None:
    model, robot = on_plane(name), load(name)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert -0.002 < min(c.dist for c in data.contact) <= 0
    before = data.body(robot.root).xpos.copy()
    mujoco.mj_step(model, data, nstep=round(1 / model.opt.timestep))
    np.testing.assert_allclose(data.body(robot.root).xpos, before, atol=0.03)


@pytest.mark.parametrize("name", list(ROBOTS))
def test_home_has_no_contact_with_itself(name: str) -> None:
    model = load(name).spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_placing_moves_body_and_key_frame() -> None:
    robot = g1()
    moved = robot.placed(np.array([1.0, -2.0, 0.5])).spec.compile()
    np.testing.assert_allclose(moved.key_qpos[0][:3], [1, -2, 0.5 + robot.base_height])
    np.testing.assert_allclose(moved.body("pelvis").pos, moved.key_qpos[0][:3])
    np.testing.assert_allclose(robot.spec.compile().key_qpos[0][:2], 0)


def test_g1_masses_and_joints(model: mujoco.MjModel) -> None:
    figures = table()
    assert model.nu == 29
    assert model.nq == 36
    assert model.body_mass.sum() == pytest.approx(33.341142, abs=1e-6)
    for row in figures["bodies"]:
        assert model.body(row["name"]).mass[0] == pytest.approx(row["mass"])
        np.testing.assert_allclose(model.body(row["name"]).inertia, row["inertia_diag"], rtol=1e-6)
    for row in figures["joints"]:
        np.testing.assert_allclose(model.joint(row["name"]).range, row["range"])


def test_g1_servos_follow_the_rule(model: mujoco.MjModel) -> None:
    """The gains printed in the table are the rule's, and the compiled actuators have them."""
    for group in table()["actuator_groups"]:
        kp, kd = pd_gains(group["armature_kgm2"])
        assert kp == pytest.approx(group["stiffness_Nm_per_rad"])
        assert kd == pytest.approx(group["damping_Nms_per_rad"])
        names = [model.actuator(i).name for i in range(model.nu)]
        for name in (n for n in names if any(re.fullmatch(p, n) for p in group["joints"])):
            actuator = model.actuator(name)
            assert actuator.gainprm[0] == pytest.approx(kp)
            np.testing.assert_allclose(actuator.biasprm[:3], [0, -kp, -kd])
            np.testing.assert_allclose(actuator.forcerange, [-group["effort_limit_Nm"], group["effort_limit_Nm"]])
            assert model.joint(name).armature[0] == pytest.approx(group["armature_kgm2"])
    assert action_scale(0.01017752, 88) == pytest.approx(0.5475, abs=1e-3)


def test_g1_camera_looks_ahead_and_down(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    forward = -data.cam("d435i").xmat.reshape(3, 3)[:, 2]
    pitch = table()["camera"]["pitch_rad"]
    np.testing.assert_allclose(forward, [np.cos(pitch), 0, -np.sin(pitch)], atol=1e-6)


def test_unknown_robot_lists_those_that_are() -> None:
    with pytest.raises(UnknownNameError, match="g1"):
        load("g2")


def test_menagerie_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(MissingExtraError, match=r"\[menagerie\]"):
        load("menagerie:unitree_go2")


def test_a_foreign_robot_brings_its_meshes_and_stands_on_its_lowest_point(tmp_path) -> None:
    (tmp_path / "parts").mkdir()
    trimesh.creation.box([0.2, 0.2, 0.1]).export(tmp_path / "parts" / "trunk.stl")
    path = tmp_path / "robot.xml"
    path.write_text(
        """<mujoco><compiler meshdir="parts"/><asset><mesh name="trunk" file="trunk.stl"/></asset>
        <worldbody><body name="trunk" pos="0 0 1"><freejoint/><geom type="mesh" mesh="trunk"/>
        <body name="leg"><joint name="hip" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>
        </body></body></worldbody></mujoco>"""
    )
    robot = from_mjcf("thing", path)
    assert robot.root == "trunk"
    assert robot.base_height == pytest.approx(0.32)
    assert list(robot.files) == ["robot/meshes/trunk.stl"]
    assert robot.home == {"hip": 0.0}


def test_a_robot_without_floating_base_is_refused(tmp_path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text('<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>')
    with pytest.raises(ExportError, match="floating base"):
        from_mjcf("arm", path)
