"""Drives that are switched off: said by `enabled`, or by commands that are missing for long."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="j" axis="0 1 0" damping="0.05" armature="0.01"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
</body></worldbody><actuator><position name="a" joint="j" kp="40" kv="2"/></actuator></mujoco>"""
LETS_GO = 1.2


def dropped() -> dict[str, np.ndarray]:
    """An arm is held up and then let go, as MuJoCo has it."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    time = np.arange(0.0, 3.0, 0.01)
    command = 1.0 + 0.2 * np.sin(6 * time)
    on, rows = time < LETS_GO, np.zeros(len(time))
    data.ctrl[:] = command[0]
    for _ in range(2000):
        mujoco.mj_step(model, data)
    for i in range(len(time)):
        rows[i] = data.qpos[0]
        if not on[i]:
            model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
        data.ctrl[:] = command[i]
        for _ in range(5):
            mujoco.mj_step(model, data)
    return {"time": time, "command": command[:, None], "joint_pos": rows[:, None], "enabled": on[:, None].astype(float)}


def case_of(folder: Path, **arrays: np.ndarray) -> Case:
    return load_case(write_case(folder, ARM, {"one": arrays}))


def missed(case: Case) -> float:
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        return float(np.abs(case.runs[0].signals["joint_pos"] - simulator.simulate()[0][:, :1]).max())


def test_an_arm_that_is_let_go_falls_in_the_simulator_too(tmp_path: Path) -> None:
    run = dropped()
    assert np.ptp(run["joint_pos"]) > 1.5
    assert missed(case_of(tmp_path / "said", **run)) < 0.01
    run.pop("enabled")
    assert missed(case_of(tmp_path / "unsaid", **run)) > 1.0


def test_no_command_for_long_means_no_torque_and_a_lost_message_does_not(tmp_path: Path) -> None:
    run = dropped()
    on = run.pop("enabled")[:, 0] > 0.5
    run["command"][~on] = np.nan
    run["command"][50:53] = np.nan
    case = case_of(tmp_path / "case", **run)
    assert case.runs[0].enabled[:, 0].tolist() == on.tolist()
    assert any("the drive is taken to be off" in w for w in case.warnings)
    assert any("3 samples without a command hold the one before" in w for w in case.warnings)
    assert missed(case) < 0.02


def test_other_values_than_0_and_1_are_refused(tmp_path: Path) -> None:
    run = dropped()
    with pytest.raises(GapError, match="other values than 0 and 1"):
        case_of(tmp_path / "case", **run | {"enabled": 2 * run["enabled"]})
    with pytest.raises(GapError, match="enabled has the wrong shape"):
        case_of(tmp_path / "flat", **run | {"enabled": run["enabled"][:, 0]})


def test_a_log_without_commands_is_still_refused(tmp_path: Path) -> None:
    run = dropped() | {"command": np.full((300, 1), np.nan)}
    run.pop("enabled")
    with pytest.raises(GapError, match="the command is missing"):
        case_of(tmp_path / "case", **run)
