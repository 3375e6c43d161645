"""Models that cannot be compared with their robot end the run with what to mend; a good log raises no false alarm."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.case.health import examine
from realsim.gap.case.health.examination import _runaway
from realsim.gap.case.runs import Run
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

JOINTS = ["one", "two", "three"]


def chain(gain: float = 60.0, damping: float = 2.0, size: float = 0.02, options: str = "") -> str:
    bodies = "".join(
        f'<body name="link_{n}" pos="0 0 -{0.2 if i else 0.05}"><joint name="{n}" axis="0 1 0" armature="0.02"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="{size}" mass="0.5"/>'
        for i, n in enumerate(JOINTS)
    )
    servos = "".join(f'<position name="{n}_servo" joint="{n}" kp="{gain}" kv="{damping}"/>' for n in JOINTS)
    return f"""<mujoco><option timestep="0.002" integrator="implicitfast">{options}</option><worldbody>
    <body name="trunk" pos="0 0 1"><geom type="box" size="0.1 0.1 0.1" mass="5"/>{bodies}</body></body></body></body>
    </worldbody><actuator>{servos}</actuator></mujoco>"""


def logged(xml: str, commands: np.ndarray, rate: float = 100.0) -> np.ndarray:
    """(T, J) positions of a robot that is this model, from rest, without noise."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, rows = mujoco.MjData(model), []
    every = round(1 / rate / model.opt.timestep)
    for row in commands:
        data.ctrl[:] = row
        rows.append(data.qpos.copy())
        for _ in range(every):
            mujoco.mj_step(model, data)
    return np.array(rows)


def case_of(folder: Path, xml: str, commands: np.ndarray, positions: np.ndarray, **said: Any) -> Case:
    run = {"time": np.arange(len(commands)) / 100, "command": commands, "joint_pos": positions}
    return load_case(write_case(folder, xml, dict.fromkeys("ab", run), **said))


def health(case: Case) -> dict[str, Any]:
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        return examine(simulator)


def waves(lead: float = 0.0) -> np.ndarray:
    time = np.arange(0.0, 4.0, 0.01)
    phase = np.maximum(time - lead, 0.0)[:, None] * np.array([2.0, 3.0, 4.0])
    return 0.5 * np.sin(phase)


APART = '<flag contact="disable"/>'


def test_links_inside_a_trunk_that_is_fixed_to_the_world_are_refused(tmp_path: Path) -> None:
    good = logged(chain(options=APART), waves())
    with pytest.raises(GapError, match="inside each other") as caught:
        health(case_of(tmp_path / "touching", chain(), waves(), good))
    assert "link_one and trunk" in str(caught.value)
    assert health(case_of(tmp_path / "apart", chain(options=APART), waves(), good))["warnings"]


def test_a_robot_that_begins_inside_the_ground_is_told_how_deep(tmp_path: Path) -> None:
    """Its weight presses a foot in by less than a millimetre; what is deeper is pushed out, no motion of its own."""
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="hopper" pos="0 0 0.3"><freejoint/>
    <geom type="box" size="0.1 0.1 0.05" mass="2"/><body name="foot"><joint name="leg" type="slide" axis="0 0 1"
    range="-0.1 0.1"/><geom type="box" pos="0 0 -0.2" size="0.05 0.05 0.05" mass="0.5"/></body></body></worldbody>
    <actuator><position name="leg_servo" joint="leg" kp="2000" kv="50"/></actuator></mujoco>"""
    time = np.arange(0.0, 3.0, 0.01)
    commands = 0.02 * np.sin(3 * time)[:, None]
    said = {}
    for name, height in (("right", 0.25), ("buried", 0.2)):
        base = np.tile([0.0, 0.0, height], (len(time), 1))
        run = {"time": time, "command": commands, "joint_pos": commands, "base_pos": base}
        case = load_case(write_case(tmp_path / name, xml, dict.fromkeys("ab", run)))
        said[name] = [w for w in health(case)["warnings"] if "inside the ground" in w]
    assert not said["right"]
    assert any(f"{depth} mm inside the ground" in said["buried"][0] for depth in (49, 50))


def test_a_model_that_does_not_follow_where_the_robot_does_is_refused(tmp_path: Path) -> None:
    real = logged(chain(options=APART), waves())
    with pytest.raises(GapError, match="the nominal simulator does not") as caught:
        health(case_of(tmp_path / "weak", chain(gain=0.05, damping=5.0, options=APART), waves(), real))
    assert "3 of 3 joints" in str(caught.value)


def test_a_joint_that_leaves_its_rest_fast_begins_at_rest(tmp_path: Path) -> None:
    commands = waves()
    commands[0] = 0.0
    commands[1:] = 1.0  # a step at the second sample
    xml = chain(gain=300.0, damping=8.0, options=APART)
    positions = logged(xml, commands) + np.random.default_rng(0).normal(0, 1e-4, (len(commands), 3))
    assert np.ptp(positions[:10, 2]) > 0.1
    found = health(case_of(tmp_path / "case", xml, commands, positions))
    assert not any("begin at rest" in w for w in found["warnings"])


def test_a_joint_that_spins_up_runs_away(tmp_path: Path) -> None:
    free = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="one" axis="0 0 1"/>
    <geom size="0.1" mass="0.5"/></body></worldbody><actuator><motor name="one_servo" joint="one"/></actuator>
    </mujoco>"""
    time = np.arange(0.0, 3.0, 0.01)
    torque = 40.0 * np.ones((len(time), 1))
    torque[0] = 0.0
    run = {"time": time, "command": torque, "joint_pos": 0.1 * time[:, None] ** 2}
    with pytest.raises(GapError, match="runs away"):
        health(load_case(write_case(tmp_path, free, {"a": run}, command_kind="torque")))


@pytest.mark.parametrize(("scale", "said"), [(1.0, ""), (1e-3, "cannot drive the logged motion"), (1e3, "runs away")])
def test_torques_of_another_unit_are_refused(tmp_path: Path, scale: float, said: str) -> None:
    xml = chain(options='<flag contact="disable"/>').replace("<position", "<motor")
    xml = re.sub(r' k[pv]="[^"]*"', "", xml).replace('armature="0.02"', 'armature="0.02" damping="0.5"')
    torques = 0.4 * waves()
    case = case_of(tmp_path / "case", xml, scale * torques, logged(xml, torques), command_kind="torque")
    if not said:
        health(case)
        return
    with pytest.raises(GapError, match=said) as caught:
        health(case)
    assert ("share of the largest torque" if scale < 1 else '"command": "N cm"') in str(caught.value)


def test_a_wheel_that_the_log_too_has_fast_does_not_run_away() -> None:
    run = Run("a", np.arange(101) / 100, np.zeros((101, 1)), {"joint_pos": 2.0 * np.arange(101.0)[:, None]})
    track = {"vel": np.full((500, 1), 200.0), "settle": (0.0, 0.002)}
    assert _runaway(run, track, 500) is None
    assert _runaway(replace(run, signals={"joint_pos": np.zeros((101, 1))}), track, 500) == 0
