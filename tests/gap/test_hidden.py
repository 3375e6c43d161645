"""Causes that small deviations could hide."""

from __future__ import annotations

import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.causes.fit import Fitter
from realsim.gap.causes.hidden import hidden
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
