"""Effects that real robots need: gains far off, a torque that goes with the position, friction of every joint."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.gap import EFFECTS, DiagnoseConfig, load_case
from realsim.gap.case.model.context import build_context
from realsim.gap.case.model.edit import Edit
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.stepping import Waves
from tests.truths.small_robots import WRIST
from tests.truths.written import write_case

from .truth import Truth


@pytest.fixture(scope="module")
def arm(made):
    with Simulator(load_case(made(Truth())), DiagnoseConfig(threads=1)) as found:
        yield found


@pytest.mark.parametrize("name", ["stiffness_gain", "damping_gain", "motor_gain"])
def test_a_gain_may_be_a_hundred_times_off_either_way(name: str, arm: Simulator) -> None:
    (p,) = EFFECTS[name].parameters(arm.context, ("elbow",))
    low, high = (p.report(end) for end in p.bounds)
    assert (low, high) == pytest.approx((0.01, 100.0))
    assert p.report(0.0) == 1.0
    before = arm.context.case.model.actuator(arm.context.actuator["elbow"]).biasprm
    edit = arm.edited([(name, ("elbow",), {"ratio": np.log(70.0)})])
    after = edit.spec.compile().actuator(arm.context.actuator["elbow"]).biasprm
    column = 2 if name == "damping_gain" else 1
    assert after[column] == pytest.approx(70 * before[column])


def test_a_constant_torque_is_what_a_motor_with_that_bias_gives(arm: Simulator) -> None:
    """MuJoCo's own way to say it: another actuator on the joint, whose force is constant."""
    edit = arm.edited([])
    motor = edit.add_helper("bias", "elbow", 0.0)
    motor.biasprm = np.array([0.5, *np.zeros(len(motor.biasprm) - 1)])
    theirs = arm.roll_out(edit, None)[0]
    ours = arm.simulate([("position_torque", ("elbow",), {"constant": 0.5})])[0]
    assert np.abs(ours - arm.simulate()[0]).max() > 1e-3
    np.testing.assert_allclose(ours, arm.read(arm.case.runs[0], theirs, edit), atol=1e-8)


def test_waves_are_the_fourier_series_that_they_say() -> None:
    one = np.array([0])
    found = Waves(one, one, np.array([0.1]), np.array([[0.2, 0.3]]), np.array([[0.4, 0.5]]))
    q = 0.7
    expected = 0.1 + 0.2 * np.cos(q) + 0.4 * np.sin(q) + 0.3 * np.cos(2 * q) + 0.5 * np.sin(2 * q)
    assert found.at(np.array([q])) == pytest.approx([expected])


def test_two_torques_of_one_joint_add_up(arm: Simulator) -> None:
    both = [("position_torque", ("elbow",), {"sin_1": a}) for a in (0.3, 0.4)]
    sums = arm.simulate([("position_torque", ("elbow",), {"sin_1": 0.7})])
    np.testing.assert_allclose(arm.simulate(both)[0], sums[0], atol=1e-9)


def test_friction_of_joints_is_that_of_each_joint_together(arm: Simulator) -> None:
    (place,) = EFFECTS["friction_of_joints"].places(arm.context)
    assert place == tuple(arm.context.driven)
    names = {p.name for p in EFFECTS["friction_of_joints"].parameters(arm.context, place)}
    assert names == {"shoulder", "elbow", "shoulder viscous", "elbow viscous"}
    together = arm.simulate([("friction_of_joints", place, {"shoulder": 0.3, "elbow": 0.1, "elbow viscous": 0.2})])
    apart = arm.simulate([
        ("coulomb_friction", ("shoulder",), {"friction": 0.3}),
        ("coulomb_friction", ("elbow",), {"friction": 0.1}),
        ("viscous_friction", ("elbow",), {"damping": 0.2}),
    ])  # fmt: skip
    np.testing.assert_allclose(together[0], apart[0], atol=1e-12)


def test_stribeck_friction_without_more_of_it_at_rest_is_none(arm: Simulator) -> None:
    """Else Coulomb friction would have a rival that does the same with two parameters more."""
    plain = {"static_friction": 0.0, "coulomb": 0.4}
    np.testing.assert_array_equal(arm.simulate([("stribeck_friction", ("elbow",), plain)])[0], arm.simulate()[0])
    real = plain | {"static_friction": 0.8}
    assert np.abs(arm.simulate([("stribeck_friction", ("elbow",), real)])[0] - arm.simulate()[0]).max() > 1e-3


@pytest.mark.parametrize(("name", "values"), [("payload", {"mass": 0.9, "z": 0.1}), ("com_offset", {"x": 0.02})])
def test_what_makes_up_for_gravity_knows_nothing_of_what_differs(name: str, values: dict, tmp_path: Path) -> None:
    """0.9 kg at the end of a compensated arm had been found beside a force of 13 N, which was its weight."""
    time = np.arange(0, 1, 0.01)
    run = {"time": time, "command": np.tile(np.sin(time)[:, None], 3), "joint_pos": np.zeros((100, 3))}
    xml = WRIST.replace("<body ", '<body gravcomp="1" ')
    edit = Edit(build_context(load_case(write_case(tmp_path, xml, {"run": run}))))
    for place in (("flange",), ("pitch_link",)):
        defaults = {p.name: p.default for p in EFFECTS[name].parameters(edit.context, place)}
        EFFECTS[name].apply(edit, place, defaults | values)
    force = []
    for model in (edit.context.spec.compile(), edit.spec.compile()):
        data = mujoco.MjData(model)
        data.qpos = [0.4, -0.7, 0.9]
        mujoco.mj_forward(model, data)
        force.append([data.qfrc_gravcomp.copy(), data.qfrc_bias.copy()])
    (known, weighs), (still, differs) = force
    np.testing.assert_allclose(still, known, atol=1e-9)
    assert np.abs(differs - weighs).max() > 0.05
