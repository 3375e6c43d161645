"""The choice: what separates is preferred, what is the same is said to be, what leaves the limits is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.errors import GapError, UnknownNameError
from realsim.gap import load_case
from realsim.gap.experiments.choose import look
from realsim.gap.experiments.excitations import EXCITATIONS
from realsim.gap.experiments.limits import Limits, limits_of
from realsim.gap.experiments.proposal import described, with_text
from realsim.gap.experiments.separation import Bench, expected_posterior, separations
from realsim.gap.simulation.simulate import Simulator

from .conftest import SETTINGS

DAMPER = ("viscous_friction", ("swing",))
SERVO = ("damping_gain", ("swing",))


def test_other_gains_tell_a_damper_from_the_servo_and_plain_motion_does_not(bench: Bench, made_rival) -> None:
    """kd is 1: viscous friction of 0.5 brakes like a gain of 1.5 on it, until kd is another."""
    rivals = [made_rival(*DAMPER, damping=0.5), made_rival(*SERVO, ratio=float(np.log(1.5)))]
    looked = {one.name: one for one in look(bench, rivals, ["two_gains", "multisine", "slow_triangles"])}
    assert looked["two_gains"].decides
    assert not looked["multisine"].decides
    assert looked["two_gains"].posterior > looked["multisine"].posterior
    assert next(iter(looked)) == "two_gains"


def test_late_commands_and_late_readings_stay_one_thing(bench: Bench, made_rival) -> None:
    rivals = [made_rival("command_delay", (), 1e-3, delay=0.03), made_rival("observation_delay", (), 1e-3, delay=0.03)]
    looked = look(bench, rivals, ["chirp", "torque_off"])
    assert all(one.worst == 0 for one in looked)
    asked = described(looked, rivals)
    assert asked["excitation"] is None
    assert not asked["decides"]
    assert "log others too" in asked["text"]


def test_rivals_that_are_far_apart_are_told_by_anything(bench: Bench, made_rival) -> None:
    rivals = [made_rival("payload", ("arm",), mass=0.6), made_rival("coulomb_friction", ("swing",), friction=1.5)]
    looked = look(bench, rivals, ["slow_triangles", "chirp"])
    assert all(one.decides and one.posterior > 0.99 for one in looked)


def test_deviations_and_uncertainty_only_take_away(bench: Bench, made_rival) -> None:
    sure = [
        made_rival(*DAMPER, sigma=1e-3, damping=0.3),
        made_rival("coulomb_friction", ("swing",), 1e-3, friction=0.4),
    ]
    unsure = [
        made_rival(*DAMPER, sigma=0.3, damping=0.3),
        made_rival("coulomb_friction", ("swing",), 0.3, friction=0.4),
    ]
    experiment = EXCITATIONS["multisine"](bench.rig, 0.5)
    predicted, wider = bench.predicted(experiment, sure), bench.predicted(experiment, unsure)
    alone, less = separations(predicted, sure), separations(wider, unsure)
    assert (less <= alone + 1e-6).all()
    assert (separations(predicted, sure, bench.deviations(predicted)) <= alone + 1e-6).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 400), st.integers(2, 4))
def test_the_expected_posterior_grows_from_even_odds_to_one(d: float, n: int) -> None:
    even = expected_posterior(np.zeros((n, n)))
    np.testing.assert_allclose(even, 1 / n)
    some = expected_posterior(np.full((n, n), d))
    more = expected_posterior(np.full((n, n), 2 * d + 1))
    assert (some >= 1 / n - 0.02).all()
    assert (more >= some - 0.02).all()
    assert (expected_posterior(np.full((n, n), 400.0)) > 0.999).all()


def test_what_leaves_the_limits_at_every_size_is_refused(bench: Bench, made_rival) -> None:
    rivals = [made_rival(*DAMPER, damping=0.5), made_rival("payload", ("arm",), mass=0.3)]
    here = bench.limits
    tight = Limits(here.low, here.high, 0.01 * here.speed, here.torque, here.names)
    held = Bench(bench.rig, bench.noise, tight, bench.config)
    (one,) = look(held, rivals, ["chirp"])
    assert "speed" in one.refused
    assert one.predicted is None
    assert described([one], rivals)["excitation"] is None


def test_a_limit_that_only_a_rival_leaves_counts(bench: Bench, made_rival) -> None:
    """A motor a third as strong falls far behind its command; a payload of 2 kg needs a torque beyond the limit."""
    experiment = EXCITATIONS["slow_triangles"](bench.rig, 1.0)
    light, heavy = made_rival("payload", ("arm",), mass=0.05), made_rival("payload", ("arm",), mass=3.0)
    here = bench.limits
    low = Limits(here.low, here.high, here.speed, np.full_like(here.torque, 9.0), here.names)
    held = Bench(bench.rig, bench.noise, low, bench.config)
    assert not isinstance(held.predicted(experiment, [light, light]), str)
    assert "torque" in str(held.predicted(experiment, [light, heavy]))


def test_one_rival_and_unknown_names_are_refused(bench: Bench, made_rival) -> None:
    with pytest.raises(GapError, match="nothing to tell apart"):
        look(bench, [made_rival(*DAMPER, damping=0.5)])
    with pytest.raises(UnknownNameError):
        look(bench, [made_rival(*DAMPER, damping=0.5)] * 2, ["chrip"])


def test_a_base_that_tilts_or_sinks_is_out_of_balance() -> None:
    free = np.full(1, 1e9)
    limits = Limits(-free, free, free, free, ("a",))
    still = {"pos": np.zeros((3, 1)), "vel": np.zeros((3, 1)), "torque": np.zeros((3, 1))}
    upright, tilted = np.tile([1.0, 0, 0, 0], (3, 1)), np.tile([1.0, 0, 0, 0], (3, 1))
    tilted[2] = [np.cos(0.4), 0, np.sin(0.4), 0]
    at = np.tile([0, 0, 0.3], (3, 1))
    assert limits.broken({**still, "base_pos": at, "base_quat": upright}) == ""
    assert "tilts" in limits.broken({**still, "base_pos": at, "base_quat": tilted})
    assert "sinks" in limits.broken({**still, "base_pos": at * [[1], [1], [0.5]], "base_quat": upright})
    assert "fails" in limits.broken({**still, "pos": np.full((3, 1), np.nan)})


def test_the_advice_is_the_experiment() -> None:
    advice = "to tell them apart, record fast steps"
    assert with_text(advice, None) == advice
    asked = {"text": "a chirp", "excitation": "chirp"}
    assert with_text(advice, asked) == "to tell them apart, record a chirp (realsim excite)"
    nothing = {"text": "no excitation of the library tells these apart", "excitation": None}
    assert with_text(advice, nothing) == nothing["text"]
    assert with_text("No gap.", asked) == "No gap."


def test_limits_are_those_of_the_whole_log_the_run_held_out_too(pendulum: Path) -> None:
    case = load_case(pendulum)
    with Simulator(case, SETTINGS) as simulator:
        whole = limits_of(simulator.context)
    less = []
    for known in range(len(case.runs)):
        with Simulator(case, SETTINGS, [known]) as simulator:
            found = limits_of(simulator.context_of_all_runs())
            assert np.array_equal(found.speed, whole.speed)
            assert np.array_equal(found.torque, whole.torque)
            less.append(limits_of(simulator.context).speed < whole.speed)
    assert np.any(less)
