"""Rejected when absent: no effect of the library is taken for a cause where there is none, or beside the true one."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from realsim.gap import EFFECTS, Case, load_case
from realsim.gap.effects import ON_REQUEST
from realsim.gap.figures import CLEARLY
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import is_gap, leftover
from realsim.gap.inference.causes.proposals import ranked
from realsim.gap.inference.causes.select import select
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Setting

from .searching import CONFIG, fitting, logged
from .test_recovery import GROUND, UNSEEN, injected, recovered
from .truth import PENDULUM, Truth

FLOATING = (*(n for n in GROUND if n != "terrain_tilt"), "imu_bias", "thrust_gain", "tendon_gain")
"""Effects that need a ground, an IMU or rotors."""
FIXED = tuple(n for n in EFFECTS if n not in (*FLOATING, *UNSEEN, *ON_REQUEST))


def gains(screen: Screen, fit: Fit) -> dict[str, float]:
    """Effect -> the most log-evidence that it would add to a fit, at its best place."""
    found: dict[str, float] = {}
    for gain, candidate, _ in ranked(screen, fit):
        found.setdefault(candidate.effect, gain)
    return found


def perfect(case: Case, effects: Sequence[str] = ()) -> dict[str, float]:
    """Gains on the log that the nominal simulator itself writes, with a little noise; nothing must be selected."""
    with fitting(logged(case, []), effects) as fitter:
        screen = fitter.screen
        nominal = fitter.nominal()
        assert not is_gap(leftover(screen, nominal))
        assert not select(fitter, CONFIG).fit.causes
        return gains(screen, nominal)


@pytest.fixture(scope="module")
def pendulum(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(), xml=PENDULUM, runs=2, span=(2.6, 3.0)))


@pytest.fixture(scope="module")
def arm(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(), runs=2, span=(2.2, 2.6)))


@pytest.fixture(scope="module")
def without(pendulum: Case, arm: Case) -> dict[str, dict[str, float]]:
    return {"pendulum": perfect(pendulum), "arm": perfect(arm)}


@pytest.mark.parametrize("robot", ["pendulum", "arm"])
@pytest.mark.parametrize("name", FIXED)
def test_absent_on_a_perfect_log(name: str, robot: str, without: dict[str, dict[str, float]]) -> None:
    if name not in without[robot]:
        pytest.skip("no place on this robot, or not excited")
    assert without[robot][name] < CLEARLY


def test_every_fixed_effect_was_looked_for_somewhere(without: dict[str, dict[str, float]]) -> None:
    plain = {n for n in FIXED if EFFECTS[n].rivals.special_case not in FIXED}  # others come in the place of these
    assert {n for found in without.values() for n in found} == plain


@pytest.mark.parametrize("name", FIXED)
def test_the_true_cause_is_recovered_and_nothing_gets_in_beside_it(name: str, pendulum: Case, arm: Case) -> None:
    # A length shows where something hangs at its end; beside a pendulum's rod, a centre of mass does what an encoder's
    # offset does.
    cases = (arm,) if name in ("link_geometry", "com_offset") else (pendulum, arm)
    for case in cases:
        place, value = injected(name, case)
        setting: Setting = (name, place, value)
        with fitting(logged(case, [setting])) as fitter:
            true = recovered(fitter, name, place, value)
            if true is None:
                continue
            assert not is_gap(leftover(fitter.screen, true))
            rivals = {e: g for e, g in gains(fitter.screen, true).items() if e != name}
            assert len(rivals) > 5
            assert max(rivals.values()) < CLEARLY
            return
    pytest.skip("not excited by either")


@pytest.mark.slow
def test_absent_on_a_perfect_log_of_a_floating_base(settled: Case) -> None:
    case = logged(settled, [], seed=1)  # begins still nearer to the pose that the simulator itself comes to rest in
    found = perfect(case, (*FLOATING, "terrain_tilt", "external_force"))
    assert set(found) >= {"ground_friction", "terrain_height", "terrain_tilt", "imu_bias"}
    assert max(found.values()) < CLEARLY


@pytest.mark.slow
def test_the_other_friction_cone_is_no_lower_friction(quadruped: Case) -> None:
    """The same robot on MuJoCo's other cone: seen before a cause is looked for; a true cause does not turn it over."""
    logs: list[tuple[Setting, float]] = [
        (("contact_solver", (), {"cone": 1.0}), 1.0),
        (("ground_friction", (), {"ratio": -0.3}), 0.0),
        (("ground_friction", (), {"ratio": -0.6}), 0.0),
    ]
    for setting, cone in logs:
        with fitting(logged(quadruped, [setting]), ("ground_friction",)) as fitter:
            screen = fitter.screen
            found = fitter.with_likelier_solver(fitter.nominal())
            assert found.about[screen.index["contact_solver", (), "cone"]] == cone


@pytest.mark.slow
def test_the_other_friction_cone_is_seen_beside_a_cause(quadruped: Case) -> None:
    weak: Setting = ("motor_gain", ("fr_thigh",), {"ratio": -0.45})
    log = logged(quadruped, [weak, ("contact_solver", (), {"cone": 1.0})])
    with fitting(log, ("motor_gain", "ground_friction")) as fitter:
        screen = fitter.screen
        cause = next(c for c in screen.candidates if c.place == ("fr_thigh",))
        fit = fitter.looked_at(fitter.nominal(), [Cause(cause, (-0.45,))])
        assert fit is not None
        found = fitter.with_likelier_solver(fit)
        assert found.about[screen.index["contact_solver", (), "cone"]] == 1.0


def test_how_the_solver_treats_friction_is_a_nuisance(made: Callable[..., Path]) -> None:
    """The same robot in a simulator whose dry friction sticks instead of creeping: explained, and no cause."""
    xml = PENDULUM.replace('frictionloss="0.15"', 'frictionloss="0.6"')
    case = load_case(made(Truth(), xml=xml, runs=2, span=(2.6, 3.0)))
    with fitting(logged(case, [("friction_solver", (), {"stick": 1.0})])) as fitter:
        screen = fitter.screen
        assert not select(fitter, CONFIG).fit.causes
        explained = leftover(screen, fitter.nominal())
        screen.prior[screen.index["friction_solver", (), "stick"]] = 0.0
        assert (explained < 0.5 * leftover(screen, Fitter.of(screen).nominal())).all()
