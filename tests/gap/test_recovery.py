"""Effects are found again where the library's own simulator put them, and absent where not; those that a pendulum or
an arm shows are in test_rejection.py."""

from importlib import import_module
from pkgutil import iter_modules

import numpy as np
import pytest

from realsim.gap import EFFECTS, Case, effects, load_case
from realsim.gap.effects import ON_REQUEST
from realsim.gap.effects.base import Effect
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import deviations, is_gap, leftover
from realsim.gap.inference.causes.proposals import by_simulation
from realsim.gap.inference.causes.starts import starts
from realsim.gap.inference.likelihood.linear import log_evidence, marginal
from realsim.gap.inference.likelihood.screen import slab

from .searching import fitting, logged, simulator_of
from .truth import Truth

GROUND = ("ground_friction", "contact_compliance", "terrain_height", "terrain_tilt", "terrain_scale", "terrain_wobble")
SIZE = {"ground_friction": 1.0, "imu_bias": 8.0, "load_friction": 2.0, "stribeck_friction": 2.0, "terrain_scale": 2.0}
"""In steps of the parameter; 1.5 where nothing stands."""
UNSEEN = ("camera_delay", "camera_mount", "depth_noise")


@pytest.fixture(scope="module")
def arm(made) -> Case:
    case = load_case(made(Truth(), runs=2, span=(2.2, 2.6)))
    return case


@pytest.mark.slow
@pytest.mark.parametrize("name", [*GROUND, "imu_bias", *ON_REQUEST])
def test_recovered_on_a_floating_base_or_where_it_is_named(name: str, settled: Case, arm: Case) -> None:
    case = arm if name in ON_REQUEST else settled
    place, value = injected(name, case)
    with fitting(logged(case, [(name, place, value)]), (name,)) as fitter:
        assert recovered(fitter, name, place, value)


@pytest.mark.slow
def test_an_encoder_that_sets_a_foot_higher_is_found_though_no_slope_points_there(settled: Case) -> None:
    """Other feet carry the robot then; the ground under one of them may do much the same."""
    case = logged(settled, [("joint_offset", ("fl_calf",), {"offset": -0.06})])
    with fitting(case, ("joint_offset", "terrain_height")) as fitter:
        proposals = list(by_simulation(fitter, fitter.nominal()))
    best = max((p for p in proposals if p.causes[0].candidate.effect == "joint_offset"), key=lambda p: p.foretold)
    assert best.foretold > 100
    assert best.causes[0].candidate.place == ("fl_calf",)
    assert best.causes[0].named == {"offset": pytest.approx(-0.06, rel=0.5)}


def test_a_robot_that_does_not_stand_has_no_footing(arm: Case) -> None:
    with fitting(arm, ("joint_offset",)) as fitter:
        assert not list(by_simulation(fitter, fitter.nominal()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "place", "values"),
    [
        ("ground_friction", (), {"ratio": -0.8}),
        ("terrain_tilt", (), {"roll": 0.05, "pitch": 0.03}),
    ],
)
def test_a_gross_cause_is_found_by_simulation_though_small_deviations_imitate_it(
    effect: str, place: tuple[str, ...], values: dict[str, float], settled: Case
) -> None:
    case = logged(settled, [(effect, place, values)])
    with fitting(case, (effect, "com_offset", "motor_gain", "external_force")) as fitter:
        best = max(by_simulation(fitter, fitter.nominal()), key=lambda p: p.foretold)
    (cause,) = best.causes
    assert (cause.candidate.effect, cause.candidate.place) == (effect, place)
    assert best.foretold > 50
    assert all(0.25 < cause.named[name] / true < 2 for name, true in values.items())


@pytest.mark.slow
def test_what_a_finer_step_does_is_no_gap(settled: Case) -> None:
    case = logged(settled, [("time_step", (), {"finer": 0.5})])
    with fitting(case, ("armature",)) as fitter:
        screen = fitter.screen
        nominal = fitter.nominal()
        step = screen.index["time_step", (), "finer"]
        assert deviations(screen, nominal)[step] > 0
        never = np.where(np.arange(len(nominal.prior)) == step, 1e-9, nominal.prior)
        assert screen.misfit(nominal.evidence, never)[0] > screen.misfit(nominal.evidence, nominal.prior)[0] + 1


def injected(name: str, case: Case) -> tuple[tuple[str, ...], dict[str, float]]:
    """Where an effect is put and how large: its first place and its first parameter."""
    effect, context = EFFECTS[name], simulator_of(case).context
    place = effect.places(context)[0]
    parameters = effect.parameters(context, place)
    first = next(p for p in parameters if not effect.variants[0] or p.name == effect.variants[0][0])
    return place, {first.name: SIZE.get(name, 1.5) * first.step}


def recovered(fitter: Fitter, name: str, place: tuple[str, ...], value: dict[str, float]) -> Fit | None:
    """The fit from the true values, which the one from the log's own estimate must come to; None if not excited."""
    ((first, true_value),) = value.items()
    screen, nominal = fitter.screen, fitter.nominal()
    here = [c for c in screen.candidates if (c.effect, c.place, c.names[0]) == (name, place, first)]
    if not here:
        return None
    candidate = here[0]
    A, b, _ = marginal(nominal.evidence, nominal.prior, np.inf)
    estimate = log_evidence(A, b, candidate.directions, slab(candidate))[1]
    begin, *more = starts(screen, candidate, estimate)
    fit = fitter.fit([Cause(candidate, tuple(begin))], more, few=fitter.rough(nominal))
    assert fit is not None
    fit = fitter.fit(fit.causes, iterations=6) or fit
    values = {p.name: p.default for p in EFFECTS[name].parameters(screen.simulator.context, place)} | value
    true = fitter.fit([Cause(candidate, tuple(values[n] for n in candidate.names))], iterations=3)
    assert true is not None
    assert fit.misfit < true.misfit + 0.1 * (nominal.misfit - true.misfit)
    assert fit.causes[0].named[first] == pytest.approx(true_value, rel=0.2)
    return true


def test_nothing_is_found_where_nothing_is(arm: Case) -> None:
    case = logged(arm, [])
    with fitting(case, ("payload", "coulomb_friction", "command_delay")) as fitter:
        assert not is_gap(leftover(fitter.screen, fitter.nominal()))


def test_the_library_names_every_effect_that_its_files_define() -> None:
    files = [import_module(f"{effects.__name__}.{m.name}") for m in iter_modules(effects.__path__)]
    assert {e.name for file in files for e in vars(file).values() if isinstance(e, Effect)} == set(EFFECTS)
