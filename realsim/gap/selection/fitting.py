"""A set of causes at its most probable values, and its evidence: Laplace's method over the full simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from realsim.errors import GapError
from realsim.gap.causes.fitted import Cause, causes_of
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.effects.base import Parameter
from realsim.gap.selection.figures import ITERATIONS, LEVER_M, PACE, ROUNDS, SHAPE_STEPS, SLAB_STEPS
from realsim.gap.selection.likelihood import Likelihood, Marginal
from realsim.gap.simulation.recent import Recent
from realsim.gap.simulation.simulate import Setting, lookup
from realsim.types import F64

Slot = tuple[str, tuple[str, ...]]
"""(effect, all joints or bodies): what makes two causes the same cause."""
Named = frozenset[Slot]


@dataclass(frozen=True)
class Fit:
    """A set of causes at its most probable values."""

    causes: tuple[Cause, ...]
    evidence: float
    """Log of the probability of the data under this set, in nats, up to a constant; the prior odds are not in it."""
    marginal: Marginal
    about: F64
    """(p,) deviations that the simulation contains; the others are linear about them."""
    predictions: tuple[F64, ...]
    covariance: F64
    """(m, m) of all values, deviations integrated out."""
    at_bounds: tuple[str, ...] = ()

    @cached_property
    def named(self) -> Named:
        return frozenset((c.candidate.effect, c.candidate.place) for c in self.causes)

    @cached_property
    def key(self) -> frozenset[tuple[str, tuple[str, ...], tuple[str, ...]]]:
        return frozenset(c.candidate.key for c in self.causes)

    def settings(self) -> list[Setting]:
        return [s for c in self.causes for s in c.settings()]

    @property
    def z(self) -> F64:
        return np.array([v for c in self.causes for v in c.values])


@dataclass(frozen=True)
class At:
    """A set at some values."""

    score: float
    """Nats without the price of the causes' own parameters."""
    marginal: Marginal
    residual: tuple[F64, ...]
    predictions: tuple[F64, ...]


