"""`realsim diagnose --policy --check`: the policy's answer alone, on a case in files."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.cli.command_line import main
from tests.gap.truth import ARM
from tests.truths.written import write_case

from .test_contract import onnx_policy

SCALE, DEFAULT = 0.25, np.array([0.3, -0.4])
WEIGHTS = np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32)


def write_policy(path: Path) -> Path:
    meta = {"joint_names": "shoulder,elbow", "observation_names": "base_ang_vel", "action_scale": str(SCALE),
            "default_joint_pos": "0.3,-0.4", "joint_stiffness": "150,60", "joint_damping": "8,2.6"}  # fmt: skip
    return onnx_policy(path, 3, meta, WEIGHTS)


def answering(folder: Path, sent: float) -> Path:
    """An arm whose policy answers a gyroscope; `sent` is the share of its actions that reaches the motors."""
    model = mujoco.MjModel.from_xml_string(ARM)
    rng, every, runs = np.random.default_rng(1), 5, {}
    for name in ("a", "b", "c"):
        time = 0.02 * np.arange(150)
        rate, phase = rng.uniform(1, 6, (2, 1, 3))
        gyro = np.clip(time[:, None] - 0.3, 0, 1) * np.sin(rate * time[:, None] + phase)
        command = DEFAULT + SCALE * sent * (gyro @ WEIGHTS)
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = command[0], command[0]
        for _ in range(500):
            mujoco.mj_step(model, data)
        pos, vel = [], []
        for target in command:
            pos.append(data.qpos.copy())
            vel.append(data.qvel.copy())
            data.ctrl[:] = target
            mujoco.mj_step(model, data, every)
        level = np.tile([1.0, 0, 0, 0], (len(time), 1))
        runs[name] = {"time": time, "command": command, "joint_pos": pos, "joint_vel": vel, "imu_gyro": gyro}
        runs[name] |= {"base_quat": level}
    return write_case(folder, ARM, runs)


@pytest.mark.parametrize(("sent", "verdict"), [(1.0, "kept"), (0.5, "broken")])
def test_the_policy_alone_is_checked_and_nothing_written(
    sent: float, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case, policy = answering(tmp_path / "case", sent), write_policy(tmp_path / "policy.onnx")
    monkeypatch.chdir(tmp_path)
    line = ["diagnose", str(case), "--policy", str(policy), "--check"]
    assert main([*line, "--json"]) == 0, capsys.readouterr().out
    found = json.loads(capsys.readouterr().out)
    assert found["contract"]["verdict"] == verdict
    assert len(found["runs"]) == 3
    assert main(line) == 0
    text = capsys.readouterr().out
    assert text.startswith(found["contract"]["sentence"])
    assert ("change  scale of JointPositionActionCfg" in text) == (verdict == "broken")
    assert {p.name for p in tmp_path.iterdir()} == {"case", "policy.onnx"}


def test_what_the_log_lacks_has_the_reason_that_was_found_when_it_was_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case, policy = answering(tmp_path / "case", 1.0), write_policy(tmp_path / "policy.onnx")
    for file in (case / "runs").glob("*.npz"):
        np.savez(file, **{name: values for name, values in np.load(file).items() if name != "joint_vel"})
    line = ["diagnose", str(case), "--policy", str(policy), "--check", "--json"]
    assert main(line) == 2
    assert json.loads(capsys.readouterr().out)["found"] is None
    why = "joint_vel: velocities (dq is no velocity of the joints)"
    (case / "proposal.json").write_text(json.dumps({"missing": ["joint_torque: torques", why]}))
    assert main(line) == 2
    assert json.loads(capsys.readouterr().out)["found"].startswith(why)


def test_what_is_no_exported_policy_says_what_to_give(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = answering(tmp_path / "case", 1.0)
    (tmp_path / "policy.pt").write_bytes(b"PK\x03\x04")
    (tmp_path / "robot.xml").write_text(ARM)
    for name, hint in (("policy.pt", "policy.onnx"), ("robot.xml", "robot.xml"),
                       ("none.onnx", "check the path")):  # fmt: skip
        assert main(["diagnose", str(case), "--policy", str(tmp_path / name), "--check", "--json"]) == 2
        assert hint in json.loads(capsys.readouterr().out)["hint"]
