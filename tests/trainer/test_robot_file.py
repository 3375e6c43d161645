"""A robot of one's own, from its model to one that is simulated: what models bring that ours do not have."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.core.errors import RealsimError
from realsim.core.geometry import quat_to_R
from trainer.robots import TrainedRobot, named
from trainer.robots.check import check
from trainer.robots.file import load
from trainer.robots.guess import guess
from trainer.robots.soles import collides

CORNERS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}


def mjcf(extra: str = "", joint: str = "", equality: str = "", knee_mass: float = 0.3, key: bool = True) -> str:
    """A dog in the manner of Menagerie: feet are spheres of the calves, motors with a gear, a drawn shell."""
    leg = """<body name="{n}_thigh" pos="{x} {y} 0"><joint name="{n}_hip" axis="1 0 0" range="-1 1" armature="0.01"/>
      <joint name="{n}_thigh" axis="0 1 0" range="-1 3" armature="0.01"/>
      <geom type="capsule" fromto="0 0 -0.05 0 0 -0.17" size="0.02" mass="0.5"/>
      <body name="{n}_calf" pos="0 0 -0.2"><joint name="{n}_calf" axis="0 1 0" range="-2.7 -0.8" armature="0.01"/>
        <geom type="capsule" fromto="0 0 -0.05 0 0 -0.15" size="0.012" mass="{m}"/>
        <geom name="{n}" type="sphere" size="0.022" pos="0 0 -0.2" mass="0.05" friction="1.4 0.01 0.01"/>{joint}</body>
    </body>"""
    legs = "".join(leg.format(n=n, x=x, y=y, m=knee_mass, joint=joint.format(n=n)) for n, (x, y) in CORNERS.items())
    parts = [f"{n}_{part}" for n in CORNERS for part in ("hip", "thigh", "calf")]
    motors = "".join(f'<motor joint="{p}" gear="8" ctrlrange="-3 3"/>' for p in parts)
    pose = " ".join(["0 0.9 -1.8"] * 4)
    home = f'<keyframe><key name="home" qpos="0 0 0.3 1 0 0 0 {pose}"/></keyframe>' if key else ""
    return f"""<mujoco><compiler angle="radian"/><worldbody>
      <geom type="plane" size="0 0 1"/><body name="trunk" pos="0 0 0.4"><freejoint/>
      <geom type="box" size="0.2 0.08 0.05" mass="6"/>
      <geom type="box" size="0.5 0.5 0.5" contype="0" conaffinity="0" mass="0"/>
      <camera name="front" pos="0.25 0 0.02" xyaxes="0 -1 0 0.438 0 0.899"/>{extra}{legs}</body></worldbody>
      <equality>{equality}</equality><actuator>{motors}</actuator>{home}</mujoco>"""


def urdf() -> str:
    """A dog in the manner of pybullet's: toes are links of their own, the root has no joint, limits are the URDF's."""
    link = (
        '<link name="{n}"><inertial><mass value="{m}"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/>'
    )
    link += '</inertial><collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision></link>'
    hinge = '<joint name="{n}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
    hinge += '<origin xyz="{at}"/><axis xyz="{axis}"/>'
    hinge += '<limit lower="{low}" upper="{high}" effort="30" velocity="21"/></joint>'
    text = link.format(n="body", m=8, i=0.1, at="0 0 0", shape='<box size="0.4 0.16 0.1"/>')
    for n, (x, y) in CORNERS.items():
        text += link.format(n=f"{n}_up", m=0.6, i=0.002, at="0 0 -0.1", shape='<box size="0.03 0.03 0.1"/>')
        text += link.format(n=f"{n}_low", m=0.2, i=0.001, at="0 0 -0.09", shape='<box size="0.02 0.02 0.1"/>')
        text += link.format(n=f"{n}_toe", m=0.05, i=1e-5, at="0 0 0", shape='<sphere radius="0.02"/>')
        text += hinge.format(n=f"{n}_1", a="body", b=f"{n}_up", at=f"{x} {y} 0", axis="0 1 0", low=-1, high=2)
        text += hinge.format(n=f"{n}_2", a=f"{n}_up", b=f"{n}_low", at="0 0 -0.2", axis="0 1 0", low=-2.5, high=-0.6)
        text += f'<joint name="{n}_3" type="fixed"><parent link="{n}_low"/><child link="{n}_toe"/>'
        text += '<origin xyz="0 0 -0.2"/></joint>'
    return f'<robot name="dog">{text}</robot>'


BIPED = """<mujoco><worldbody><body name="pelvis" pos="0 0 1"><freejoint/><geom type="sphere" size="0.1" mass="10"/>
  <body name="torso"><joint name="waist" axis="0 0 1" range="-60 60"/>
  <geom type="capsule" fromto="0 0 .15 0 0 .4" size=".1" mass="9"/></body>{legs}</body></worldbody></mujoco>"""
SHIN = """<body name="{s}_leg" pos="0 {y} -0.1"><joint name="{s}_roll" axis="1 0 0" range="-30 30"/>
  <joint name="{s}_pitch" axis="0 1 0" range="-90 90"/>
  <geom type="capsule" fromto="0 0 -.1 0 0 -.6" size=".04" mass="4"/>
  <body name="{s}_foot" pos="0 0 -0.75"><joint name="{s}_ankle" axis="0 1 0" range="-45 45"/>
  <geom type="box" size="0.1 0.04 0.02" pos="0.03 0 -0.03" mass="1"/></body></body>"""


def biped() -> str:
    return BIPED.format(legs="".join(SHIN.format(s=s, y=y) for s, y in (("left", 0.1), ("right", -0.1))))


def made(tmp_path: Path, text: str, name: str = "dog.xml") -> TrainedRobot:
    model, out = tmp_path / name, tmp_path / "dog.toml"
    model.write_text(text)
    found, reasons = guess(model, out)
    out.write_text(found.text(reasons))
    return named(str(out))


@pytest.mark.parametrize(("text", "name"), [(mjcf(), "dog.xml"), (urdf(), "dog.urdf")])
def test_a_dog_stands_drops_and_moves_its_joints(tmp_path: Path, text: str, name: str) -> None:
    robot = made(tmp_path, text, name)
    findings = check(robot)
    assert [f.text for f in findings if f.level == "bad"] == []
    assert findings[0].text.startswith("stands for 2 s")
    assert len(robot.feet) == 4
    assert all(len(points) == 1 for points in robot.soles)
    model = robot.robot.spec.compile()
    assert [model.joint(i).name for i in range(1, model.njnt)] == list(robot.joints)
    assert not any(model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE for g in range(model.ngeom))


def test_a_models_own_figures_are_taken(tmp_path: Path) -> None:
    """Torque is control range times gear, masses are kept, the foot is a body of its own, level, with its friction;
    what is only drawn does not collide; the camera is the model's."""
    robot = made(tmp_path, mjcf())
    model = robot.robot.spec.compile()
    np.testing.assert_allclose(robot.effort, 24.0)
    np.testing.assert_allclose(robot.default.reshape(4, 3), [[0, 0.9, -1.8]] * 4)
    assert model.body_mass.sum() == pytest.approx(6 + 4 * (0.5 + 0.3 + 0.05))
    shells = [g for g in range(model.ngeom) if model.geom_size[g][0] == 0.5]
    assert len(shells) == 1
    assert not collides(model, shells[0])
    data = mujoco.MjData(model)
    data.qpos[3], data.qpos[7:] = 1, robot.default
    mujoco.mj_kinematics(model, data)
    for foot in robot.feet:
        np.testing.assert_allclose(data.body(foot).xmat.reshape(3, 3), np.eye(3), atol=1e-6)
        assert [
            model.geom_friction[g][0] for g in range(model.ngeom) if model.geom_bodyid[g] == model.body(foot).id
        ] == [1.4]
    assert data.body(robot.feet[0]).xpos[2] - 0.022 == pytest.approx(data.qpos[2] - robot.standing_height, abs=1e-6)
    looks = quat_to_R(robot.camera.quat) @ [1, 0, 0]
    np.testing.assert_allclose(looks, [np.cos(np.radians(26)), 0, -np.sin(np.radians(26))], atol=1e-3)


