"""Fit causes with the full nonlinear simulation; the small deviations are marginalised on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.effects.base import Parameter
from realsim.gap.fitted import Cause as Cause
from realsim.gap.fitted import Fit as Fit
from realsim.gap.fitted import causes_of, form, significance, spread
from realsim.gap.nuisances import NUISANCES
from realsim.gap.screen import Candidate, Screen
from realsim.gap.simulate import Setting, lookup
from realsim.types import F64

REASONABLE = 3.0
"""Standard deviations up to which a small deviation is an everyday one."""

PACES = 6.0
"""A fit is broken off where so many more steps as good as the last would not reach its target."""

SURE_ERRORS = (2.0, 2.0, 3.0)
"""Standard errors beyond which a first, second, third cause is something: many at once are rare."""

POLISH = 2
"""Steps at the fine time step after a search at the coarse one."""


@dataclass(frozen=True, eq=False)
class Look:
    """What a fit simulates while it searches."""

    few: tuple[int, ...] | None = None
    """Positions of the screened runs that are looked at; None: all."""
    coarse: int = 1
    """Multiplies the time step."""
    offset: tuple[F64, ...] = ()
    """(T, C) a run: what the fine step adds where the search begins."""


WHOLE = Look()


class Fitter:
    """Gauss-Newton over rollouts, on the runs of a screen."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.evaluations = 0
        self.about = np.zeros(len(screen.atoms))
        """(p,) nuisances that every simulation contains, so that the linear rest is small."""
        self._recent: dict[Any, list[F64] | None] = {}
        self._looks: dict[Any, Look] = {}

    def nominal(self) -> Fit:
        """No cause at all."""
        return self._measure((), None)

    def tighten(self, fit: Fit) -> Fit:
        """Weigh errors against what this fit leaves, put the nuisances where they belong, and measure it anew."""
        for _ in range(2):
            self.screen.comparison.temper(self.screen.runs, fit.predictions, self.screen.nominal, form(fit))
            fit, moved = self._settle(self.remeasure(fit))
            if not moved:
                break
        return fit

    def unbend(self, fit: Fit) -> Fit:
        """Back to robots without deviations (the solver's and the sensors' stay): a gap is left all the same.

        Small deviations that were bent to imitate a cause would hide it from its own rivals.
        """
        pure = np.array([a.effect in NUISANCES for a in self.screen.atoms])
        if not self.about[~pure].any():
            return fit
        self.about = np.where(pure, self.about, 0.0)
        fit = self.remeasure(fit)
        self.screen.comparison.temper(self.screen.runs, fit.predictions, self.screen.nominal, form(fit))
        return self.remeasure(fit)

    def remeasure(self, fit: Fit) -> Fit:
        """The same fit under the present weights and nuisances."""
        new = self._measure(fit.causes, None)
        return replace(new, covariance=fit.covariance, at_bounds=fit.at_bounds)

    def _settle(self, fit: Fit) -> tuple[Fit, bool]:
        """Nuisances at their most probable values beside the causes, by simulation; whether they moved.

        They only move if that explains most of what is left: beside a large gap, many small deviations would be bent
        to imitate it.
        """
        x = self.screen.nuisances(fit.evidence, fit.prior)
        x = np.clip(x, -REASONABLE * fit.prior, REASONABLE * fit.prior)
        x = np.where(self.screen.simulable & (np.abs(x) > 0.05 * fit.prior), x, 0.0)
        old, cost = self.about, self._cost(fit)
        for share in (1.0, 0.5):
            self.about = self.screen.possible(old + share * (x - old))
            try:
                moved = self.remeasure(fit)
            except GapError:
                continue
            if self._cost(moved) < (0.98 if old.any() else 0.6) * cost:
                return moved, True
        self.about = old
        return fit, False

    def _cost(self, fit: Fit) -> float:
        """Weighted squared residual of the simulation itself, and the nuisances' price."""
        total = float(np.sum((self.about[fit.prior > 0] / fit.prior[fit.prior > 0]) ** 2))
        for run, y in zip(self.screen.runs, fit.predictions, strict=True):
            r = self.screen.comparison.residual(run, y)
            total += float(np.nansum(self.screen.comparison.weights[run] * r**2))
        return total

    def _about(self, candidates: Sequence[Candidate]) -> F64:
        """(p,) the simulated nuisances beside these causes."""
        return np.asarray(np.where(self.prior_beside(candidates) > 0, self.about, 0.0))

    def fit(
        self,
        causes: Sequence[Cause],
        starts: Sequence[Sequence[float]] = (),
        iterations: int = 6,
        rough: bool = False,
        coarse: bool = False,
        target: float = np.inf,
    ) -> Fit | None:
        """The best values near the causes' own and the further `starts` (all values in a row); None if none runs.

        A `rough` fit looks at some of the runs while it searches, and is measured on all of them; it is broken off
        once it would not come down to the misfit `target` (of the runs it looks at) at its present pace. A `coarse`
        one takes the screen's coarser time step while it searches.
        """
        candidates = [c.candidate for c in causes]
        parameters = self._parameters(candidates)
        look = self._look(causes, rough, coarse)
        first = [[v for c in causes for v in c.values], *starts]
        z = self._best_start(candidates, parameters, first, look)
        if z is None and look.coarse > 1:
            look = Look(look.few)
            z = self._best_start(candidates, parameters, first, look)
        if z is None:
            return None
        z, value, slopes = self._descend(candidates, z, None, parameters, look, iterations, target)
        if look.coarse > 1:
            look = Look(look.few)
            if value <= target and self._predict(candidates, z, look) is not None:
                z, value, slopes = self._descend(candidates, z, slopes, parameters, look, POLISH)
        return self._measure(causes_of(candidates, z), parameters, slopes, look)

    def _descend(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        slopes: list[F64] | None,
        parameters: list[Parameter],
        look: Look,
        iterations: int,
        target: float = np.inf,
    ) -> tuple[F64, float, list[F64] | None]:
        """(values, misfit, slopes) after some damped steps; slopes that are given are taken as good enough."""
        value = self._misfit(candidates, z, look)
        assert value is not None
        given, fresh, damping = slopes is not None, False, 1e-3
        for k in range(iterations):
            base = self._predict(candidates, z, look)
            assert base is not None
            if slopes is None:
                slopes, fresh = self._slopes(candidates, z, parameters, base, look), True
                if slopes is None:
                    break
            step = self._newton(candidates, z, parameters, base, slopes, damping, look)
            on_the_way = bool((np.abs(step) >= _widest(z, parameters)).any())
            before = value
            for shrink in (1.0, 0.4, 0.1):
                trial = self._clip(z + shrink * step, parameters)
                new = self._misfit(candidates, trial, look)
                if new is not None and new < value - 1e-3:
                    moved = self._predict(candidates, trial, look)
                    assert moved is not None
                    slopes, fresh = self._secant(slopes, trial - z, parameters, base, moved, look), False
                    z, value = trial, new
                    damping = max(damping / 5, 1e-6)
                    break
            gained = before - value
            if gained <= 0 and not fresh and not given:
                slopes = None  # the secants have gone stale: look anew before giving up
            elif gained < 0.02 + 1e-4 * abs(value) or (k and not on_the_way and value - PACES * gained > target):
                break
        return z, value, slopes

    def spread(self, fit: Fit) -> Fit:
        """The same fit with its covariance from slopes taken at its very values."""
        if not fit.causes:
            return fit
        return self._measure(fit.causes, self._parameters([c.candidate for c in fit.causes]), None)

    def clear(self, fit: Fit) -> bool:
        """Whether the last cause lies well off nothing, by slopes at its very values: a search's own may be stale."""
        least = SURE_ERRORS[min(len(fit.causes), len(SURE_ERRORS)) - 1]
        return significance(self.spread(fit)) >= least

    # ------------------------------------------------------------ inside

    def _look(self, causes: Sequence[Cause], rough: bool, coarse: bool) -> Look:
        """What a search for these causes simulates; it begins beside all but the last of them."""
        few = self.screen.varied if rough else None
        stiff = any(lookup(c.candidate.effect).stiff for c in causes)
        if not coarse or stiff or self.screen.coarse == 1:
            return Look(few)
        before = causes[:-1]
        candidates, z = [c.candidate for c in before], np.array([v for c in before for v in c.values])
        key = (tuple(c.key for c in candidates), z.tobytes(), few, self.about.tobytes())
        if key not in self._looks:
            fine = self._predict(candidates, z, Look(few))
            rude = self._predict(candidates, z, Look(few, self.screen.coarse))
            made = fine is not None and rude is not None  # a stiff servo may not bear it
            offset = tuple(f - r for f, r in zip(fine or (), rude or (), strict=True)) if made else ()
            self._looks[key] = Look(few, self.screen.coarse, offset) if made else Look(few)
            if len(self._looks) > 4:
                self._looks.pop(next(iter(self._looks)))
        return self._looks[key]

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
        look: Look,
    ) -> F64 | None:
        best: tuple[float, F64] | None = None
        for start in starts:
            z = self._clip(np.array(start, float), parameters)
            value = self._misfit(candidates, z, look)
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
            settings += [(c.effect, place, named) for place in c.places]
            i += len(c.names)
        return settings

    def _runs(self, look: Look) -> list[int]:
        return self.screen.runs if look.few is None else [self.screen.runs[k] for k in look.few]

    def _predict(self, candidates: Sequence[Candidate], z: F64, look: Look = WHOLE) -> list[F64] | None:
        """(T, C) a screened run (of those that are looked at); None if the simulation fails."""
        step = (look.few, look.coarse, look.offset[0].tobytes() if look.offset else b"")
        key = (tuple(c.key for c in candidates), z.tobytes(), step, self.about.tobytes())
        if key in self._recent:
            return self._recent[key]
        self.evaluations += 1
        try:
            made = self.screen.simulator.simulate(self._settings(candidates, z), self._runs(look), look.coarse)
            if look.offset:
                made = [y + more for y, more in zip(made, look.offset, strict=True)]
            found = made if all(np.isfinite(y).all() for y in made) else None
        except GapError:
            found = None
        self._recent[key] = found
        if len(self._recent) > 24:  # a line search ends where the next slopes begin: no need to simulate it again
            self._recent.pop(next(iter(self._recent)))
        return found

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

    def _misfit(self, candidates: Sequence[Candidate], z: F64, look: Look = WHOLE) -> float | None:
        predicted = self._predict(candidates, z, look)
        if predicted is None:
            return None
        evidence = self.screen.evidence(predicted, look.few, self._about(candidates))
        return self.screen.misfit(evidence, self.prior_beside(candidates))

    def _slopes(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        parameters: list[Parameter],
        base: list[F64],
        look: Look = WHOLE,
    ) -> list[F64] | None:
        """(B * C, m) a run: change of the prediction per unit, by differences a tenth of a step wide."""
        columns: list[list[F64]] = [[] for _ in base]
        for j, p in enumerate(parameters):
            width = 0.1 * p.step if abs(z[j]) < abs(p.step) else 0.1 * z[j]
            moved = None
            for sign in (1.0, -1.0):
                if p.bounds[0] <= z[j] + sign * width <= p.bounds[1]:
                    other = z.copy()
                    other[j] += sign * width
                    moved = self._predict(candidates, other, look)
                    if moved is not None:
                        width *= sign
                        break
            if moved is None:
                return None
            for k, (run, m, y) in enumerate(zip(self._runs(look), moved, base, strict=True)):
                columns[k].append(np.asarray(self.screen.comparison.change(run, m, y).reshape(-1) / width))
        return [np.stack(c, axis=1) for c in columns]

    def _secant(
        self,
        slopes: list[F64],
        step: F64,
        parameters: list[Parameter],
        base: list[F64],
        moved: list[F64],
        look: Look = WHOLE,
    ) -> list[F64]:
        """Broyden's update: slopes that reproduce the last step exactly, without a further simulation."""
        scaled = step / np.array([p.step**2 for p in parameters])
        share = scaled / float(step @ scaled)
        result = []
        for D, run, m, y in zip(slopes, self._runs(look), moved, base, strict=True):
            missing = self.screen.comparison.change(run, m, y).reshape(-1) - D @ step
            result.append(D + np.outer(missing, share))
        return result

    def _local(
        self,
        candidates: Sequence[Candidate],
        base: list[F64],
        slopes: list[F64],
        look: Look = WHOLE,
    ) -> tuple[F64, F64]:
        """Marginal information (m, m) and the scores (runs, m) where the predictions are `base`."""
        about = self._about(candidates)
        evidence = self.screen.evidence(base, look.few, about)
        prior = self.prior_beside(candidates)
        cov, mean = self.screen.covariance(evidence, prior), self.screen.nuisances(evidence, prior)
        m = slopes[0].shape[1]
        info, cross = np.zeros((m, m)), np.zeros((len(prior), m))
        scores = []
        for k, y, D in zip(evidence.runs, base, slopes, strict=True):
            run = self.screen.runs[k]
            w = self.screen.comparison.weights[run].reshape(-1)
            r = np.nan_to_num(self.screen.residual(k, y, about)).reshape(-1)
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
        look: Look,
    ) -> F64:
        info, scores = self._local(candidates, base, slopes, look)
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
        widest = _widest(z, parameters)
        return np.clip(step, -widest, widest)

    def _measure(
        self,
        causes: tuple[Cause, ...],
        parameters: list[Parameter] | None,
        slopes: list[F64] | None = None,
        look: Look = WHOLE,
    ) -> Fit:
        """The fit with its evidence; `slopes` (of the runs looked at) are taken by differences if there are none."""
        candidates = [c.candidate for c in causes]
        z = np.array([v for c in causes for v in c.values])
        prior = self.prior_beside(candidates)
        predicted = self._predict(candidates, z)
        if predicted is None:
            raise GapError("the simulator fails with the values found", hint="look at the units of the log")
        about = self._about(candidates)
        evidence = self.screen.evidence(predicted, None, about)
        covariance = np.zeros((len(z), len(z)))
        at_bounds = []
        if parameters:
            if slopes is None:
                slopes, look = self._slopes(candidates, z, parameters, predicted), WHOLE
            if slopes is not None:
                seen = predicted if look.few is None else [predicted[k] for k in look.few]
                covariance = spread(*self._local(candidates, seen, slopes, look), parameters)
            for p, v in zip(parameters, z, strict=True):
                span = p.bounds[1] - p.bounds[0]
                if v >= p.bounds[1] - 1e-3 * span or (p.bounds[0] != 0 and v <= p.bounds[0] + 1e-3 * span):
                    at_bounds.append(p.name)
        misfit = self.screen.misfit(evidence, prior)
        return Fit(causes, misfit, covariance, tuple(predicted), about, evidence, prior, tuple(at_bounds))


def _widest(z: F64, parameters: Sequence[Parameter]) -> F64:
    """(m,) longest step: a gross cause lies many of its own steps off."""
    return np.maximum(4 * np.array([abs(p.step) for p in parameters]), np.abs(z))
