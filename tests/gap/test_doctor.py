"""One log and one policy: every part is answered, or says why it could not be."""

import json
from pathlib import Path

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


def test_a_replay_that_follows_is_believed(made) -> None:
    config = DiagnoseConfig(effects=("payload",), max_causes=1, max_runs=3, threads=1)
    found = diagnose(load_case(made(Truth(coulomb={"shoulder": 0.5}))), config)
    assert only_in_long_replays(found.evidence) is False
