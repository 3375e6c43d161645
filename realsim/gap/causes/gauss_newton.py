"""The values of causes: Gauss-Newton over rollouts, with secant slopes and a coarser step on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from realsim.errors import GapError
from realsim.gap.causes.figures import NARROWER, NARROWEST, PACES, PROMISED, WIDE
from realsim.gap.causes.fitted import Cause
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.effects.base import Parameter
from realsim.gap.simulation.recent import Recent
from realsim.gap.simulation.simulate import Setting, lookup
from realsim.types import F64

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
        """(p,) nuisances that every simulation contains, so that the linear rest is small."""
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

    def _about(self, candidates: Sequence[Candidate]) -> F64:
        """(p,) the simulated nuisances beside these causes."""
        return np.asarray(np.where(self.prior_beside(candidates) > 0, self.about, 0.0))

    def _descend(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        slopes: list[F64] | None,
        parameters: list[Parameter],
        fidelity: Fidelity,
        iterations: int,
        target: float = np.inf,
        nearer: bool = False,
    ) -> tuple[F64, float, list[F64] | None]:
        """(values, misfit, slopes) after some damped steps; slopes that are given are taken as good enough."""
        value = self._misfit(candidates, z, fidelity)
        assert value is not None
        given, fresh, damping, width = slopes is not None, False, 1e-3, WIDE
        for k in range(iterations):
            base = self._predict(candidates, z, fidelity)
            assert base is not None
            if slopes is None:
                slopes, fresh = self._slopes(candidates, z, parameters, base, fidelity, width), True
                if slopes is None:
                    break
            step, promised = self._newton(candidates, z, parameters, base, slopes, damping, fidelity)
            on_the_way = bool((np.abs(step) >= widest(z, parameters)).any())
            before = value
            for shrink in (1.0, 0.4, 0.1):
                trial = self._clip(z + shrink * step, parameters)
                new = self._misfit(candidates, trial, fidelity)
                if new is not None and new < value - 1e-3:
                    moved = self._predict(candidates, trial, fidelity)
                    assert moved is not None
                    slopes, fresh = self._secant(slopes, trial - z, parameters, base, moved, fidelity), False
                    z, value = trial, new
                    damping = max(damping / 5, 1e-6)
                    break
            gained = before - value
            if gained <= 0 and not fresh and not given:
                slopes = None  # the secants have gone stale: take slopes again before giving up
            elif nearer and gained <= 0 and fresh and promised > PROMISED and width > NARROWEST:
                slopes, width = None, width * NARROWER  # the valley is narrower than the slopes' differences
            elif gained < 0.02 + 1e-4 * abs(value) or (k and not on_the_way and value - PACES * gained > target):
                break
        return z, value, slopes

    def _fidelity(self, causes: Sequence[Cause], rough: bool, coarse: bool) -> Fidelity:
        """What a search for these causes simulates; it begins beside all but the last of them."""
        few = self.screen.varied if rough else None
        stiff = any(lookup(c.candidate.effect).stiff for c in causes)
        if not coarse or stiff or self.screen.coarse == 1:
            return Fidelity(few)
        before = causes[:-1]
        candidates, z = [c.candidate for c in before], np.array([v for c in before for v in c.values])
        key = (tuple(c.key for c in candidates), z.tobytes(), few, self.about.tobytes())

        def made() -> Fidelity:
            fine = self._predict(candidates, z, Fidelity(few))
            rude = self._predict(candidates, z, Fidelity(few, self.screen.coarse))
            if fine is None or rude is None:  # a stiff servo may not bear it
                return Fidelity(few)
            return Fidelity(few, self.screen.coarse, tuple(f - r for f, r in zip(fine, rude, strict=True)))

        return self._fidelities.get(key, made)

    def _parameters(self, candidates: Sequence[Candidate]) -> list[Parameter]:
        found = []
        for c in candidates:
            every = {p.name: p for p in lookup(c.effect).parameters(self.screen.simulator.context, c.place)}
            found += [every[n] for n in c.names]
        return found

    def _best_start(
        self,
        candidates: Sequence[Candidate],
        parameters: list[Parameter],
        starts: Sequence[Sequence[float]],
        fidelity: Fidelity,
    ) -> F64 | None:
        best: tuple[float, F64] | None = None
        begun = [self._clip(np.array(start, float), parameters) for start in starts]
        values = self.each(lambda z: self._misfit(candidates, z, fidelity), begun)
        for z, value in zip(begun, values, strict=True):
            if value is not None and (best is None or value < best[0]):
                best = (value, z)
        return None if best is None else best[1]

    def _clip(self, z: F64, parameters: list[Parameter]) -> F64:
        return np.clip(z, [p.bounds[0] for p in parameters], [p.bounds[1] for p in parameters])

    def _settings(self, candidates: Sequence[Candidate], z: F64) -> list[Setting]:
        settings = self.screen.settings(self._about(candidates))
        i = 0
        for c in candidates:
            named = {n: float(v) for n, v in zip(c.names, z[i : i + len(c.names)], strict=True)}
            settings += c.settings(named)
            i += len(c.names)
        return settings

    def _runs(self, fidelity: Fidelity) -> list[int]:
        return self.screen.runs if fidelity.few is None else [self.screen.runs[k] for k in fidelity.few]

    def _predict(self, candidates: Sequence[Candidate], z: F64, fidelity: Fidelity = FULL) -> list[F64] | None:
        """(T, C) a screened run (of those that are looked at); None if the simulation fails."""
        step = (fidelity.few, fidelity.coarse, fidelity.offset[0].tobytes() if fidelity.offset else b"")
        key = (tuple(c.key for c in candidates), z.tobytes(), step, self.about.tobytes())
        return self._recent.get(key, lambda: self._simulated(candidates, z, fidelity))

    def _simulated(self, candidates: Sequence[Candidate], z: F64, fidelity: Fidelity) -> list[F64] | None:
        try:
            made = self.screen.simulator.simulate(self._settings(candidates, z), self._runs(fidelity), fidelity.coarse)
        except GapError:
            return None
        if fidelity.offset:
            made = [y + more for y, more in zip(made, fidelity.offset, strict=True)]
        return made if all(np.isfinite(y).all() for y in made) else None

    def prior_beside(self, candidates: Sequence[Candidate]) -> F64:
        """A parameter that is a cause is not a nuisance at the same time, nor is one that does the same."""
        prior = self.screen.prior.copy()
        for c in candidates:
            like = {p.name: p.like for p in lookup(c.effect).parameters(self.screen.simulator.context, c.place)}
            for place in c.places:
                for name in c.names:
                    for effect, parameter in [(c.effect, name), like[name] or (c.effect, name)]:
                        i = self.screen.index.get((effect, place, parameter))
                        if i is not None:
                            prior[i] = 0.0
        return prior

    def _misfit(self, candidates: Sequence[Candidate], z: F64, fidelity: Fidelity = FULL) -> float | None:
        predicted = self._predict(candidates, z, fidelity)
        if predicted is None:
            return None
        evidence = self.screen.evidence(predicted, fidelity.few, self._about(candidates))
        return self.screen.misfit(evidence, self.prior_beside(candidates))

    def _slopes(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        parameters: list[Parameter],
        base: list[F64],
        fidelity: Fidelity = FULL,
        width: float = WIDE,
    ) -> list[F64] | None:
        """(B * C, m) a run: change of the prediction per unit, by differences this share of a step wide."""

        def slope(j: int) -> list[F64] | None:
            p = parameters[j]
            far = width * (p.step if abs(z[j]) < abs(p.step) else z[j])
            for change in (far, -far):
                if not p.bounds[0] <= z[j] + change <= p.bounds[1]:
                    continue
                moved = self._predict(candidates, z + change * (np.arange(len(z)) == j), fidelity)
                if moved is not None:
                    runs = zip(self._runs(fidelity), moved, base, strict=True)
                    return [self.screen.comparison.change(run, m, y).reshape(-1) / change for run, m, y in runs]
            return None

        slopes = list(self.each(slope, range(len(parameters))))
        if any(s is None for s in slopes):
            return None
        return [np.stack(columns, axis=1) for columns in zip(*(s for s in slopes if s is not None), strict=True)]

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

    def _local(
        self,
        candidates: Sequence[Candidate],
        base: list[F64],
        slopes: list[F64],
        fidelity: Fidelity = FULL,
    ) -> tuple[F64, F64]:
        """Marginal information (m, m) and the scores (runs, m) where the predictions are `base`."""
        about = self._about(candidates)
        evidence = self.screen.evidence(base, fidelity.few, about)
        prior = self.prior_beside(candidates)
        cov, mean = self.screen.covariance(evidence, prior), self.screen.nuisances(evidence, prior)
        m = slopes[0].shape[1]
        info, cross = np.zeros((m, m)), np.zeros((len(prior), m))
        scores = []
        for k, y, D in zip(evidence.runs, base, slopes, strict=True):
            run = self.screen.runs[k]
            w = self.screen.comparison.weights[run].reshape(-1)
            r = np.nan_to_num(self.screen.residual(k, y, about - evidence.centre)).reshape(-1)
            here = self.screen.weighted(k).T @ D
            scores.append(D.T @ (w * r) - here.T @ mean)
            info += D.T @ (w[:, None] * D)
            cross += here
        return info - cross.T @ cov @ cross, np.array(scores)

    def _newton(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        parameters: list[Parameter],
        base: list[F64],
        slopes: list[F64],
        damping: float,
        fidelity: Fidelity,
    ) -> tuple[F64, float]:
        """(m,) Levenberg-Marquardt's step, and the log-likelihood that it promises to first order."""
        info, scores = self._local(candidates, base, slopes, fidelity)
        scale = np.array([abs(p.step) for p in parameters])
        ridge = np.diag(damping * np.diag(info) + 0.05 / scale**2)
        free = np.ones(len(z), bool)
        gradient = scores.sum(axis=0)
        for j, p in enumerate(parameters):  # a value that leans on its bound stays there
            if (z[j] <= p.bounds[0] and gradient[j] < 0) or (z[j] >= p.bounds[1] and gradient[j] > 0):
                free[j] = False
        step = np.zeros(len(z))
        if free.any():
            sub = np.ix_(free, free)
            step[free] = np.linalg.solve((info + ridge)[sub], gradient[free])
        most = widest(z, parameters)
        step = np.clip(step, -most, most)
        return step, float(step @ gradient - 0.5 * step @ info @ step)


def widest(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) longest step: a gross cause lies many of its own steps off."""
    return np.maximum(4 * np.array([abs(p.step) for p in parameters]), np.abs(z))
