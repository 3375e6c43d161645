"""One log and one policy: every part is answered, or says why it could not be."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import diagnose, load_case
from realsim.gap.answer.horizons import only_in_long_replays
from realsim.gap.config import DiagnoseConfig
from realsim.gap.doctor import run_doctor
from tests.gap.checks.contract.test_contract import JOINTS, onnx_policy

from .truth import Truth


def test_parts_that_a_log_does_not_support_say_so(made, tmp_path: Path) -> None:
    six = ",".join(["0.5"] * 6)
    numbers = ("default_joint_pos", "action_scale", "joint_stiffness", "joint_damping")
    meta = {"joint_names": ",".join(JOINTS), "observation_names": "joint_pos"} | dict.fromkeys(numbers, six)
    policy = onnx_policy(tmp_path / "policy.onnx", 6, meta)
    config = DiagnoseConfig(effects=("payload",), max_causes=1, max_seconds=1.0, max_runs=2, threads=1)
    case = made(Truth())
    found = run_doctor(case, tmp_path / "out", lambda *_: None, policy=policy, config=config)
    parts = {p["name"]: p for p in found["parts"]}
    assert list(parts) == ["contract", "delay", "physics", "camera", "terrain"]
    assert [n for n, p in parts.items() if p["checked"]] == ["delay", "physics"]
    assert all(p["finding"] for p in found["parts"])
    assert json.loads((tmp_path / "out" / "doctor.json").read_text()) == json.loads(json.dumps(found))
    page = (tmp_path / "out" / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    (tmp_path / "bad.onnx").write_bytes(b"no network")
    with pytest.raises(GapError, match="not a readable"):
        run_doctor(case, tmp_path / "other", lambda *_: None, policy=tmp_path / "bad.onnx")
    assert not (tmp_path / "other").exists()


TUMBLER = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="20 20 1"/>
    <body name="trunk" pos="0 0 0.6">
      <freejoint/>
      <geom type="box" size="0.2 0.12 0.06" mass="4"/>
      <body name="leg" pos="0.2 0 0">
        <joint name="hip" axis="0 1 0" damping="0.05" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.03" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="hip_servo" joint="hip" kp="15" kv="0.5"/></actuator>
</mujoco>"""


def write_tumble(folder: Path) -> Path:
    """A robot that is its model to the last digit, thrown: it bounces and rolls."""
    model, rng = mujoco.MjModel.from_xml_string(TUMBLER), np.random.default_rng(0)
    (folder / "runs").mkdir(parents=True)
    (folder / "model.xml").write_text(TUMBLER)
    log = {"joint_names": ["hip"], "actuator_names": ["hip_servo"], "command_kind": "position", "base": "floating",
           "torque_kind": "none", "imu_site": None, "contact_bodies": []}  # fmt: skip
    (folder / "log.json").write_text(json.dumps(log))
    time = 0.008 * np.arange(500)
    for number in range(3):
        data = mujoco.MjData(model)
        data.qvel[:6] = rng.normal(0, [1, 1, 0.5, 4, 6, 4])
        rows, first = [], (data.qpos.copy(), data.qvel.copy())
        command = np.sin(2 * np.pi * rng.uniform(0.8, 1.5) * time)
        for value in command:
            rows.append(np.concatenate([data.qpos, data.qvel]))
            data.ctrl[0] = value
            mujoco.mj_step(model, data, 2)
        seen = np.array(rows) + rng.normal(0, 5e-4, (len(rows), 15))
        np.savez(folder / "runs" / f"run_{number}.npz", time=time, command=command[:, None], joint_pos=seen[:, 7:8],
                 joint_vel=seen[:, 14:15], base_pos=seen[:, :3], base_quat=seen[:, 3:7],
                 init_qpos=first[0], init_qvel=first[1])  # fmt: skip
    return folder


def test_a_tumble_of_a_robot_that_is_its_model_is_no_bad_physics(tmp_path: Path) -> None:
    config = DiagnoseConfig(effects=("payload",), max_causes=1, max_runs=3, threads=1)
    found = diagnose(load_case(write_tumble(tmp_path / "case")), config)
    print(found.verdict, found.sentence, only_in_long_replays(found.evidence))
    assert found.verdict == "no_gap" or only_in_long_replays(found.evidence)


def test_a_replay_that_follows_is_believed(made) -> None:
    config = DiagnoseConfig(effects=("payload",), max_causes=1, max_runs=3, threads=1)
    found = diagnose(load_case(made(Truth(coulomb={"shoulder": 0.5}))), config)
    assert only_in_long_replays(found.evidence) is False