class Fitter:
    """Gauss-Newton over simulations, reweighted by the variance that is left; deviations are integrated out."""

    def __init__(self, screen: Screen, likelihood: Likelihood) -> None:
        self.screen, self.likelihood = screen, likelihood
        self.runs = [screen.runs[k] for k in likelihood.positions]
        self._at: Recent[At | None] = Recent(200)

    @property
    def evaluations(self) -> int:
        return self._at.made

    def fit(
        self,
        causes: Sequence[Cause],
        starts: Sequence[Sequence[float]] = (),
        target: float = -np.inf,
        rounds: int = ROUNDS,
    ) -> Fit | None:
        """The best values from those of the causes and further `starts` (all values in a row); None if none runs.

        Args:
            target: evidence below which the set is of no interest: the search is broken off.
        """
        candidates = [c.candidate for c in causes]
        parameters = self.parameters(candidates)
        begun = [_clip(np.array(s, float), parameters) for s in [[v for c in causes for v in c.values], *starts]]
        about = np.zeros(len(self.screen.atoms))  # bent to imitate a cause, deviations would hide it
        found = [(a.score, -i, a, z) for i, z in enumerate(begun) if (a := self.at(candidates, z, about)) is not None]
        if not found:
            return None
        _, _, here, z = max(found, key=lambda f: f[:2])
        slopes: list[F64] | None = None
        for k in range(rounds):
            before = here.score
            if causes:
                steps = ITERATIONS if k else 2
                here, z, slopes = self._climb(candidates, z, about, parameters, here, slopes, steps)
            about, here = self._relinearised(candidates, z, about, here)
            gained = here.score - before
            if gained < 0.5 or here.score + PACE * gained < target:
                break
        return self._scored(candidates, z, about, parameters, here, slopes)

    def at(self, candidates: Sequence[Candidate], z: F64, about: F64) -> At | None:
        """The set at these very values; None where the simulation fails."""
        key = (tuple(c.key for c in candidates), z.tobytes(), about.tobytes())
        return self._at.get(key, lambda: self._evaluated(candidates, z, about))

    def parameters(self, candidates: Sequence[Candidate]) -> list[Parameter]:
        found = []
        for c in candidates:
            every = {p.name: p for p in lookup(c.effect).parameters(self.screen.simulator.context, c.place)}
            found += [every[n] for n in c.names]
        return found

    def prior_beside(self, candidates: Sequence[Candidate]) -> F64:
        """(p,) a parameter that is a cause is not a deviation at the same time, nor is one that does the same."""
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

    # ------------------------------------------------------------ inside

    def _evaluated(self, candidates: Sequence[Candidate], z: F64, about: F64) -> At | None:
        prior = self.prior_beside(candidates)
        settings = self.screen.settings(np.where(prior > 0, about, 0.0))
        settings += [s for c in causes_of(candidates, z) for s in c.settings()]
        try:
            made = self.screen.simulator.simulate(settings, self.runs)
        except GapError:
            return None
        if not all(np.isfinite(y).all() for y in made):
            return None
        residual = self.likelihood.residual(made, np.where(prior > 0, about, 0.0))
        best: tuple[float, Marginal, list[F64]] | None = None
        for centre in self._centres():
            shifted = residual
            if centre.any():
                shifted = [
                    r - self.likelihood.columns[k] @ centre.astype(np.float32)
                    for k, r in zip(self.likelihood.positions, residual, strict=True)
                ]
            marginal = self.likelihood.marginal(self.likelihood.moments(shifted), prior)
            if best is None or marginal.value > best[0]:
                best = marginal.value, replace(marginal, x=marginal.x + centre), shifted
        assert best is not None
        _, marginal, shifted = best
        centre = self.centre_of(marginal, prior)
        score = marginal.value + log_prior(z, self.parameters(candidates))
        left = [
            r - self.likelihood.columns[k] @ (marginal.x - centre).astype(np.float32)
            for k, r in zip(self.likelihood.positions, shifted, strict=True)
        ]
        return At(score, marginal, tuple(left), tuple(made))

    def _centres(self) -> list[F64]:
        usual = self.screen.usual
        return [np.zeros(len(usual)), usual] if usual.any() else [np.zeros(len(usual))]

    def centre_of(self, marginal: Marginal, prior: F64) -> F64:
        """(p,) the centre that these deviations scatter about."""
        usual = self.screen.usual
        if not usual.any():
            return np.zeros(len(usual))
        i = int(np.argmax(np.abs(usual)))
        return usual if abs(marginal.x[i] - usual[i]) < abs(marginal.x[i]) else np.zeros(len(usual))

    def _climb(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        about: F64,
        parameters: list[Parameter],
        here: At,
        slopes: list[F64] | None,
        iterations: int,
    ) -> tuple[At, F64, list[F64] | None]:
        """Damped steps uphill; slopes that are given are taken as good enough to begin with."""
        fresh = False
        for _ in range(iterations):
            if slopes is None:
                slopes, fresh = self._slopes(candidates, z, about, parameters, here), True
                if slopes is None:
                    break
            step = self._step(z, parameters, here, slopes)
            before = here.score
            for shrink in (1.0, 0.4, 0.1):
                trial = _clip(z + shrink * step, parameters)
                new = self.at(candidates, trial, about)
                if new is not None and new.score > here.score + 1e-3:
                    slopes, fresh = self._secant(slopes, trial - z, parameters, here, new), False
                    here, z = new, trial
                    break
            gained = here.score - before
            if gained <= 0 and not fresh:
                slopes = None
            elif gained < 0.05:
                break
        return here, z, slopes

    def _slopes(
        self, candidates: Sequence[Candidate], z: F64, about: F64, parameters: list[Parameter], here: At
    ) -> list[F64] | None:
        """(B * C, m) a run: change of the transformed prediction per unit of each value."""
        columns: list[list[F64]] = []
        for j, p in enumerate(parameters):
            far = 0.1 * (p.step if abs(z[j]) < abs(p.step) else z[j])
            for change in (far, -far):
                if not p.bounds[0] <= z[j] + change <= p.bounds[1]:
                    continue
                moved = self.at(candidates, z + change * (np.arange(len(z)) == j), about)
                if moved is not None:
                    columns.append([d / change for d in self._difference(moved, here)])
                    break
            else:
                return None
        return [np.stack(c, axis=1) for c in zip(*columns, strict=True)]

    def _difference(self, moved: At, here: At) -> list[F64]:
        found = []
        for k, run, m, y in zip(self.likelihood.positions, self.runs, moved.predictions, here.predictions, strict=True):
            found.append(self.likelihood.transform(k, self.screen.comparison.change(run, m, y)))
        return found

    def _secant(self, slopes: list[F64], step: F64, parameters: list[Parameter], here: At, moved: At) -> list[F64]:
        """Broyden's update."""
        scaled = step / np.array([p.step**2 for p in parameters])
        share = scaled / float(step @ scaled)
        changes = self._difference(moved, here)
        return [D + np.outer(d - D @ step, share) for D, d in zip(slopes, changes, strict=True)]

    def _local(self, here: At, slopes: list[F64]) -> tuple[F64, F64]:
        """(m, m) information of the values once the deviations are integrated out, and (runs, m) scores."""
        w, m = here.marginal.weights, slopes[0].shape[1]
        info, cross, scores = np.zeros((m, m)), np.zeros((len(here.marginal.x), m)), []
        for k, r, D in zip(self.likelihood.positions, here.residual, slopes, strict=True):
            rows = self.likelihood.row_weights(k, w)[:, None] * D
            info += D.T @ rows
            cross += self.likelihood.columns[k].T @ rows.astype(np.float32)
            scores.append(r @ rows)
        return info - cross.T @ here.marginal.covariance @ cross, np.array(scores)

    def _step(self, z: F64, parameters: list[Parameter], here: At, slopes: list[F64]) -> F64:
        info, scores = self._local(here, slopes)
        slope, curvature = log_prior_slope(z, parameters)
        gradient = scores.sum(axis=0) + slope
        free = np.array(
            [
                not ((v <= p.bounds[0] and g < 0) or (v >= p.bounds[1] and g > 0))
                for v, g, p in zip(z, gradient, parameters, strict=True)
            ]
        )
        step = np.zeros(len(z))
        if free.any():
            sub = np.ix_(free, free)
            ridge = np.diag(curvature + 1e-3 * np.diag(info))
            step[free] = np.linalg.solve((info + ridge)[sub], gradient[free])
        widest = np.maximum(4 * np.array([abs(p.step) for p in parameters]), np.abs(z))
        return np.asarray(np.clip(step, -widest, widest))

    def _relinearised(self, candidates: Sequence[Candidate], z: F64, about: F64, here: At) -> tuple[F64, At]:
        """The deviations where they are most probable, simulated, where that is no worse than their slopes."""
        x = here.marginal.x
        prior = self.prior_beside(candidates)
        x = np.where(self.screen.simulable & (np.abs(x) > 0.1 * prior), x, 0.0)
        for share in (1.0, 0.5):
            there = self.screen.possible(about + share * (x - about))
            moved = self.at(candidates, z, there)
            if moved is not None and moved.score > here.score + 0.1:
                return there, moved
        return about, here

    def _scored(
        self,
        candidates: Sequence[Candidate],
        z: F64,
        about: F64,
        parameters: list[Parameter],
        here: At,
        slopes: list[F64] | None,
    ) -> Fit:
        evidence, covariance = here.score, np.zeros((0, 0))
        if len(candidates):
            slopes = slopes or self._slopes(candidates, z, about, parameters, here)
            info, scores = self._local(here, slopes) if slopes else (np.zeros((len(z), len(z))), np.zeros((1, len(z))))
            hessian = info + np.diag(scales(parameters) ** -2.0)
            evidence += 0.5 * len(z) * np.log(2 * np.pi) - 0.5 * float(np.linalg.slogdet(hessian)[1])
            covariance = sandwich(hessian, scores)
        bounds = tuple(p.name for p, v in zip(parameters, z, strict=True) if _at_bound(p, float(v)))
        return Fit(
            causes_of(candidates, z), evidence, here.marginal, about, here.predictions, covariance, bounds
        )  # fmt: skip


