"""The values of causes: Gauss-Newton over rollouts."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self, TypeVar

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.base import Parameter
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fitted import Cause, Fit, at, parameters_of, values_of
from realsim.gap.inference.likelihood.comparison import Conditions
from realsim.gap.inference.likelihood.linear import Evidence, bounded, posterior, scaled
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.cores import Recent

Causes = Sequence[Cause]
Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Rough:
    """How a search looks at neighbours of a set where simulating takes long: on some of the screened runs, at coarse
    steps. What these do to the set itself is added, so that its neighbours differ from it as they do at fine ones, to
    first order."""

    runs: tuple[int, ...]
    """Positions among the screened runs."""
    of: tuple[Hashable, ...] = ()
    """What the set is, where steps are coarse."""
    added: tuple[F64, ...] = field(default=(), compare=False)
    """(T, C) a run: the set's prediction at fine steps without that at coarse ones; none where steps are fine."""


Few = Rough | None
"""What a fit looks at; None: all runs, at the model's own steps."""


@dataclass(frozen=True)
class GaussNewton:
    """Values that bring the misfit on the runs of a screen down."""

    screen: Screen
    conditions: Conditions
    _recent: Recent[list[F64] | None] = field(default_factory=lambda: Recent(64))
    """A line search ends where the next slopes begin: no need to simulate it again."""
    _rough: Recent[Rough] = field(default_factory=lambda: Recent(2))

    @classmethod
    def of(cls, screen: Screen, onsets: Mapping[str, float] | None = None) -> Self:
        """Beside no nuisance parameters, under the floor's weights."""
        return cls(screen, Conditions(np.zeros(len(screen.atoms)), screen.comparison.weights(), onsets or {}))

    def under(self, **changes: Any) -> Self:
        """The same under other conditions."""
        return replace(self, conditions=replace(self.conditions, **changes))

    def under_those_of(self, fit: Fit) -> Self:
        """The same under the conditions that a fit was measured under."""
        return replace(self, conditions=fit.conditions)

    @property
    def evaluations(self) -> int:
        """Predictions that were simulated."""
        return self._recent.made

    def each(self, function: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
        """`function` of every item, in their order, on all cores: looks that do not wait for one another."""
        return self.screen.simulator.cores.each(function, items)

    def rough(self, here: Fit, every: bool = False) -> Few:
        """How neighbours of a set are looked at in a search, if asked on every run; None where simulating is fast."""
        screen = self.screen
        if screen.varied is None:
            return None
        few = Rough(tuple(range(len(screen.runs))) if every else screen.varied)
        if screen.coarse == 1 or _stiff(here.causes):
            return few
        onsets = self.conditions.onsets
        of = _key(here.causes), here.about.tobytes(), tuple(onsets.items()), every

        def made() -> Rough:
            settings = [*screen.settings(here.about), *here.settings()]
            coarse = screen.simulator.simulate(settings, self._runs(few), screen.coarse, onsets)
            added = [here.predictions[k] - y for k, y in zip(few.runs, coarse, strict=True)]
            return Rough(few.runs, of, tuple(added)) if all(np.isfinite(y).all() for y in added) else few

        return self._rough.get(of, made)

    def prior_beside(self, causes: Causes) -> F64:
        """A parameter that is a cause is not a nuisance at the same time, nor is one that does the same."""
        prior = self.screen.prior.copy()
        prior[[i for c in causes for i in self.screen.atoms_of(c.candidate)]] = 0.0
        return prior

    def beside(self, causes: Causes) -> Conditions:
        """The conditions with those of the simulated nuisances that stay beside these causes."""
        about = np.where(self.prior_beside(causes) > 0, self.conditions.about, 0.0)
        return replace(self.conditions, about=about)

    def _best_start(self, causes: Causes, starts: Sequence[Sequence[float]], few: Few) -> Causes | None:
        begun = [at(causes, clip(np.array(start, float), parameters_of(causes))) for start in starts]
        misfits = self.each(lambda causes: self.misfit(causes, few), begun)
        run = [(misfit, k) for k, misfit in enumerate(misfits) if misfit is not None]
        return begun[min(run)[1]] if run else None

    def _descend(
        self, causes: Causes, few: Few, iterations: int, target: float = np.inf
    ) -> tuple[Causes, float, list[F64] | None]:
        """(causes, misfit, the last slopes) after some damped steps."""
        misfit, slopes, damping = self.misfit(causes, few), None, 1e-3
        assert misfit is not None
        parameters = parameters_of(causes)
        for k in range(iterations):
            base, z, before = self.predict(causes, few), values_of(causes), misfit
            assert base is not None
            slopes = self.slopes(causes, base, few)
            if slopes is None:
                break
            looks = self.normal(causes, base, slopes, few).looks()  # with all runs, and with the better half
            steps = [self._step(causes, look, damping) for look in looks]
            for shrink in (1.0, 0.4, 0.1):
                there = [at(causes, clip(z + shrink * step, parameters)) for step in steps]
                found = self.each(lambda moved: np.inf if (m := self.misfit(moved, few)) is None else m, there)
                new, moved = min(zip(found, there, strict=True), key=lambda look: look[0])
                if new < misfit - 1e-3:
                    causes, misfit, damping = moved, new, max(damping / 5, 1e-6)
                    break
            gained, on_the_way = before - misfit, bool((np.abs(steps) >= widest(z, parameters)).any())
            late = k and not on_the_way and misfit - figures.PACES * gained > target
            if gained < 0.02 + 1e-4 * abs(misfit) or late:
                break
        return causes, misfit, slopes

    def _runs(self, few: Few) -> list[int]:
        return self.screen.runs if few is None else [self.screen.runs[k] for k in few.runs]

    def predict(self, causes: Causes, few: Few = None) -> list[F64] | None:
        """(T, C) a screened run (of those that are looked at); None if the simulation fails."""

        def made() -> list[F64] | None:
            settings, runs, onsets = [s for c in causes for s in c.settings()], self._runs(few), self.conditions.onsets
            beside = self.screen.settings(self.beside(causes).about)
            simulate = partial(self.screen.simulator.simulate, settings, runs, onsets=onsets, beside=beside)
            try:
                if few and few.added and not _stiff(causes):  # a stiff law may blow up at coarse steps
                    coarse = simulate(coarse=self.screen.coarse)
                    found = [y + more for y, more in zip(coarse, few.added, strict=True)]
                    if all(np.isfinite(y).all() for y in found):
                        return found
                found = simulate()
            except GapError:
                return None
            return found if all(np.isfinite(y).all() for y in found) else None

        key = _key(causes), few, self.conditions.about.tobytes(), tuple(self.conditions.onsets.items())
        return self._recent.get(key, made)

    def misfit(self, causes: Causes, few: Few = None) -> float | None:
        """Of causes at their very values, on the runs that are looked at; None if the robot falls."""
        predicted = self.predict(causes, few)
        if predicted is None:
            return None
        evidence = self.screen.evidence(predicted, self.beside(causes), few.runs if few else None)
        return self.screen.misfit(evidence, self.prior_beside(causes))[0]

    def slopes(self, causes: Causes, base: Sequence[F64], few: Few = None) -> list[F64] | None:
        """(B * C, m) a run: change of the prediction per unit, by differences that see through sticking friction."""
        z, parameters = values_of(causes), parameters_of(causes)

        def slope(j: int) -> list[F64] | None:
            p = parameters[j]
            far = figures.WIDE * (p.step if abs(z[j]) < abs(p.step) else z[j])
            for change in (far, -far):
                if not p.bounds[0] <= z[j] + change <= p.bounds[1]:
                    continue
                moved = self.predict(at(causes, z + change * (np.arange(len(z)) == j)), few)
                if moved is not None:
                    runs = zip(self._runs(few), moved, base, strict=True)
                    return [self.screen.comparison.change(run, m, y).reshape(-1) / change for run, m, y in runs]
            return None

        found = [s for s in self.each(slope, range(len(z))) if s is not None]
        if not found or len(found) < len(z):
            return None
        return [np.stack(columns, axis=1) for columns in zip(*found, strict=True)]

    def normal(self, causes: Causes, base: Sequence[F64], slopes: list[F64], few: Few = None) -> Evidence:
        """Normal equations of nuisances and, behind them, values: a run each, about `base`."""
        given = self.beside(causes)
        evidence = self.screen.evidence(base, given, few.runs if few else None)
        A, b = [], []
        for i, (k, y, D) in enumerate(zip(evidence.runs, base, slopes, strict=True)):
            w = given.weights.of[self.screen.runs[k]].reshape(-1)
            r = np.nan_to_num(self.screen.residual(k, y, evidence.centre - given.about)).reshape(-1)
            across = self.screen.weighted(k).T @ D
            A.append(np.block([[evidence.A[i], across], [across.T, D.T @ (w[:, None] * D)]]))
            b.append(np.append(evidence.b[i], D.T @ (w * r)))
        return replace(evidence, A=A, b=b)

    def local(self, prior: F64, evidence: Evidence) -> tuple[F64, F64]:
        """Marginal information (m, m) and the scores (runs, m) of these normal equations, beside nuisances."""
        A, b, p = np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0), len(prior)
        mean, free = bounded(A[:p, :p], b[:p], prior, figures.REASONABLE * prior)
        cov = posterior(A[:p, :p], free)
        info = A[p:, p:] - A[p:, :p] @ cov @ A[:p, p:]
        return info, np.array([b[p:] - a[p:, :p] @ mean for a, b in zip(evidence.A, evidence.b, strict=True)])

    def _step(self, causes: Causes, evidence: Evidence, damping: float) -> F64:
        """(m,) Levenberg-Marquardt's step, with the nuisances that go along within their bounds; a value that leans on
        its bound stays there."""
        parameters, z = parameters_of(causes), values_of(causes)
        prior = _beside_free(evidence, self.prior_beside(causes), [p.step for p in parameters])
        info, scores = self.local(prior, evidence)
        gradient = scores.sum(axis=0)
        low, high = np.array([p.bounds for p in parameters]).T
        free = ~(((z <= low) & (gradient < 0)) | ((z >= high) & (gradient > 0)))
        ridge = damping * np.diag(info) + 0.05 / np.array([p.step**2 for p in parameters])
        priors = np.append(prior, np.where(free, ridge**-0.5, 0.0))
        most = np.append(figures.REASONABLE * prior, widest(z, parameters))
        return bounded(np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0), priors, most)[0][len(prior) :]


def _beside_free(evidence: Evidence, prior: F64, steps: Sequence[float]) -> F64:
    """(p,) the prior of the nuisances at the scale that is the most probable where the values may still move, whose
    normal equations stand behind those of the nuisances."""
    A, b, p = np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0), len(prior)
    inner = np.linalg.inv(A[p:, p:] + np.diag(0.05 / np.square(steps)))
    across = A[:p, p:] @ inner
    rest, score = A[:p, :p] - across @ A[p:, :p], b[:p] - across @ b[p:]
    c = sum(evidence.c) - float(b[p:] @ inner @ b[p:])
    return scaled(rest, score, c, prior)[1] * prior


def clip(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) the nearest values within the parameters' ranges."""
    return np.clip(z, [p.bounds[0] for p in parameters], [p.bounds[1] for p in parameters])


def widest(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) longest step: a gross cause lies many of its own steps off."""
    return np.asarray(np.maximum(4 * np.array([abs(p.step) for p in parameters]), np.abs(z)))


def _stiff(causes: Causes) -> bool:
    return any(lookup(c.candidate.effect).law.stiff for c in causes)


def _key(causes: Causes) -> tuple[Hashable, ...]:
    return tuple((c.candidate.key, c.values) for c in causes)
