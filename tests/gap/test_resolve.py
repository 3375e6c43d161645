"""What MuJoCo's compiler works out by itself neither undoes an edit nor changes with it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, apply_patch, load_case
from realsim.gap.answer.patch import make_patch
from realsim.gap.case.resolve import resolve
from realsim.gap.simulation.simulate import Setting, Simulator
from tests.truths.written import write_case

from .test_patch import STANDING
from .truth import ARM, PENDULUM

ODD = """
<mujoco>
  <compiler eulerseq="zyx" {0}/>
  <asset><mesh name="wedge" vertex="0 0 0 1 0 0 0 2 0 0 0 3"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" euler="0 5 0"/>
    <geom name="beam" type="box" size=".1 .1" fromto="3 0 0 4 1 1"/>
    <body name="step" pos="1 0 .1" euler="10 0 20"><geom type="box" size=".3 .3 .1"/>
      <body name="ledge" pos=".2 0 .2"><geom type="box" size=".1 .1 .1"/></body></body>
    <body name="trunk" pos="0 0 1"><freejoint/><geom type="box" size=".15 .1 .05" mass="4"/>
      <body name="link" euler="10 20 30"><joint name="hip" axis="0 1 0" springdamper="0.1 1"/>
        <inertial pos="0 0 .1" mass="1" diaginertia="1 2 2.5" euler="0 0 45"/>
        <geom type="box" size=".1 .05 .05" euler="0 30 0"/>
        <body name="toe" zaxis="1 1 1" pos="0 0 -.2"><joint name="ankle"/>
          <geom type="mesh" mesh="wedge" axisangle="1 1 0 40"/></body></body></body>
  </worldbody>
  <actuator><position name="servo" joint="hip" kp="60" dampratio="1"/>
    <position name="ankle_servo" joint="ankle" kp="10" kv="1"/></actuator>
</mujoco>"""
OPTIONS = ("", 'inertiafromgeom="true"', 'boundmass="2" boundinertia="3"', 'balanceinertia="true"')


def simulator_of(folder: Path, xml: str) -> Simulator:
    """Of a case with one short run in which nothing happens; joints and actuators are the model's."""
    model = mujoco.MjModel.from_xml_string(xml)
    joints = int((model.jnt_type >= 2).sum())
    run = {"time": np.arange(30) * 0.01, "command": np.zeros((30, model.nu)), "joint_pos": np.zeros((30, joints))}
    if (model.jnt_type == 0).any():
        run |= {"base_pos": np.ones((30, 1)) * [0, 0, 1]}
    return Simulator(load_case(write_case(folder, xml, {"a": run})), DiagnoseConfig(threads=1))


def differing(a: mujoco.MjModel, b: mujoco.MjModel) -> list[str]:
    """Names of the arrays in which two models differ, to the last bit."""
    names = [n for n in dir(a) if not n.startswith("_") and isinstance(getattr(a, n), np.ndarray)]
    return [n for n in names if not np.array_equal(getattr(a, n), getattr(b, n))]


@pytest.mark.parametrize("xml", [ARM, PENDULUM, STANDING, *(ODD.format(option) for option in OPTIONS)])
def test_the_nominal_model_stays_the_same(xml: str) -> None:
    spec = mujoco.MjSpec.from_string(xml)
    before = spec.copy().compile()
    for _ in range(2):
        resolve(spec)
        assert differing(before, spec.copy().compile()) == []


def test_bodies_that_were_to_be_fused_stay(tmp_path: Path) -> None:
    xml = ODD.format('fusestatic="true"').replace('name="toe" zaxis="1 1 1" pos="0 0 -.2"><joint name="ankle"/>', ">")
    xml = xml.replace('<position name="ankle_servo" joint="ankle" kp="10" kv="1"/>', "")
    spec = mujoco.MjSpec.from_string(xml)
    fused = spec.copy().compile()
    resolve(spec)
    kept = spec.compile()
    assert kept.nbody > fused.nbody
    assert kept.body("trunk").subtreemass[0] == pytest.approx(fused.body("trunk").subtreemass[0])
    assert kept.actuator_biasprm[0, 2] == pytest.approx(fused.actuator_biasprm[0, 2])


