"""The withheld check is kept apart from the diagnosis, follows the contract, and scores what it should."""

import ast
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.diagnosis.pool import Job, read
from benchmarks.diagnosis.score import MixedEnginesError, score
from benchmarks.diagnosis.withheld import KEPT, keep
from tests.truths.diagnosis.cases import STRATA, VISIBLE, Draw, Sensors, make_case, plan, same_log, site_of
from tests.truths.diagnosis.motions import sample_times
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth

ROOT = Path(__file__).resolve().parents[2]


def test_the_truth_knows_nothing_of_the_diagnosis_nor_the_other_way_round() -> None:
    for path in sorted((ROOT / "tests" / "truths" / "diagnosis").glob("*.py")):
        assert "realsim.gap" not in "".join(
            ast.unparse(n) for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Import | ast.ImportFrom)
        )
    for path in sorted((ROOT / "realsim").rglob("*.py")):
        assert "tests.truths" not in path.read_text(), path


def test_a_plan_is_fair_and_reproducible() -> None:
    rows = plan(200, 1)
    assert rows == plan(200, 1)
    assert len(rows) == 200
    for stratum, share in STRATA.items():
        assert sum(d.stratum == stratum for d in rows) == pytest.approx(200 * share, abs=2)
    assert len({d.robot for d in rows}) >= 4


def test_a_case_follows_the_contract_and_hides_its_label(tmp_path: Path) -> None:
    label = make_case(Draw("single", "pendulum", 7, 0), tmp_path / "case", runs=3)
    assert label["visibility"][0] >= VISIBLE
    log = json.loads((tmp_path / "case" / "log.json").read_text())
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "case" / "model.xml"))
    assert [model.joint(n).name for n in log["joint_names"]] == ["axis"]
    runs = sorted((tmp_path / "case" / "runs").glob("*.npz"))
    assert len(runs) == 3
    for file in runs:
        with np.load(file, allow_pickle=False) as run:
            assert (np.diff(run["time"]) > 0).all()
            assert run["command"].shape == run["joint_pos"].shape == (len(run["time"]), 1)
    effect = label["effects"][0]["effect"]
    assert not any(effect in f.read_text(errors="ignore") for f in (tmp_path / "case").glob("*.*"))


