"""Drives beyond the plain position servo: gears, limits of the joint itself, velocity servos."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from realsim.core.files import to_json
from realsim.gap import DiagnoseConfig, apply_patch, load_case
from realsim.gap.answer.patch import make_patch, patched_xml
from realsim.gap.case.health.conventions import log_conventions
from realsim.gap.case.health.signals import saturation
from realsim.gap.case.motion import estimate
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.evidence.inverse import _phase
from realsim.gap.inference.likelihood.comparison import _torque_steps
from realsim.gap.simulation.simulate import Setting, Simulator
from tests.truths.written import write_case

from .truth import PENDULUM, Truth, make_case

MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm"><joint name="swing" axis="0 1 0" armature="0.02" damping="0.1" frictionloss="0.05" {joint}/>
      <inertial pos="0 0 -.25" mass="1.2" diaginertia="0.02 0.02 0.0005"/></body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>"""


def case_of(folder: Path, actuator: str, joint: str = "", kind: str = "position", gear: float = 1.0) -> Path:
    """A pendulum whose `actuator` is called servo; its log is of steps and a sine, in the actuator's units."""
    t = np.arange(200) * 0.01
    asked = (0.8 * np.sin(3 * t) + 0.5 * np.sign(np.sin(7 * t)) * (t > 0.3))[:, None]
    one = {"time": t, "command": gear * asked, "joint_pos": 0.9 * asked, "joint_torque": 2 * asked}
    xml = MODEL.format(joint=joint, actuator=actuator)
    return write_case(folder, xml, {"a": one}, command_kind=kind, torque_kind="measured")


def geared(folder: Path, gear: float) -> Path:
    """The same drive whatever its gear: 30 N m/rad, 1 N m s/rad and 6 N m at the joint."""
    servo = (
        f'<position name="servo" joint="swing" gear="{gear}" kp="{30 / gear**2}" kv="{1 / gear**2}" '
        f'forcerange="{-6 / abs(gear)} {6 / abs(gear)}"/>'
    )
    return case_of(folder, servo, gear=gear)


def motion(simulator: Simulator, *settings: Setting) -> Any:
    (found,) = simulator.simulate(settings)
    return found


SETTINGS: list[Setting] = [
    ("joint_offset", ("swing",), {"offset": 0.05}),
    ("torque_limit", ("swing",), {"limit": 0.4}),
    ("torque_speed_limit", ("swing",), {"no_load_speed": 0.5}),
    ("load_friction", ("swing",), {"ratio": 0.2}),
    ("torque_phase", (), {"phase": 0.5}),
]


@pytest.mark.parametrize("gear", [5.0, -2.0])
def test_a_gear_changes_no_figure_of_the_joint(gear: float, tmp_path: Path) -> None:
    plain, other = (load_case(geared(tmp_path / str(g), g)) for g in (1.0, gear))
    channels = SimpleNamespace(signal="joint_torque", label="swing", index=0)
    log_conventions(other)
    with Simulator(plain, DiagnoseConfig(threads=1)) as a, Simulator(other, DiagnoseConfig(threads=1)) as b:
        for name in ("torque_range", "peak_torque", "mean_torque", "load_at_speed"):
            assert getattr(b.context, name) == pytest.approx(getattr(a.context, name)), name
        assert b.context.torque_range["swing"] == pytest.approx(6)
        assert b.context.load(("swing",)) == pytest.approx(1, abs=1e-6)
        assert saturation(b)[0]["nominal_drive"] == pytest.approx(saturation(a)[0]["nominal_drive"])
        assert saturation(b)[0]["nominal_drive"]["swing"] > 0.01
        for setting in [None, *SETTINGS]:
            chosen = [setting] if setting else []
            np.testing.assert_allclose(motion(b, *chosen), motion(a, *chosen), atol=1e-6, err_msg=str(setting))
        runs = plain.runs[0], other.runs[0]
        steps = [_torque_steps(c, r, [channels]) for c, r in zip((plain, other), runs, strict=True)]
        np.testing.assert_allclose(steps[1], steps[0], atol=1e-9)
        phases = [_phase(c, r, estimate(c, r)) for c, r in zip((plain, other), runs, strict=True)]
        np.testing.assert_allclose(phases[1], phases[0], atol=1e-9)
        np.testing.assert_allclose(b._command_steps(runs[1]), a._command_steps(runs[0]), atol=1e-9)
        assert np.abs(steps[0]).max() > 1


@pytest.mark.parametrize("gear", [1.0, 5.0, -2.0])
def test_an_encoder_s_zero_is_in_the_file_of_a_geared_servo(gear: float, tmp_path: Path) -> None:
    """At rest under a command of zero, the patched model hangs where its servo's wrong encoder reads zero, nearly."""
    settings = [("joint_offset", ("swing",), {"offset": 0.1})]
    with Simulator(load_case(geared(tmp_path / "case", gear)), DiagnoseConfig(threads=1)) as simulator:
        model = mujoco.MjModel.from_xml_string(patched_xml(simulator, settings))
    data = mujoco.MjData(model)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    weight = 1.2 * 9.81 * 0.25
    assert data.qpos[0] == pytest.approx(-0.1 * 30 / (30 + weight), abs=0.05 / (30 + weight) + 1e-3)


LIMITED = '<position name="servo" joint="swing" kp="100" kv="1" {0}/>'


