"""How well an experiment tells rivals apart: the change of the posterior that it lets expect.

Each rival predicts the new runs as a Gaussian: its fitted motion, with the uncertainty of its values, the everyday
deviations and the noise floor around it. For two rivals with the same covariance V the expected log Bayes factor of the
true one is d/2 with d = r' V^-1 r, r being the difference of the two motions (Box and Hill, 1967, "Discrimination among
mechanistic models", Technometrics 9(1), whose criterion is the expected change of entropy of the posterior; for equal
covariances it is this). The log Bayes factor of a recording then scatters about d/2 with variance d, from which follows
the posterior probability that the true rival may expect.

V is that of the rival that is wrong: what its own values and the everyday deviations may still take up is subtracted
from the difference. What the log has taught about everyday deviations is not used, so that d is rather too small.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import Z90
from realsim.core.types import F64
from realsim.gap.answer.diagnosis import MODEL_ERROR
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS, ON_REQUEST
from realsim.gap.effects.base import Parameter, Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.effects.nuisances import NUISANCES
from realsim.gap.experiments.limits import Limits
from realsim.gap.experiments.plan import Experiment, Rig, planned_case
from realsim.gap.experiments.rivals import Rival
from realsim.gap.inference.causes.starts import twins
from realsim.gap.inference.likelihood.comparison import CORRELATION, Comparison, Noise
from realsim.gap.simulation.simulate import Setting, Simulator

DRAWS = 2000
"""Of the log Bayes factors, for the expected posterior; its own error is then about 0.01."""


@dataclass(frozen=True)
class Predicted:
    """What every rival predicts for the runs of an experiment."""

    experiment: Experiment
    comparison: Comparison
    nominal: list[F64]
    """(T, C) a run, of the nominal simulator."""
    motions: list[list[F64]]
    """(T, C) a run, a list a rival."""
    spread: list[F64]
    """(N, m) a rival: change of all bins in a row by one standard deviation along each axis of its values."""
    twins: dict[str, str]
    """Effect -> the one that does exactly the same in these signals."""

    def same(self, a: Rival, b: Rival) -> bool:
        """Whether two rivals do exactly the same in these signals, so that no recording of them can tell."""
        return self._kinds(a) == self._kinds(b)

    def _kinds(self, rival: Rival) -> set[tuple[str, tuple[Place, ...]]]:
        return {(min(p.effect, self.twins.get(p.effect, p.effect)), p.places) for p in rival.parts}


class Bench:
    """One case's robot, on which experiments are tried by simulation."""

    def __init__(self, rig: Rig, noise: Noise, limits: Limits, config: DiagnoseConfig) -> None:
        self.rig, self.noise, self.limits, self.config = rig, noise, limits, config

    def simulator(self, experiment: Experiment) -> Simulator:
        """Its runs, begun at rest. Effects count in the scales of the log, so the context is the log's."""
        simulator = Simulator(planned_case(self.rig, experiment.runs), self.config, planned=True)
        simulator.context = replace(self.rig.context)
        return simulator

    def predicted(self, experiment: Experiment, rivals: Sequence[Rival]) -> Predicted | str:
        """What each rival predicts, or which limit is left under one of them, in words."""
        with self.simulator(experiment) as simulator:
            try:
                nominal = self._simulated(simulator, [])
                if isinstance(nominal, str):
                    return nominal
                comparison = Comparison(simulator.case, simulator.channels, nominal, self.config, noise=self.noise)
                motions, spread = [], []
                for rival in rivals:
                    here = self._simulated(simulator, rival.settings())
                    if isinstance(here, str):
                        return here
                    columns = []
                    for axis in axes(rival):
                        moved, size = self._aside(simulator, rival, axis)
                        if isinstance(moved, str):
                            return moved
                        columns.append(_changes(comparison, moved, here) / size)
                    motions.append(here)
                    width = _changes(comparison, here, here).size
                    spread.append(np.stack(columns, axis=1) if columns else np.zeros((width, 0)))
            except GapError as error:
                return error.message
            return Predicted(experiment, comparison, nominal, motions, spread, _twins(simulator, rivals))

    def _aside(self, simulator: Simulator, rival: Rival, axis: F64) -> tuple[list[F64] | str, float]:
        """(prediction at the nearer end of an interval, in standard deviations from the fit)."""
        bounds = np.array([p.bounds for p in rival.parameters(simulator.context)])
        for size in (Z90, -Z90, 0.5, -0.5):  # the ends of a rival's 90 % intervals, and between
            values = rival.values + size * axis
            inside = np.clip(values, bounds[:, 0], bounds[:, 1])
            if np.abs(inside - values).max(initial=0.0) < 1e-9:
                with contextlib.suppress(GapError):  # a mass that would make no body, say
                    return self._simulated(simulator, rival.settings(inside)), size
        return self._simulated(simulator, rival.settings()), 1.0

    def _simulated(self, simulator: Simulator, settings: Sequence[Setting]) -> list[F64] | str:
        """(T, C) a run, or which limit is left."""
        edit = simulator.edited(settings)
        tracks = simulator.roll_out(edit, None)
        for run, track in zip(simulator.case.runs, tracks, strict=True):
            if broken := self.limits.broken(track):
                return f"{run.name}: {broken}"
        return [simulator.read(run, track, edit) for run, track in zip(simulator.case.runs, tracks, strict=True)]

    def deviations(self, predicted: Predicted) -> F64:
        """(N, p) change of all bins in a row by one standard deviation of each everyday deviation."""
        comparison = predicted.comparison
        with self.simulator(predicted.experiment) as simulator:
            context = simulator.context
            wanted = [
                (effect.name, place, p)
                for effect in [*(EFFECTS[n] for n in EFFECTS if n not in ON_REQUEST), *NUISANCES.values()]
                for place in effect.places(context)
                if effect.excited_by(context, place).yes
                for p in effect.parameters(context, place)
                if p.nuisance and p.strength
            ]

            def column(atom: tuple[str, Place, Parameter]) -> F64 | None:
                name, place, p = atom
                width = min(3 * p.nuisance, abs(p.step)) if p.bounds[0] < 0 else p.step
                value = float(np.clip(p.default + np.copysign(width, p.step), *p.bounds))
                try:
                    moved = simulator.simulate([(name, place, {p.name: value})])
                except GapError:
                    return None
                if not all(np.isfinite(y).all() for y in moved) or value == p.default:
                    return None
                return _changes(comparison, moved, predicted.nominal) * (p.nuisance / (value - p.default))

            found = [c for c in simulator.cores.each(column, wanted) if c is not None and np.abs(c).max() > 0]
        return (
            np.stack(found, axis=1)
            if found
            else np.zeros((_changes(comparison, predicted.nominal, predicted.nominal).size, 0))
        )


