"""Excitations of a robot that stands on the ground: balance is checked, and the base may begin elsewhere."""

import numpy as np
import pytest

from realsim.gap import Case
from realsim.gap.experiments.excitations import EXCITATIONS
from realsim.gap.experiments.limits import limits_of
from realsim.gap.experiments.plan import planned_case, rig_of
from realsim.gap.experiments.separation import Bench, separations
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

from ..searching import CONFIG
from .conftest import rival

pytestmark = pytest.mark.slow


def test_a_standing_robot_is_shaken_without_falling(settled: Case) -> None:
    rivals = [
        rival("ground_friction", (), ratio=-1.0),
        rival("coulomb_friction", ("fl_calf",), friction=1.0),
    ]
    with Simulator(settled, CONFIG) as simulator:
        noise = Comparison(settled, simulator.channels, simulator.simulate(), CONFIG).noise
        rig = rig_of(simulator.context, 2.0)
        bench = Bench(rig, noise, limits_of(simulator.context), CONFIG)
        push = EXCITATIONS["push_and_slide"](rig, 0.2)
        assert EXCITATIONS["torque_off"](rig, 1.0) is None
        assert EXCITATIONS["known_mass"](rig, 1.0) is None
        predicted = bench.predicted(push, rivals)
        assert not isinstance(predicted, str), predicted
        assert separations(predicted, rivals)[0, 1] > 16
        elsewhere = EXCITATIONS["step_elsewhere"](rig, 0.5)
        moved, still = planned_case(rig, elsewhere.runs), planned_case(rig, push.runs)
    for run, planned in zip(moved.runs, elsewhere.runs, strict=True):
        away = run.init_qpos - still.runs[0].init_qpos
        np.testing.assert_allclose(away[:2], planned.shift)
        np.testing.assert_allclose(away[2:], 0.0)
        base = run.signals["base_pos"] - still.runs[0].signals["base_pos"][0]
        np.testing.assert_allclose(base, np.tile([*planned.shift, 0.0], (len(base), 1)), atol=1e-12)
        assert any(f"{100 * max(planned.shift):g} cm" in line for line in elsewhere.instructions)