def test_the_joint_s_own_limit_counts(tmp_path: Path) -> None:
    case = load_case(case_of(tmp_path / "case", LIMITED.format(""), 'actuatorfrcrange="-1 1"'))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        context = simulator.context
        assert (context.torque_range["swing"], context.peak_torque["swing"]) == (1, 1)
        assert np.abs(motion(simulator)[:, 1]).max() == 1
        assert saturation(simulator)[0]["nominal_drive"]["swing"] > 0.3
        for effect, values in (
            ("torque_speed_limit", {"no_load_speed": 0.3}),
            ("backlash", {"gap": 0.02}),
            ("load_friction", {"ratio": 0.5}),
        ):
            found = motion(simulator, (effect, ("swing",), values))
            assert np.abs(found[:, 1]).max() <= 1 + 1e-9, effect
            assert np.abs(found[:, 0] - motion(simulator)[:, 0]).max() < 0.7, effect
        edit = simulator.edited([("backlash", ("swing",), {"gap": 0.02})])
        model = edit.spec.compile()
        assert model.jnt_actfrcrange[model.joint(edit.motor_joint("swing")).id].tolist() == [-1, 1]


def test_a_loaded_link_rests_at_the_end_of_its_play(tmp_path: Path) -> None:
    """As in a calf that carries a robot: an end that gives way by 8 mrad hid plays of 24 and 44."""
    with Simulator(load_case(geared(tmp_path / "case", 1.0)), DiagnoseConfig(threads=1)) as simulator:
        simulator.context.load_reversals["swing"] = 0
        model = simulator.edited([("backlash", ("swing",), {"gap": 0.03})]).spec.compile()
    data = mujoco.MjData(model)
    data.qfrc_applied[model.joint("swing").dofadr[0]] = 5.0
    mujoco.mj_step(model, data, 1000)
    assert abs(data.ten_length[-1]) == pytest.approx(0.015, abs=1.5e-3)


def test_a_limit_that_is_not_the_same_both_ways_stays(tmp_path: Path) -> None:
    range_of_both = 'forcerange="-2 6"', 'actuatorfrcrange="-1.5 6"'
    case = load_case(case_of(tmp_path / "case", LIMITED.format(range_of_both[0]), range_of_both[1]))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        assert simulator.context.torque_range["swing"] == 6
        limit = simulator.edited([("torque_limit", ("swing",), {"limit": 0.5})]).spec.compile()
        assert limit.actuator("servo").forcerange.tolist() == pytest.approx([-2, 3], rel=1e-6)
        slower = simulator.edited([("torque_speed_limit", ("swing",), {"no_load_speed": 0.5})]).spec.compile()
        assert slower.jnt_actfrcrange[0].tolist() == [-1.5, 6]
        assert slower.actuator("servo").forcerange.tolist() == [-2, 6]


def test_a_velocity_servo_s_gain_is_patched_whole(tmp_path: Path) -> None:
    case = load_case(case_of(tmp_path / "case", '<velocity name="servo" joint="swing" kv="5"/>', kind="velocity"))
    settings = [("damping_gain", ("swing",), {"ratio": np.log(0.5)})]
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        patch = json.loads(to_json(make_patch(simulator, settings)))
        spec = mujoco.MjSpec.from_file(str(case.folder / "model.xml"))
        apply_patch(spec, patch)
        models = [spec.compile(), mujoco.MjModel.from_xml_string(patched_xml(simulator, settings))]
        models.append(simulator.edited(settings).spec.compile())
    for model in models:
        assert (model.actuator_gainprm[0, 0], model.actuator_biasprm[0, 2]) == pytest.approx((2.5, -2.5))
    del patch["command_kind"]  # as older ones are
    spec = mujoco.MjSpec.from_file(str(case.folder / "model.xml"))
    apply_patch(spec, patch)
    assert spec.compile().actuator_gainprm[0, 0] == 5


def test_commands_that_come_early_are_not_in_the_file(tmp_path: Path) -> None:
    with Simulator(load_case(geared(tmp_path / "case", 1.0)), DiagnoseConfig(threads=1)) as simulator:
        texts = [patched_xml(simulator, [("command_delay", (), {"delay": d})]) for d in (-0.005, 0.005)]
    assert "not in this file, see patch.wrappers in diagnosis.json: command_delay" in texts[0]
    assert "not in this file" not in texts[1]


def test_a_limit_too_low_in_the_model_can_be_raised(tmp_path: Path) -> None:
    """A servo whose model saturates: a robot with twice the torque follows steps that the model cannot."""
    xml = PENDULUM.replace('forcerange="-18 18"', 'forcerange="-4 4"')
    case = load_case(make_case(tmp_path / "case", PENDULUM, Truth(), runs=2, span=(2.2, 2.6)))
    model = mujoco.MjModel.from_xml_string(xml)
    weak = replace(case, xml=xml, spec=mujoco.MjSpec.from_string(xml), model=model)
    with Simulator(weak, DiagnoseConfig(threads=1)) as simulator:
        (limit,) = lookup("torque_limit").parameters(simulator.context, ("swing",))
        assert limit.bounds[0] < 0
        highest = simulator.edited([("torque_limit", ("swing",), {"limit": limit.bounds[0]})]).set_up(
            case.runs[0].setup
        )
    np.testing.assert_allclose(highest.actuator("swing_servo").forcerange, [-12, 12], rtol=0.02)
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:  # one that never saturates shows only lower limits
        assert lookup("torque_limit").parameters(simulator.context, ("swing",))[0].bounds[0] == 0