@pytest.fixture(scope="module")
def edited(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Setting], tuple[Any, Any]]:
    """(nominal model, edited model); the same edit as a patch of the plain file gives the same model."""
    root = tmp_path_factory.mktemp("resolve")

    def edit(xml: str, setting: Setting) -> tuple[Any, Any]:
        with simulator_of(root / str(len(list(root.iterdir()))), xml) as simulator:
            settings = [setting]
            model = simulator.edited([setting]).spec.compile()
            spec = mujoco.MjSpec.from_file(str(simulator.case.folder / "model.xml"))
            apply_patch(spec, make_patch(simulator, settings))
            patched = spec.compile()
            for name in ("body_mass", "body_ipos", "body_iquat", "body_inertia", "geom_quat", "geom_pos", "body_quat"):
                np.testing.assert_allclose(getattr(patched, name), getattr(model, name), atol=1e-12, err_msg=name)
            np.testing.assert_allclose(patched.actuator_biasprm, model.actuator_biasprm, atol=1e-12)
            return simulator.case.model, model

    return edit


@pytest.mark.parametrize(
    ("effect", "place", "values", "ratio"),
    [
        ("armature", ("hip",), {"armature": 0.5}, 1.0),
        ("payload", ("trunk",), {"mass": 3.0}, 1.0),
        ("stiffness_gain", ("hip",), {"ratio": 0.5}, 1.0),
        ("damping_gain", ("hip",), {"ratio": np.log(1.5)}, 1.5),
        ("motor_gain", ("hip",), {"ratio": np.log(1.5)}, 1.5),
    ],
)
def test_a_damping_ratio_is_the_gain_that_it_was(
    effect: str, place: tuple[str, ...], values: dict[str, float], ratio: float, edited: Any
) -> None:
    before, after = edited(ODD.format(""), (effect, place, values))
    assert before.actuator_biasprm[0, 2] < 0
    assert after.actuator_biasprm[0, 2] == pytest.approx(ratio * before.actuator_biasprm[0, 2], rel=1e-12)
    np.testing.assert_allclose(after.jnt_stiffness, before.jnt_stiffness)
    np.testing.assert_allclose(after.dof_damping, before.dof_damping)


def test_the_whole_ground_tilts_by_the_same(edited: Any) -> None:
    """However its parts' orientation is written, and whatever they stand on."""
    before, after = edited(ODD.format(""), ("terrain_tilt", (), {"roll": 0.1, "pitch": -0.05}))
    poses = []
    for model in (before, after):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        fixed = model.body_weldid[model.geom_bodyid] == 0
        poses.append((data.geom_xpos[fixed], data.geom_xmat[fixed].reshape(-1, 3, 3)))
    (places, turns), (new_places, new_turns) = poses
    turn = new_turns[0] @ turns[0].T
    assert np.arccos((np.trace(turn) - 1) / 2) == pytest.approx(np.hypot(0.1, 0.05), rel=0.01)
    np.testing.assert_allclose(new_turns, turn @ turns, atol=1e-12)
    np.testing.assert_allclose(new_places, places @ turn.T, atol=1e-12)
    moving = [before.body(n).id for n in ("trunk", "link", "toe")]
    np.testing.assert_array_equal(after.body_quat[moving], before.body_quat[moving])


@pytest.mark.parametrize("option", OPTIONS)
def test_a_payload_is_added_to_what_the_model_has(option: str, edited: Any) -> None:
    """Inertia about the link's origin: the model's, and that of the mass; so with an inertial that is turned."""
    where = np.array([0.1, 0.2, 0.3])
    values = {"mass": 2.0, **dict(zip("xyz", where.tolist(), strict=True))}
    before, after = edited(ODD.format(option), ("payload", ("link",), values))
    added = 2 * (where @ where * np.eye(3) - np.outer(where, where))
    assert after.body("link").mass[0] == pytest.approx(before.body("link").mass[0] + 2)
    np.testing.assert_allclose(about_origin(after), about_origin(before) + added, atol=1e-9)


def about_origin(model: mujoco.MjModel, name: str = "link") -> np.ndarray:
    body, turn = model.body(name), np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    R, c = turn.reshape(3, 3), body.ipos
    return np.asarray(R @ np.diag(body.inertia) @ R.T + body.mass[0] * (c @ c * np.eye(3) - np.outer(c, c)))


def test_a_shifted_centre_of_mass_keeps_the_axes(edited: Any) -> None:
    before, after = edited(ODD.format(""), ("com_offset", ("link",), {"x": 0.02}))
    turns = []
    for model in (before, after):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body("link").iquat)
        R = turn.reshape(3, 3)
        turns.append(R @ np.diag(model.body("link").inertia) @ R.T)
    np.testing.assert_allclose(turns[1], turns[0], atol=1e-12)
    np.testing.assert_allclose(after.body("link").ipos - before.body("link").ipos, [0.02, 0, 0], atol=1e-12)
