"""A search of causes set up on a case, and logs that the library's own simulator writes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Setting, Simulator
from tests.truths.drone import DRONE, fly
from tests.truths.written import write_case

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)


_KEPT: dict[int, tuple[Case, Simulator]] = {}


def simulator_of(case: Case) -> Simulator:
    """The nominal simulator of a case, one for the last few: setting one up takes as long as dozens of simulations."""
    kept = _KEPT.pop(id(case), None) or (case, Simulator(case, CONFIG))
    _KEPT[id(case)] = kept
    if len(_KEPT) > 4:
        _KEPT.pop(next(iter(_KEPT)))
    return kept[1]


@contextmanager
def fitting(
    case: Case, effects: Sequence[str] = (), runs: Sequence[int] | None = None, config: DiagnoseConfig = CONFIG
) -> Iterator[Fitter]:
    """A fitter of these effects (all of them if none are given) to some runs of a case, or to all."""
    with Simulator(case, config) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), config, runs)
        yield Fitter.of(Screen(simulator, comparison, range(len(case.runs)) if runs is None else runs, effects))


def logged(case: Case, settings: Sequence[Setting], seed: int = 0) -> Case:
    """The case with the log that its simulator writes under these settings, with a little noise."""
    rng, runs, simulator = np.random.default_rng(seed), [], simulator_of(case)
    channels = simulator.channels
    for run, y in zip(case.runs, simulator.simulate(settings), strict=True):
        signals = {}
        for name in dict.fromkeys(c.signal for c in channels):
            values = y[:, [i for i, c in enumerate(channels) if c.signal == name]]
            if name != "base_rot":
                signals[name] = values + rng.normal(0, 1e-4, values.shape)
        runs.append(replace(run, signals=run.signals | signals))
    return case.with_runs(tuple(runs))


def flights(
    folder: Path, *, payload: float = 0.0, com: float = 0.0, thrust: Any = 1.0, runs: int = 4, seconds: float = 3.0,
    gusts: float = 0.0,
) -> Case:  # fmt: skip
    """Of a drone that is `payload` kg heavier than its model, its centre of mass `com` m in front, its thrust (or that
    of each rotor) `thrust` times as high, in gusts of rad/s2."""
    spec, rng = mujoco.MjSpec.from_string(DRONE), np.random.default_rng(0)
    spec.body("drone").mass += payload
    spec.body("drone").ipos = [com, 0.0, 0.0]
    for rotor, ratio in zip(spec.actuators, np.broadcast_to(thrust, 4), strict=True):
        rotor.gainprm = rotor.gainprm * ratio
    flown = {f"flight_{k}": fly(spec.compile(), rng, seconds=seconds, gusts=gusts) for k in range(runs)}
    return load_case(write_case(folder, DRONE, flown, command_kind="torque", imu_site="imu"))
