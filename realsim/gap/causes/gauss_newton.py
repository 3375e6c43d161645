"""The values of causes: Gauss-Newton over rollouts, with secant slopes and a coarser step on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from realsim.errors import GapError
from realsim.gap.causes import figures
from realsim.gap.causes.fitted import Cause, at, parameters_of, values_of
from realsim.gap.causes.linear import Evidence
from realsim.gap.causes.screen import Screen
from realsim.gap.effects.base import Parameter
from realsim.gap.simulation.recent import Recent
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

Causes = Sequence[Cause]
Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Fidelity:
    """What a fit simulates while it searches."""

    few: tuple[int, ...] | None = None
    """Positions of the screened runs that are looked at; None: all."""
    coarse: int = 1
    """Multiplies the time step."""
    offset: tuple[F64, ...] = ()
    """(T, C) a run: what the fine step adds where the search begins."""


FULL = Fidelity()


class GaussNewton:
    """Values that bring the misfit on the runs of a screen down."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.about = np.zeros(len(screen.atoms))
        """(p,) nuisances that every simulation contains, where linear ones do not do."""
        self._recent: Recent[list[F64] | None] = Recent(24)
        """A line search ends where the next slopes begin: no need to simulate it again."""
        self._fidelities: Recent[Fidelity] = Recent(4)

    @property
    def evaluations(self) -> int:
        """Predictions that were simulated."""
        return self._recent.made

    def each(self, function: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
        """`function` of every item, in their order, on all cores: looks that do not wait for one another."""
        return self.screen.simulator.cores.each(function, items)

    def prior_beside(self, causes: Causes) -> F64:
        """A parameter that is a cause is not a nuisance at the same time, nor is one that does the same."""
        prior = self.screen.prior.copy()
        prior[[i for c in causes for i in self.screen.atoms_of(c.candidate)]] = 0.0
        return prior

    def beside(self, causes: Causes) -> F64:
        """(p,) the simulated nuisances beside these causes."""
        return np.asarray(np.where(self.prior_beside(causes) > 0, self.about, 0.0))

    def _best_start(self, causes: Causes, starts: Sequence[Sequence[float]], fidelity: Fidelity) -> Causes | None:
        begun = [at(causes, clip(np.array(start, float), parameters_of(causes))) for start in starts]
        misfits = self.each(lambda causes: self._misfit(causes, fidelity), begun)
        run = [(misfit, k) for k, misfit in enumerate(misfits) if misfit is not None]
        return begun[min(run)[1]] if run else None

    def _descend(
        self, causes: Causes, slopes: list[F64] | None, fidelity: Fidelity, iterations: int, target: float = np.inf
    ) -> tuple[Causes, float, list[F64] | None]:
        """(causes, misfit, slopes) after some damped steps; slopes that are given are taken as good enough."""
        misfit = self._misfit(causes, fidelity)
        assert misfit is not None
        parameters = parameters_of(causes)
        given, fresh, damping = slopes is not None, False, 1e-3
        for k in range(iterations):
            base, z = self._predict(causes, fidelity), values_of(causes)
            assert base is not None
            if slopes is None:
                slopes, fresh = self.slopes(causes, base, fidelity), True
                if slopes is None:
                    break
            step = self._newton(causes, base, slopes, damping, fidelity)
            on_the_way = bool((np.abs(step) >= widest(z, parameters)).any())
            before = misfit
            for shrink in (1.0, 0.4, 0.1):
                there = at(causes, clip(z + shrink * step, parameters))
                new = self._misfit(there, fidelity)
                if new is not None and new < misfit - 1e-3:
                    moved = self._predict(there, fidelity)
                    assert moved is not None
                    slopes, fresh = self._secant(slopes, values_of(there) - z, parameters, base, moved, fidelity), False
                    causes, misfit = there, new
                    damping = max(damping / 5, 1e-6)
                    break
            gained = before - misfit
            if gained <= 0 and not fresh and not given:
                slopes = None  # the secants have gone stale: take slopes again before giving up
            elif gained < 0.02 + 1e-4 * abs(misfit) or (
                k and not on_the_way and misfit - figures.PACES * gained > target
            ):
                break
        return causes, misfit, slopes

    def _fidelity(self, causes: Causes, rough: bool, coarse: bool) -> Fidelity:
        """What a search for these causes simulates; it begins beside all but the last of them."""
        few = self.screen.varied if rough else None
        stiff = any(lookup(c.candidate.effect).stiff for c in causes)
        if not coarse or stiff or self.screen.coarse == 1:
            return Fidelity(few)
        before = causes[:-1]

        def made() -> Fidelity:
            fine = self._predict(before, Fidelity(few))
            rude = self._predict(before, Fidelity(few, self.screen.coarse))
            if fine is None or rude is None:  # a stiff servo may not bear it
                return Fidelity(few)
            return Fidelity(few, self.screen.coarse, tuple(f - r for f, r in zip(fine, rude, strict=True)))

        return self._fidelities.get((_key(before), few, self.about.tobytes()), made)

    def _runs(self, fidelity: Fidelity) -> list[int]:
        return self.screen.runs if fidelity.few is None else [self.screen.runs[k] for k in fidelity.few]

    def _predict(self, causes: Causes, fidelity: Fidelity = FULL) -> list[F64] | None:
        """(T, C) a screened run (of those that are looked at); None if the simulation fails."""

        def made() -> list[F64] | None:
            settings = [*self.screen.settings(self.beside(causes)), *(s for c in causes for s in c.settings())]
            try:
                found = self.screen.simulator.simulate(settings, self._runs(fidelity), fidelity.coarse)
            except GapError:
                return None
            if fidelity.offset:
                found = [y + more for y, more in zip(found, fidelity.offset, strict=True)]
            return found if all(np.isfinite(y).all() for y in found) else None

        step = (fidelity.few, fidelity.coarse, fidelity.offset[0].tobytes() if fidelity.offset else b"")
        return self._recent.get((_key(causes), step, self.about.tobytes()), made)

    def _misfit(self, causes: Causes, fidelity: Fidelity = FULL) -> float | None:
        predicted = self._predict(causes, fidelity)
        if predicted is None:
            return None
        evidence = self.screen.evidence(predicted, fidelity.few, self.beside(causes))
        return self.screen.misfit(evidence, self.prior_beside(causes))

    def slopes(self, causes: Causes, base: Sequence[F64], fidelity: Fidelity = FULL) -> list[F64] | None:
        """(B * C, m) a run: change of the prediction per unit, by differences that see through sticking friction."""
        z, parameters = values_of(causes), parameters_of(causes)

        def slope(j: int) -> list[F64] | None:
            p = parameters[j]
            far = figures.WIDE * (p.step if abs(z[j]) < abs(p.step) else z[j])
            for change in (far, -far):
                if not p.bounds[0] <= z[j] + change <= p.bounds[1]:
                    continue
                moved = self._predict(at(causes, z + change * (np.arange(len(z)) == j)), fidelity)
                if moved is not None:
                    runs = zip(self._runs(fidelity), moved, base, strict=True)
                    return [self.screen.comparison.change(run, m, y).reshape(-1) / change for run, m, y in runs]
            return None

        found = [s for s in self.each(slope, range(len(z))) if s is not None]
        if not found or len(found) < len(z):
            return None
        return [np.stack(columns, axis=1) for columns in zip(*found, strict=True)]

    def _secant(
        self,
        slopes: list[F64],
        step: F64,
        parameters: list[Parameter],
        base: list[F64],
        moved: list[F64],
        fidelity: Fidelity = FULL,
    ) -> list[F64]:
        """Broyden's update: slopes that reproduce the last step exactly, without a further simulation."""
        scaled = step / np.array([p.step**2 for p in parameters])
        share = scaled / float(step @ scaled)
        result = []
        for D, run, m, y in zip(slopes, self._runs(fidelity), moved, base, strict=True):
            missing = self.screen.comparison.change(run, m, y).reshape(-1) - D @ step
            result.append(D + np.outer(missing, share))
        return result

    def _normal(
        self, causes: Causes, base: Sequence[F64], slopes: list[F64], fidelity: Fidelity = FULL
    ) -> tuple[Evidence, list[F64], list[F64]]:
        """(evidence, A, b): normal equations of nuisances and values together, a run each, about `base`."""
        about = self.beside(causes)
        evidence = self.screen.evidence(base, fidelity.few, about)
        A, b = [], []
        for i, (k, y, D) in enumerate(zip(evidence.runs, base, slopes, strict=True)):
            w = self.screen.comparison.weights[self.screen.runs[k]].reshape(-1)
            r = np.nan_to_num(self.screen.residual(k, y, evidence.centre - about)).reshape(-1)
            across = self.screen.weighted(k).T @ D
            A.append(np.block([[evidence.A[i], across], [across.T, D.T @ (w[:, None] * D)]]))
            b.append(np.append(evidence.b[i], D.T @ (w * r)))
        return evidence, A, b

    def _local(self, causes: Causes, base: list[F64], slopes: list[F64], fidelity: Fidelity = FULL) -> tuple[F64, F64]:
        """Marginal information (m, m) and the scores (runs, m) where the predictions are `base`."""
        evidence, A, b = self._normal(causes, base, slopes, fidelity)
        prior = self.prior_beside(causes)
        p, mean = len(prior), self.screen.nuisances(evidence, prior)
        cross = np.sum([a[:p, p:] for a in A], axis=0)
        info = np.sum([a[p:, p:] for a in A], axis=0) - cross.T @ self.screen.covariance(evidence, prior) @ cross
        return info, np.array([s[p:] - a[p:, :p] @ mean for a, s in zip(A, b, strict=True)])

    def _newton(self, causes: Causes, base: list[F64], slopes: list[F64], damping: float, fidelity: Fidelity) -> F64:
        """(m,) Levenberg-Marquardt's step; a value that leans on its bound stays there."""
        parameters, z = parameters_of(causes), values_of(causes)
        info, scores = self._local(causes, base, slopes, fidelity)
        ridge = np.diag(damping * np.diag(info) + 0.05 / np.array([p.step**2 for p in parameters]))
        gradient = scores.sum(axis=0)
        low, high = np.array([p.bounds for p in parameters]).T
        free = ~(((z <= low) & (gradient < 0)) | ((z >= high) & (gradient > 0)))
        step, sub = np.zeros(len(z)), np.ix_(free, free)
        step[free] = np.linalg.solve((info + ridge)[sub], gradient[free])
        most = widest(z, parameters)
        return np.clip(step, -most, most)


def clip(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) the nearest values within the parameters' ranges."""
    return np.clip(z, [p.bounds[0] for p in parameters], [p.bounds[1] for p in parameters])


def widest(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) longest step: a gross cause lies many of its own steps off."""
    return np.maximum(4 * np.array([abs(p.step) for p in parameters]), np.abs(z))


def _key(causes: Causes) -> tuple:
    return tuple((c.candidate.key, c.values) for c in causes)