def scales(parameters: Sequence[Parameter]) -> F64:
    """(m,) prior scale of each value."""
    return np.array(
        [LEVER_M if p.shape else (SLAB_STEPS if p.strength else SHAPE_STEPS) * abs(p.step) for p in parameters]
    )


def log_prior(z: F64, parameters: Sequence[Parameter]) -> float:
    """Log density of the causes' values: Cauchy, so that gross causes are not unlikely."""
    s = scales(parameters)
    t = (z - np.array([p.default for p in parameters])) / s
    return float(-np.sum(np.log(np.pi * s * (1 + t * t)))) if len(z) else 0.0


def log_prior_slope(z: F64, parameters: Sequence[Parameter]) -> tuple[F64, F64]:
    """(m,) slope of the log density, and a curvature of it that is never negative."""
    s = scales(parameters)
    t = (z - np.array([p.default for p in parameters])) / s
    return -2 * t / (1 + t * t) / s, 2 / (1 + t * t) / s**2


def sandwich(hessian: F64, scores: F64) -> F64:
    """The model's own covariance, or what the runs' disagreement speaks of, whichever is larger."""
    inverse = np.asarray(np.linalg.inv(hessian))
    runs = len(scores)
    if runs < 3:
        return inverse
    centred = scores - scores.mean(axis=0)
    robust = inverse @ (centred.T @ centred * runs / (runs - 1)) @ inverse
    ratio = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(inverse), 1e-30), 1.0))
    return np.asarray(inverse * np.outer(ratio, ratio))


def _clip(z: F64, parameters: Sequence[Parameter]) -> F64:
    return np.clip(z, [p.bounds[0] for p in parameters], [p.bounds[1] for p in parameters]) if len(z) else z


def _at_bound(p: Parameter, value: float) -> bool:
    """Whether a value lies at an end of its range; zero, where an effect begins, and nothing left of it are no ends."""
    low, high = p.bounds
    near = min(1e-3 * (high - low), 0.05 * abs(p.step))
    return value >= high - near or (low != 0 and not p.none_left and value <= low + near)
