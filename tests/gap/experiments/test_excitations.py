"""Every excitation of the library stays in the commands' range, begins at rest, and lasts as long as the others."""

from dataclasses import replace

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import load_case
from realsim.gap.case.model.context import build_context
from realsim.gap.experiments.excitations import EXCITATIONS
from realsim.gap.experiments.plan import planned_case, rig_of
from realsim.gap.experiments.separation import Bench

FIXED = [n for n in EXCITATIONS if n not in ("push_and_slide", "step_elsewhere")]


@pytest.mark.parametrize("name", FIXED)
@pytest.mark.parametrize("size", [1.0, 0.3])
def test_it_stays_in_range_and_begins_and_ends_at_home(bench: Bench, name: str, size: float) -> None:
    rig = bench.rig
    made = EXCITATIONS[name](rig, size)
    assert made.name == name
    assert made.seconds == pytest.approx(2 * rig.seconds, rel=0.02)
    for run in made.runs:
        assert run.command.shape == (len(run.time), len(rig.home))
        np.testing.assert_allclose(np.diff(run.time), 1 / rig.rate)
        assert (run.command >= rig.home - size * (rig.home - rig.low) - 1e-9).all()
        assert (run.command <= rig.home + size * (rig.high - rig.home) + 1e-9).all()
        np.testing.assert_allclose(run.command[[0, -1]], [rig.home, rig.home], atol=1e-9)
        assert np.ptp(run.command) > 0.2 * size * np.min(rig.high - rig.low)


@pytest.mark.parametrize("name", list(EXCITATIONS))
def test_it_is_the_same_each_time(bench: Bench, name: str) -> None:
    first, again = (EXCITATIONS[name](bench.rig, 0.5) for _ in range(2))
    assert (first is None) == (again is None) == (name not in FIXED)
    for a, b in zip(first.runs if first else (), again.runs if again else (), strict=True):
        np.testing.assert_array_equal(a.command, b.command)


def test_what_must_be_set_up_is_said(bench: Bench) -> None:
    gains, mass, drop = (EXCITATIONS[n](bench.rig, 1.0) for n in ("two_gains", "known_mass", "torque_off"))
    assert {g for run in gains.runs for g in run.setup.gains} >= {
        ("swing_servo", "kp", 15.0),
        ("swing_servo", "kd", 2.0),
    }
    assert all(f"{run.setup.payload[0][1]:g} kg" in mass.instructions[0] for run in mass.runs)
    assert all((~run.enabled).any() and run.enabled[0].all() for run in drop.runs)


def test_runs_begin_where_the_first_command_is(bench: Bench) -> None:
    made = EXCITATIONS["multisine"](bench.rig, 1.0)
    case = planned_case(bench.rig, made.runs)
    assert [r.name for r in case.runs] == [r.name for r in made.runs]
    for run in case.runs:
        np.testing.assert_allclose(run.signals["joint_pos"][:, 0], bench.rig.home[0])


def test_a_log_at_ten_hertz_is_refused(pendulum) -> None:
    case = load_case(pendulum)
    slow = case.with_runs(tuple(run.where(slice(None, None, 12)) for run in case.runs))
    with pytest.raises(GapError, match="too slow") as error:
        rig_of(replace(build_context(case), case=slow), 4.0)
    assert "20 samples a second" in str(error.value.expected)
