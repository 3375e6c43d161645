"""Causes that small deviations could hide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import EFFECTS, DiagnoseConfig, load_case
from realsim.gap.causes.fit import Cause, Fitter
from realsim.gap.causes.fitted import significance
from realsim.gap.causes.hidden import hidden
from realsim.gap.causes.merit import deviation
from realsim.gap.causes.rivals import Trial
from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged
from .truth import PENDULUM, Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)


@pytest.mark.parametrize("shift", [0.02, 0.03])
def test_deviations_that_imitate_a_cause_do_not_make_it_smaller(made, shift: float) -> None:
    nominal = load_case(made("hidden", Truth(), xml=PENDULUM, runs=4))
    case = logged(nominal, [("com_offset", ("arm",), {"z": shift})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        fitter = Fitter(Screen(simulator, comparison, range(len(case.runs))))
        bent = fitter.tighten(fitter.nominal())
        about = fitter.about.copy()
        assert about.any()
        trials: list[Trial] = []
        hidden(fitter.screen, fitter, bent, 0, trials)
        assert np.array_equal(fitter.about, about)  # they are left as they were
    found = next(t for t in trials if t.effect == "com_offset")
    assert found.values["z"] == pytest.approx(shift, rel=0.05)


def test_where_a_mass_sits_does_not_make_it_a_payload(made) -> None:
    """Not even where the body's own centre of mass, at which it would do least, lies at zero."""
    case = load_case(made("hidden", Truth(), xml=PENDULUM, runs=4))
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), ("payload",))
        fitter = Fitter(screen)
        load = next(c for c in screen.candidates if len(c.names) == 4)
        cause = Cause(load, (0.001, 0.3, 0.2, -0.4))
        fit = fitter.spread(fitter.remeasure(replace(fitter.nominal(), causes=(cause,))))
    kinds = {p.name: p.strength for p in EFFECTS["payload"].parameters(simulator.context, ("arm",))}
    assert kinds == {"mass": True, "x": False, "y": False, "z": False}
    assert deviation(screen, cause) < 0.1
    (errors,) = significance(fit, fitter._parameters([load]))
    assert errors == pytest.approx(0.001 / np.sqrt(fit.covariance[0, 0]))