def test_limits_of_a_urdf_are_taken(tmp_path: Path) -> None:
    robot = made(tmp_path, urdf(), "dog.urdf")
    np.testing.assert_allclose(robot.effort, 30.0)
    np.testing.assert_allclose(robot.velocity, 21.0)
    np.testing.assert_allclose(robot.lower[1::2], -2.5)


def test_a_mass_without_inertia_takes_that_of_its_shape(tmp_path: Path) -> None:
    model = made(tmp_path, urdf().replace('ixx="0.002" iyy="0.002" izz="0.002"', 'ixx="0" iyy="0" izz="0"'), "dog.urdf")
    thigh = model.robot.spec.compile().body("FL_up")
    assert thigh.mass == pytest.approx(0.6)
    np.testing.assert_allclose(np.sort(thigh.inertia), 0.6 / 12 * np.array([0.0018, 0.0109, 0.0109]), rtol=1e-3)


def test_feet_stand_below_hips_that_turn_without_limit(tmp_path: Path) -> None:
    limited = made(tmp_path, urdf(), "dog.urdf").default
    free = made(tmp_path, urdf().replace('lower="-1" upper="2"', ""), "dog.urdf").default
    np.testing.assert_allclose(free, limited, atol=0.01)
    assert abs(free[0]) > 0.3


