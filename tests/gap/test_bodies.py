"""Bodies without joints: what flies as a whole is diagnosed from its pose."""

import os
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.experiments.plan import Planned, planned_case, rig_of
from realsim.gap.pipeline import aloft, limited
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

CRAZYFLIE = Path(os.environ.get("REALSIM_SHARED", "../shared")) / "cases" / "logs" / "cf_W3_M3"
FLYING = """<mujoco><option timestep="0.005"/><worldbody><body name="drone"><freejoint/>
<inertial pos="0 0 0" mass="0.03" diaginertia="2e-5 2e-5 3e-5"/><site name="up"/></body></worldbody>
<actuator><motor name="lift" site="up" gear="0 0 1 0 0 0"/></actuator></mujoco>"""


RIVALS = ("payload", "com_offset", "link_inertia", "command_delay")


def case_in(folder: Path, xml: str = FLYING, **other: object) -> Path:
    """A body that hovers for two seconds; `other` replaces arrays of its run, None leaves one out."""
    time = np.arange(0, 2, 0.01)
    pose = {"base_pos": np.tile([0, 0, 1.0], (len(time), 1)), "base_quat": np.tile([1.0, 0, 0, 0], (len(time), 1))}
    run = {"time": time, "command": 0.2943 + 0.01 * np.sin(6 * time)[:, None], **pose} | other
    kept = {k: v for k, v in run.items() if v is not None}
    return write_case(folder, xml, {"flight": kept}, joint_names=[], command_kind="torque")


def test_a_body_without_joints_is_read(tmp_path: Path) -> None:
    case = load_case(case_in(tmp_path / "case"))
    assert case.joint_names == ()
    assert case.runs[0].signals["joint_pos"].shape == (200, 0)
    assert "base_pos" in case._repr_html_()


def test_it_needs_its_pose(tmp_path: Path) -> None:
    with pytest.raises(GapError, match="'base_quat' is missing"):
        load_case(case_in(tmp_path / "case", base_quat=None))


def test_a_drone_on_the_floor_is_refused(tmp_path: Path) -> None:
    lying = np.random.default_rng(0).normal(0, 1e-4, (200, 3))
    case = case_in(tmp_path / "case", command=np.zeros((200, 1)), base_pos=lying)
    with pytest.raises(GapError, match=r"nothing|constant|more noise than motion"):
        diagnose(load_case(case), DiagnoseConfig(threads=1, report=False))


def test_a_log_is_read_where_the_drone_is_in_the_air(tmp_path: Path) -> None:
    """It waits on the ground, flies up, lands, and flies again."""
    time = np.arange(0, 9, 0.01)
    height = np.interp(time, [1, 2, 3.5, 4.5, 5.5, 6.5, 8, 9], [0, 1, 1, 0, 0, 1, 1, 0])
    pose = {"base_pos": np.stack([0 * time, 0 * time, height], axis=1), "base_quat": np.tile([1.0, 0, 0, 0], (900, 1))}
    flies = ((time > 0.95) & (time < 4.5)) | (time > 5.45)
    command = np.where(flies, 0.2943 + 0.01 * np.sin(6 * time), 0.001)[:, None]
    case = load_case(case_in(tmp_path / "case", time=time, command=command, **pose))
    cut = limited(case, DiagnoseConfig(threads=1))
    assert [r.name for r in cut.runs] == ["flight_1", "flight_2"]
    assert [(r.time[0], round(float(r.time[-1]), 1)) for r in cut.runs] == [(0.0, pytest.approx(3.8, abs=0.3))] * 2
    assert all(r.command.min() > 0.2 for r in cut.runs)
    steady = case.runs[0].where((time > 2) & (time < 3))
    assert aloft(case, steady) == [steady]


def test_joints_of_the_model_are_not_left_out_silently(tmp_path: Path) -> None:
    weight = '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
    arm = f'<body name="arm"><joint name="tilt" axis="0 1 0"/>{weight}</body>'
    with pytest.raises(GapError, match="joint_names is empty, but the model has joints"):
        load_case(case_in(tmp_path / "case", xml=FLYING.replace('<site name="up"/>', f'<site name="up"/>{arm}')))


@pytest.mark.slow
@pytest.mark.skipif(not CRAZYFLIE.is_dir(), reason="needs the logs of REALSIM_SHARED")
def test_a_weight_beside_a_rotor_is_named_with_its_place() -> None:
    """3.9 g beside motor 3, which sits at (-0.033, 0.033) m."""
    config = DiagnoseConfig(threads=1, report=False, bootstrap=50, effects=RIVALS)
    found = diagnose(load_case(CRAZYFLIE), config)
    weight = found.causes[0]
    assert weight["effect"] == "payload"
    low, high = weight["parameters"]["mass"]["ci90"]
    assert low < 0.0039 < high
    assert weight["parameters"]["x"]["value"] < 0 < weight["parameters"]["y"]["value"]


def test_an_experiment_is_planned_without_joints(tmp_path: Path) -> None:
    case = load_case(case_in(tmp_path / "case"))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        rig = rig_of(simulator.context_of_all_runs(), 2.0, 0)
    time = np.arange(0, 2, 0.01)
    (run,) = planned_case(rig, [Planned("hover", time, np.full((len(time), 1), 0.3))]).runs
    assert run.signals["joint_pos"].shape == (len(time), 0)
    np.testing.assert_array_equal(run.signals["base_pos"], np.tile([0, 0, 1.0], (len(time), 1)))