def axes(rival: Rival) -> list[F64]:
    """(m,) a principal axis of its uncertainty: one standard deviation long, the law's imperfection included."""
    values = rival.values
    if not len(values):
        return []
    size, vectors = np.linalg.eigh(rival.covariance + np.diag((MODEL_ERROR * values) ** 2))
    return [np.sqrt(max(s, 0.0)) * v for s, v in zip(size, vectors.T, strict=True) if s > 0]


def separations(predicted: Predicted, rivals: Sequence[Rival], deviations: F64 | None = None) -> F64:
    """(n, n) of i, j: d of the module's docstring where i is true and j is held against it.

    Args:
        deviations: (N, p) as of `Bench.deviations`; None to leave them out.
    """
    n = len(rivals)
    found = np.zeros((n, n))
    comparison = predicted.comparison
    for i, rival in enumerate(rivals):
        form = max((lookup(part.effect).law.form for part in rival.parts), default=0.0)
        weights = _weights(predicted, predicted.motions[i], form)
        for j in range(n):
            if j == i or predicted.same(rival, rivals[j]):
                continue
            r = _changes(comparison, predicted.motions[i], predicted.motions[j])
            parts = [predicted.spread[j]] if deviations is None else [predicted.spread[j], deviations]
            F = np.concatenate(parts, axis=1)
            FW = F * weights[:, None]
            s = FW.T @ r
            taken = s @ np.linalg.solve(FW.T @ F + np.eye(F.shape[1]), s) if F.shape[1] else 0.0
            found[i, j] = max(float(r @ (weights * r) - taken), 0.0)
    return found


def expected_posterior(separation: F64) -> F64:
    """(n,) probability that each rival may expect after the recording if it is the true one; even odds before."""
    n = len(separation)
    normal = np.random.default_rng(0).normal(size=(DRAWS, n))
    found = np.zeros(n)
    for i in range(n):
        others = [j for j in range(n) if j != i]
        d = separation[i, others]
        logs = d / 2 + np.sqrt(d) * normal[:, others]
        found[i] = float(np.mean(1 / (1 + np.exp(-np.clip(logs, -50, 50)).sum(axis=1))))
    return found


def _weights(predicted: Predicted, truth: Sequence[F64], form: float) -> F64:
    """(N,) of all bins in a row: one over the variance of sensors, slow detail and what the law may miss."""
    comparison = predicted.comparison
    rows, known = [], comparison.weights().of
    for run, (y, y0) in enumerate(zip(truth, predicted.nominal, strict=True)):
        change = comparison.change(run, y, y0)
        missed = form * np.sqrt(np.mean(change**2, axis=0))
        variance = comparison.variance(run) + CORRELATION * (comparison.noise.detail**2 + missed**2)
        rows.append(np.where(known[run] > 0, 1 / variance, 0.0).reshape(-1))
    return np.concatenate(rows)


def _changes(comparison: Comparison, after: Sequence[F64], before: Sequence[F64]) -> F64:
    """(N,) change of all bins of all runs in a row."""
    return np.concatenate(
        [comparison.change(run, y, x).reshape(-1) for run, (y, x) in enumerate(zip(after, before, strict=True))]
    )


def _twins(simulator: Simulator, rivals: Sequence[Rival]) -> dict[str, str]:
    """Effect -> another one that does exactly the same in these logs, at the same place and values."""
    parts = [(part, place) for rival in rivals for part in rival.parts for place in part.places]
    return {p.effect: twin for p, place in parts for twin in twins(simulator, p.effect, place, p.values)}
