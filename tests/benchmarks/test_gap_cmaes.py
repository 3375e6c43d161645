"""The peer that fits all joints at once by CMA-ES: its parameters, its fit, its sums."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis.cmaes import DELAY, OF_JOINTS, all_knobs, fit
from benchmarks.diagnosis.sysid import summary
from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator
from tests.gap.truth import PENDULUM, Truth, make_case


def test_a_rotor_is_found_among_all_parameters_of_a_joint(tmp_path: Path) -> None:
    pytest.importorskip("cma")
    make_case(tmp_path / "case", PENDULUM, Truth(armature={"swing": 0.08}), runs=2, seed=3, span=(1.5, 2.0))
    case = load_case(tmp_path / "case")
    config = DiagnoseConfig(threads=1)
    with Simulator(case, config) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), config)
        knobs = all_knobs(simulator)
        assert [k.effect for k in knobs] == [*OF_JOINTS, DELAY]
        values, evaluations = fit(simulator, comparison, knobs, [0, 1], 250, seed=1)
    assert evaluations <= 270
    moved = np.abs(values) / [k.everyday for k in knobs]
    assert knobs[int(np.argmax(moved))].effect == "armature"
    assert values[0] == pytest.approx(0.08, rel=0.3)


def test_the_sums_are_of_all_cases_and_of_those_that_the_fit_could_name() -> None:
    def row(top1: bool, inside: bool, after: float | None) -> dict:
        side = {"top1": top1, "top1_with_equivalents": True, "after": after, "cpu_seconds": 2.0}
        return {"in_its_set": inside, "cmaes": side | {"beyond_three_units": 4}, "realsim": side}

    found = summary([row(True, True, 0.1), row(False, True, 1.5), row(False, False, None)], "cmaes")
    assert found["cmaes"]["top1"] == [1, 3]
    assert found["cmaes"]["top1_where_the_peer_has_the_cause"] == [1, 2]
    assert found["cmaes"]["worse_than_nominal_on_unseen_runs"] == [1, 2]
    assert found["cmaes"]["left_on_unseen_runs_median"] == pytest.approx(0.8)
    assert found["cmaes"]["parameters_moved_beyond_three_units_median"] == 4