def test_wheels_at_the_feet_are_locked(tmp_path: Path) -> None:
    end = '<origin xyz="0 0 -0.2"/>'
    rolling = (
        urdf()
        .replace('type="fixed"', 'type="continuous"')
        .replace(f"{end}</joint>", f'{end}<axis xyz="0 1 0"/></joint>')
    )
    robot = made(tmp_path, rolling, "dog.urdf")
    assert len(robot.joints) == 8
    assert "wheels" in (tmp_path / "dog.toml").read_text()


def test_legs_that_are_bent_for_the_default_pose_are_not_called_straight(tmp_path: Path) -> None:
    for text, name, says in ((urdf(), "dog.urdf", "mid-range"), (mjcf(), "dog.xml", "key frame 'home'")):
        (tmp_path / name).write_text(text)
        found, reasons = guess(tmp_path / name, tmp_path / "dog.toml")
        assert any(joint.default for joint in found.joints.values())
        assert says in reasons["joints"]


def test_flat_feet_have_a_sole(tmp_path: Path) -> None:
    robot = made(tmp_path, biped())
    assert robot.torso == "torso"
    assert [len(points) for points in robot.soles] == [36, 36]
    np.testing.assert_allclose(robot.soles[0].min(0), [-0.07, -0.04, -0.05])
    assert [robot.joints[j] for j in robot.hips] == ["left_roll", "right_roll"]
    assert [robot.joints[j] for j in robot.upper_body] == ["waist"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (mjcf(equality='<connect body1="FL_calf" body2="FR_calf" anchor="0 0 0"/>'), "closed chains"),
        (mjcf(extra='<body name="tail"><joint name="wag" axis="0 0 1"/></body>'), "no mass on tail"),
        (mjcf(extra='<body name="arm"><joint name="arm" axis="0 0 1"/><geom type="mesh" mesh="a"/></body>'), "mesh"),
        (mjcf(extra='<site name="s"/>').replace('motor joint="FL_hip"', 'motor site="s"'), "no joint"),
        ('<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>', "driven"),
        ('<mujoco><worldbody><body name="b"><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>', "held by"),
        ("<mujoco><nothing/></mujoco>", "cannot read"),
    ],
)  # fmt: skip
def test_what_cannot_be_trained_is_named_with_the_way_out(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(RealsimError) as error:
        made(tmp_path, text)
    assert says in error.value.render()


def test_joints_that_nothing_drives_are_locked(tmp_path: Path) -> None:
    spring = '<body pos="0 0 -.2"><joint name="{n}_toe" axis="0 1 0" stiffness="9"/>'
    spring += '<geom size=".01" pos=".02 0 0" mass=".01"/></body>'
    robot = made(tmp_path, mjcf(joint=spring, key=False))
    assert len(robot.joints) == 12


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("FL_calf = ", "FL_calve = ", "FL_calve"),
        ('base = "trunk"', 'base = "trunck"', "trunck"),
        ("kp = ", "stiffness = ", "stiffness"),
        ("effort = 24", "effort = -24", "positive"),
        ('"FR_calf", ', "", "pairs"),
        ("[joints]", "[joints", "TOML"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    made(tmp_path, mjcf())
    out = tmp_path / "dog.toml"
    text = out.read_text().replace('"FL_calf" = ', "FL_calf = ")
    assert old in text
    out.write_text(text.replace(old, new, 1))
    with pytest.raises(RealsimError) as error:
        load(out)
    assert says in error.value.render()


def test_a_model_that_grows_without_bound_is_refused_before_mujoco_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "dog.xml"
    path.write_text(mjcf('<replicate count="100000000" offset="0 0 1"><geom size="0.1"/></replicate>'))
    with pytest.raises(RealsimError, match="too large"):
        guess(path, tmp_path / "dog.toml")


def test_a_plugin_that_mujoco_brings_is_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "dog.xml"
    extension = '<extension><plugin plugin="mujoco.pid"><instance name="pid"/></plugin></extension>'
    path.write_text(mjcf().replace("<worldbody>", f"{extension}<worldbody>", 1))
    assert guess(path, tmp_path / "dog.toml")
