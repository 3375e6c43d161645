"""The benchmark that closes the loop: its logs are a case, its steps resume, and its rows say what was regained."""

import argparse
import runpy
from pathlib import Path

import numpy as np
import pytest

from realsim.gap import load_case
from trainer.robots import ROBOTS

LOOP = runpy.run_path(str(Path(__file__).resolve().parents[2] / "benchmarks" / "training" / "closed_loop.py"))


@pytest.mark.parametrize(("name", "late"), [("payload", 0.0), ("motors", 0.0), ("delay", 0.05)])
def test_the_robot_is_logged_as_it_is_and_its_model_as_it_is_believed(name: str, late: float, tmp_path: Path) -> None:
    real = LOOP["REAL"]["quadruped"][name]
    LOOP["write_log"](real, "quadruped", tmp_path)
    case = load_case(tmp_path)
    nominal = ROBOTS["quadruped"]().robot.spec.copy().compile()
    assert case.model.body_subtreemass[1] == pytest.approx(nominal.body_subtreemass[1])
    assert case.model.actuator_gainprm[:, 0] == pytest.approx(nominal.actuator_gainprm[:, 0])
    run = case.runs[0]
    assert run.duration == pytest.approx(LOOP["SECONDS"], abs=0.02)
    assert run.signals["base_pos"][:, 2].min() > 0.2  # it stands
    moved, still = run.command[100:, 1], run.signals["joint_pos"][:20, 1]
    assert np.ptp(moved) > 0.05
    assert np.ptp(still) < 0.01
    assert real.delay == late


def test_g1_is_logged_as_it_hangs_and_its_model_knows_nothing_of_weak_motors(tmp_path: Path) -> None:
    LOOP["write_log"](LOOP["REAL"]["g1"]["motors"], "g1", tmp_path)
    case = load_case(tmp_path)
    nominal, run = ROBOTS["g1"](), case.runs[0]
    gains = nominal.robot.spec.copy().compile().actuator_gainprm[:, 0]
    assert case.model.actuator_gainprm[:, 0] == pytest.approx(gains, rel=1e-4)
    assert case.model.nq == len(nominal.joints)  # it hangs by its pelvis
    assert (np.ptp(run.command, axis=0) > 0.03).all()
    assert ((nominal.lower < run.command) & (run.command < nominal.upper)).all()
    assert np.ptp(run.signals["joint_pos"][:20], axis=0).max() < 0.02  # it begins at rest


def test_a_step_is_done_once_and_none_begins_when_the_time_is_over(tmp_path: Path) -> None:
    args = argparse.Namespace(minutes=1.0)
    loop = LOOP["Loop"](tmp_path, args)
    assert loop.step("a", "", lambda: {"rate": 0.5})["rate"] == 0.5
    again = LOOP["Loop"](tmp_path, argparse.Namespace(minutes=0.0))
    assert again.step("a", "", lambda: pytest.fail("done already"))["rate"] == 0.5
    with pytest.raises(TimeoutError):
        again.step("b", "", lambda: pytest.fail("the time is over"))
    with pytest.raises(TimeoutError):
        loop.step("b", "", lambda: False)  # a training that did not come to its end is not done
    assert "b" not in LOOP["Loop"](tmp_path, args).results


def test_the_rows_say_what_was_regained() -> None:
    def result(rate: float, speed: float) -> dict[str, object]:
        row = {"what": "is late", "rate": rate, "interval": (rate - 0.05, rate + 0.05), "speed": speed, "trials": 100}
        return row | {"reasons": {}, "seconds": 1.0, "covered": 1.0, "cpu_seconds": 1.0}

    found = {"verdict": "identified", "causes": ["command_delay: delay 0.05 s"], "cpu_seconds": 1.0}
    results = {"options": {"iterations": 60, "course": "flat"}, "nominal": result(0.9, 0.5),
               "delay/before": result(0.1, 0.3), "delay/diagnosis": found, "delay/patch": result(0.8, 0.4),
               "delay/random": result(0.3, 0.2), "motors/before": result(0.9, 0.5)}  # fmt: skip
    (row,) = LOOP["rows"](results)  # of the other robot not all is done
    assert row["regained_patch"] == {"rate": pytest.approx(0.875), "speed": pytest.approx(0.5)}
    assert row["regained_random"] == {"rate": pytest.approx(0.25), "speed": pytest.approx(-0.5)}
