"""Joints that no drive of their own moves rub, too: a pole on a cart, fingers that a tendon moves."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.simulation.simulate import Simulator
from tests.gap.searching import CONFIG, fitting
from tests.truths.small_robots import CARTPOLE, GRIPPER
from tests.truths.written import write_case

TIME = np.arange(0.0, 4.0, 0.01)
EFFECTS = ("viscous_friction", "coulomb_friction", "payload")


def case_of(
    folder: Path, xml: str, kind: str, commands: Sequence[np.ndarray], pin: float = 0.0, gain: float = 1.0
) -> Case:
    """What MuJoCo does under these commands, (T,) each, with so much more damping at the last joint and its drives'
    gains times so much."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.dof_damping[-1] += pin
    model.actuator_gainprm *= gain
    model.actuator_biasprm *= gain
    runs, rng = {}, np.random.default_rng(0)
    for k, command in enumerate(commands):
        data, places = mujoco.MjData(model), []
        data.ctrl[:] = command[0]
        mujoco.mj_step(model, data, 500)
        for value in command:
            places.append(data.qpos + rng.normal(0, 1e-4, model.nq))
            data.ctrl[:] = value
            mujoco.mj_step(model, data, 5)
        runs[str(k)] = {"time": TIME, "command": command[:, None], "joint_pos": np.array(places)}
    return load_case(write_case(folder, xml, runs, command_kind=kind))


def cart(folder: Path, pin: float = 0.0) -> Case:
    pushes = [8 * np.sin(2 * np.pi * f * TIME) * np.clip(TIME - 0.3, 0, 1) for f in (0.7, 1.1, 1.6)]
    return case_of(folder, CARTPOLE, "torque", pushes, pin)


def test_friction_in_a_pin_is_found(tmp_path: Path) -> None:
    found = diagnose(cart(tmp_path, 0.02), DiagnoseConfig(threads=1, effects=EFFECTS, report=False))
    (cause,) = found.causes
    assert (cause["effect"], cause["joints"]) == ("viscous_friction", ["pin"])
    assert cause["parameters"]["damping"]["value"] == pytest.approx(0.02, rel=0.1)


def test_no_value_is_shared_by_a_joint_that_turns_and_one_that_slides(tmp_path: Path) -> None:
    with fitting(cart(tmp_path), EFFECTS) as fitter:
        frictions = [c for c in fitter.screen.candidates if c.effect == "coulomb_friction"]
    assert {c.place: c.parameters[0].unit for c in frictions} == {("rail",): "N", ("pin",): "N m"}


def test_a_tendon_loads_the_joints_that_it_moves(tmp_path: Path) -> None:
    opens = [0.02 + 0.012 * np.sin(2 * np.pi * f * TIME) for f in (0.4, 0.9)]
    with Simulator(case_of(tmp_path, GRIPPER, "position", opens), CONFIG) as simulator:
        context = simulator.context
    assert context.passive == ["left_slide", "right_slide"]
    assert all(0.3 < context.peak_torque[j] < 16 for j in context.passive)  # N; the drive gives 30 on both


def test_the_gain_of_a_drive_that_pulls_a_tendon(tmp_path: Path) -> None:
    grips = [0.02 + 0.012 * np.sign(np.sin(2 * np.pi * f * TIME)) * np.clip(TIME - 0.3, 0, 1) for f in (0.5, 0.8, 1.2)]
    case = case_of(tmp_path, GRIPPER, "position", grips, gain=0.6)
    effects = ("tendon_gain", "actuator_lag", "viscous_friction", "coulomb_friction")
    (cause,) = diagnose(case, DiagnoseConfig(threads=1, effects=effects, report=False)).causes
    assert (cause["effect"], cause["actuators"]) == ("tendon_gain", ["grip"])
    assert cause["parameters"]["ratio"]["value"] == pytest.approx(0.6, rel=0.05)
