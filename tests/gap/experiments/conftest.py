"""One short log of a pendulum, its rivals as a diagnosis names them, and experiments on it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.experiments.limits import limits_of
from realsim.gap.experiments.plan import rig_of
from realsim.gap.experiments.rivals import Part, Rival
from realsim.gap.experiments.separation import Bench
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

from ..truth import PENDULUM, Truth, make_case

SETTINGS = DiagnoseConfig(threads=1)


def rival(effect: str, place: tuple[str, ...], sigma: float = 0.02, **values: float) -> Rival:
    """One cause as a rival, its values known to about `sigma`."""
    part = Part(effect, (place,), values)
    return Rival((part,), sigma**2 * np.eye(len(values)), f"{effect} {values}")


@pytest.fixture(scope="package")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the case."""
    folder = tmp_path_factory.mktemp("experiments") / "case"
    return make_case(folder, PENDULUM, Truth(), runs=3, seed=2, span=(3.0, 3.5))


@pytest.fixture(scope="package")
def bench(pendulum: Path) -> Iterator[Bench]:
    """Experiments of two seconds a run on it."""
    case = load_case(pendulum)
    with Simulator(case, SETTINGS) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), SETTINGS)
        yield Bench(rig_of(simulator.context, 4.0), comparison.noise, limits_of(simulator.context), SETTINGS)


@pytest.fixture(scope="session")
def made_rival() -> Callable[..., Rival]:
    return rival
