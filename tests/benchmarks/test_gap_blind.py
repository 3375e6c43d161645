"""Answers for withheld logs: compact, and of one engine."""

import json
from pathlib import Path

import pytest

from benchmarks.diagnosis import blind as gap_blind
from benchmarks.diagnosis.pool import Job

PENDULUM = """
<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
<actuator><position joint="a"/></actuator></mujoco>"""
ANSWER = {
    "verdict": "identified",
    "causes": [
        {
            "effect": "armature", "joints": ["a"], "probability": None,
            "parameters": {"armature": {"value": 0.123456789, "unit": "kg m^2", "ci90": [0.1, 0.15]}},
        }
    ],
    "equivalent": [], "unexplained_share": 0.01, "cpu_seconds": 3.14159,
    "shrinkage": {"fraction": 0.9, "ci90": [0.8, 0.95], "runs": ["run_5"], "unseen": True, "per_signal": {}},
    "provenance": {"engine": "e1", "settings": {}},
}  # fmt: skip


def job(folder: Path, name: str, answer: dict[str, object] | None) -> Job:
    found = Job(folder / "cases" / name, folder / "out" / name)
    found.case.mkdir(parents=True)
    (found.case / "model.xml").write_text(PENDULUM)
    if answer is not None:
        found.out.mkdir(parents=True)
        (found.out / "diagnosis.json").write_text(json.dumps(answer))
    return found


def test_answers_are_stored_compactly_and_missing_ones_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(gap_blind, "STORE", tmp_path / "rows.json")
    jobs = [job(tmp_path, "case_001", ANSWER), job(tmp_path, "case_002", None)]
    assert gap_blind.store(jobs, "abc") == 0
    stored = json.loads((tmp_path / "rows.json").read_text())
    (row,) = stored["rows"]
    assert (row["robot"], row["commit"], stored["engine"]) == ("pendulum", "abc", "e1")
    assert row["causes"][0]["parameters"]["armature"]["value"] == 0.123457
    assert stored["not_answered"] == ["case_002"]
    assert "| pendulum | 1 | 1 identified | 3, 3 |" in capsys.readouterr().out


def test_answers_of_two_engines_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gap_blind, "STORE", tmp_path / "rows.json")
    other = ANSWER | {"provenance": {"engine": "e2", "settings": {}}}
    assert gap_blind.store([job(tmp_path, "case_001", ANSWER), job(tmp_path, "case_002", other)], None) == 2
    assert not (tmp_path / "rows.json").exists()