def test_the_plant_without_deviations_follows_its_model() -> None:
    """The neutral truth and the nominal model differ by discretisation only."""
    robot = ROBOTS["pendulum"](np.random.default_rng(3))
    times = sample_times(np.random.default_rng(0), 200.0, 2.0)
    command = 0.4 * np.sin(2 * np.pi * 0.5 * (times - times[0]))[:, None]
    trace = Plant(robot, Truth(1)).drive(times, command)
    model = mujoco.MjModel.from_xml_string(robot.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = trace.qpos0
    out = []
    for _ in range(int(1.9 / model.opt.timestep)):
        data.ctrl[:] = command[max(np.searchsorted(times, times[0] + data.time + 1e-9, side="right") - 1, 0)]
        mujoco.mj_step(model, data)
        out.append(np.interp(times[0] + data.time, trace.time, trace.q[:, 0]) - data.qpos[0])
    assert np.abs(out).max() < 0.004


def cause(effect: str, value: float, joint: str = "axis") -> dict:
    return {
        "effect": effect,
        "joints": [joint],
        "bodies": None,
        "parameters": [{"name": "friction", "value": value, "unit": "N m"}],
    }


def test_score_of_hand_made_diagnoses() -> None:
    base = {"robot": "pendulum", "strength": [0.6], "visibility": [4.0], "equivalents": []}
    labels = {
        "a": base | {"cls": "single", "effects": [cause("coulomb_friction", 1.0)]},
        "b": base | {"cls": "single", "effects": [cause("coulomb_friction", 1.0)]},
        "c": base | {"cls": "none", "effects": []},
        "d": base | {"cls": "outside", "effects": [cause("cogging", 1.0)]},
    }

    def said(verdict: str, *causes: dict, share: float = 0.1) -> dict:
        return {"verdict": verdict, "causes": list(causes), "equivalent": [], "unexplained_share": share}

    right = {
        "effect": "coulomb_friction",
        "joints": ["axis"],
        "parameters": {"friction": {"value": 1.2, "unit": "N m", "ci90": [0.9, 1.5]}},
    }
    found = {
        "a": said("identified", right),
        "b": said("identified", right | {"joints": ["elbow"]}),
        "c": said("identified", right),
        "d": said("unexplained", share=0.8),
    }
    figures = score(labels, found)
    assert figures["single_top1"] == [1, 2]
    assert figures["false_alarms"] == [1, 1]
    assert figures["outside_said"] == [1, 1]
    assert figures["parameter_error_median"] == pytest.approx(0.2)
    assert figures["ci90_holds_truth"] == [1, 1]


def test_diagnoses_of_several_engines_are_not_pooled() -> None:
    said = {"verdict": "no_gap", "causes": [], "equivalent": []}
    label = {"cls": "none", "robot": "arm2", "effects": [], "equivalents": [], "visibility": []}
    one, other = {"engine": "aaa", "settings": {"seed": 0}}, {"engine": "bbb", "settings": {"seed": 0}}
    labels = {"case_000": label, "case_001": label}
    assert score(labels, {n: said | {"provenance": one} for n in labels})["provenance"] == one
    for second in (other, {"engine": "aaa", "settings": {"seed": 1}}, None):
        found = {"case_000": said | {"provenance": one}, "case_001": said | {"provenance": second}}
        with pytest.raises(MixedEnginesError, match="case_001"):
            score(labels, found)


def test_a_case_that_is_refused_counts_as_one_without_an_answer(tmp_path: Path) -> None:
    refused = {"verdict": "refused", "causes": [], "equivalent": []}
    (tmp_path / "refused.json").write_text(json.dumps(refused))
    found = {"case_000": read(Job(tmp_path / "case", tmp_path))}
    assert read(Job(tmp_path / "case", tmp_path / "nowhere")) is None
    label = {"cls": "single", "robot": "arm2", "effects": [{"effect": "armature", "joints": ["a"], "parameters": []}]}
    figures = score({"case_000": label | {"equivalents": [], "visibility": [5.0]}}, found)
    assert figures["single_top1"] == [0, 1]
    assert figures["missed_gaps"] == [0, 1]


def test_two_causes_are_alike_only_if_every_run_is() -> None:
    """More friction and more braking are one motion until the drive saturates: one run in which it does tells them."""
    robot = ROBOTS["pendulum"](np.random.default_rng(3))
    site = site_of(robot, mujoco.MjModel.from_xml_string(robot.xml), 1)
    sensors = Sensors(100.0, True, "none", 1.0, False, 2e-4, 16)
    gain = -float(site.model.actuator(robot.actuators[0]).biasprm[2])
    greased = Truth(len(robot.joints))
    greased.viscous[0] += 0.5 * gain
    value = {"name": "ratio", "value": 1.5, "unit": "1"}
    label = [{"effect": "damping_gain", "joints": [robot.joints[0]], "bodies": None, "parameters": [value]}]
    times = np.arange(0.0, 2.0, 0.01)
    calm = (times, robot.home + 0.2 * np.sin(3 * times)[:, None])
    wild = (times, robot.home + 1.5 * np.sign(np.sin(6 * times))[:, None])
    truths = [Truth(len(robot.joints)), greased]
    assert same_log(label, robot, sensors, site, truths, [calm])
    assert not same_log(label, robot, sensors, site, truths, [calm, calm, wild])


def test_kept_cases_replace_those_of_their_engine_alone(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    old = [{"seed": 5, "case": "case_000", "commit": "old"}, {"seed": 4, "case": "case_000", "commit": "old"}]
    path.write_text(json.dumps({"days": [], "sets": [{"seed": 5, "commit": "old"}], "rows": old}))
    causes = [{"effect": "armature", "joints": ["a", "b"], "bodies": []}]
    true = causes[0] | {"parameters": [{"name": "armature", "value": 0.02, "unit": "kg m^2"}]}
    given = causes[0] | {"parameters": {"armature": {"value": 0.021, "unit": "kg m^2", "ci90": [0.019, 0.023]}}}
    label = {"cls": "single", "robot": "arm2", "effects": [true], "visibility": [np.float64(2.345)]}
    found = {"verdict": "identified", "causes": [given], "equivalent": []}
    figures = dict.fromkeys(KEPT) | {"run": {"commit": "c", "cpu": "x", "cores": 2}}
    keep("abc", 5, {"case_000": label}, {"case_000": found}, figures, path)
    stored = json.loads(path.read_text())
    assert [(r["seed"], r["commit"]) for r in stored["rows"]] == [(5, "old"), (4, "old"), (5, "abc")]
    assert [s["commit"] for s in stored["sets"]] == ["old", "abc"]
    row = stored["rows"][-1]
    assert (row["truth"], row["causes"], row["commit"]) == (["armature@a+b"], ["armature@a+b"], "abc")
    assert row["visibility"] == [2.3]
    assert row["held"] == [True]
    assert row["look_alikes_named"] is None
    keep("def", 5, {"case_009": label}, {"case_009": found}, figures, path)
    stored = json.loads(path.read_text())
    assert [r["commit"] for r in stored["rows"]] == ["old", "old", "abc", "def"]
    keep("def", 5, {"case_009": label}, {"case_009": found}, figures, path)
    stored = json.loads(path.read_text())
    assert [r["commit"] for r in stored["rows"]] == ["old", "old", "abc", "def"]
    assert [s["commit"] for s in stored["sets"]] == ["old", "abc", "def"]
