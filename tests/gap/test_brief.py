"""A diagnosis in a dozen lines: cause, size, evidence, what to do."""

from pathlib import Path
from typing import Any

import pytest

from realsim.cli.commands.diagnose import _summary
from realsim.gap import DiagnoseConfig
from realsim.gap.answer.brief import brief
from realsim.gap.verdicts import WORDINGS, GapVerdict

JOINTS = [f"joint_{i}" for i in range(6)]


def cause(joint: str) -> dict[str, Any]:
    value = {"value": 1.9, "unit": "N m", "ci90": [1.6, 2.2]}
    return {"effect": "coulomb_friction", "joints": [joint], "parameters": {"friction": value}, "probability": None}


def data(verdict: str, causes: int, others: int = 0) -> dict[str, Any]:
    """As much as a diagnosis of a walking robot can say."""
    signals = ("joint_pos", "joint_vel", "joint_torque", "base_pos", "imu_gyro")
    row = {"unit": "rad", "motion": 0.41, "rms_before": 0.051, "rms_after": 0.014, "floor": 0.002}
    where = [{"signal": "joint_pos", "joint": j, "phase": "reversal", "share": 0.1} for j in JOINTS]
    return {
        "verdict": verdict,
        "sentence": "Your model lacks friction.",
        "causes": [cause(j) for j in JOINTS[:causes]],
        "equivalent": [[cause(j)] for j in JOINTS[:others]],
        "where": where,
        "shrinkage": {"fraction": 0.83, "ci90": [0.74, 0.88], "runs": ["run_05"], "unseen": True, "kind": "validation",
                      "per_signal": dict.fromkeys(signals, row)},
        "looks_like": [{"joint": j, "what": "friction-like", "explains": 0.6} for j in JOINTS],
        "advice": "record one run twice",
        "statistics": {"reasons": ["before and after", "15 times the floor stays"], "cut_short": False},
        "health": {"warnings": [f"warning {i}" for i in range(20)]},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "causes", "others"),
    [
        ("no_gap", 0, 0),
        ("identified", 3, 0),
        ("ambiguous", 3, 3),
        ("partly_explained", 3, 0),
        ("unexplained", 0, 0),
        ("unexplained", 3, 0),
    ],
)
def test_the_terminal_shows_a_dozen_lines_at_most(verdict: str, causes: int, others: int) -> None:
    text = _summary(data(verdict, causes, others), Path("out"), DiagnoseConfig())
    lines = text.splitlines()
    assert len(lines) <= 1 + 12
    assert lines[0].startswith(WORDINGS[GapVerdict(verdict)].word)
    assert ("Your model lacks friction." in lines[0]) == (verdict == "identified")
    assert "out/model.xml" in lines[-1]
    assert "record one run twice" in text


def test_the_terminal_says_first_that_a_search_was_cut_short() -> None:
    found = data("partly_explained", 1)
    found["statistics"] |= {"cut_short": True}
    assert "cut short" in _summary(found, Path("out"), DiagnoseConfig()).splitlines()[0]


def test_size_is_in_the_signal_s_unit_beside_the_motion() -> None:
    rows = [text for _, text in brief(data("partly_explained", 1))["size"]]
    assert rows[0] == "83 % of the squared error goes, 90 % interval 74 % to 88 %, on run_05 (held out)"
    assert rows[1] == "joint position off by 51 mrad rms, now 14 mrad; the motion is 0.41 rad rms"
    before = [text for _, text in brief(data("unexplained", 0))["size"]]
    assert before[0] == "joint position off by 51 mrad rms; the motion is 0.41 rad rms"


def test_what_holds_beside_everyday_deviations_only_is_said_so() -> None:
    found = data("identified", 1)
    found["shrinkage"] |= {"beside_deviations": [0.41, 0.47]}
    assert ("", "of what everyday deviations leave there, 41 % to 47 % goes") in brief(found)["size"]


def test_no_gap_has_no_size() -> None:
    assert brief(data("no_gap", 0))["size"] == []


@pytest.mark.parametrize(("verdict", "said"), [("no_gap", "robots of one kind differ"), ("unexplained", "not explain")])
def test_why_the_nearest_cause_is_no_finding(verdict: str, said: str) -> None:
    ((label, text),) = brief(data(verdict, 0) | {"lead": cause("joint_0")})["cause"]
    assert label == "nearest"
    assert said in text
