"""Fit causes with the full nonlinear simulation; the small deviations are marginalised on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.effects.base import Parameter
from realsim.gap.screen import Candidate, Evidence, Screen, marginal, posterior
from realsim.gap.simulate import Setting, lookup
from realsim.types import F64


@dataclass(frozen=True)
class Cause:
    """A candidate with values (coordinates in which 0 is nominal)."""

    candidate: Candidate
    values: tuple[float, ...]

    @property
    def named(self) -> dict[str, float]:
        return dict(zip(self.candidate.names, self.values, strict=True))

    def settings(self) -> list[Setting]:
        """What the simulator is told; places of a group share the values."""
        return [(self.candidate.effect, place, self.named) for place in self.candidate.places]


@dataclass(frozen=True)
class Fit:
    """Causes at their best values, and how well they explain the screened runs."""

    causes: tuple[Cause, ...]
    misfit: float
    """Half the weighted squared residual after the nuisances, plus their prior: lower is better."""
    covariance: F64
    """(m, m) of all values, nuisances marginalised; the larger of model-based and run-to-run."""
    predictions: tuple[F64, ...]
    """(T, C) a screened run, before the nuisances."""
    evidence: Evidence
    prior: F64
    """(p,) prior of the nuisances that stay beside these causes."""
    at_bounds: tuple[str, ...] = ()

    def settings(self) -> list[Setting]:
        return [s for c in self.causes for s in c.settings()]


class Fitter:
    """Gauss-Newton over rollouts, on the runs of a screen."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.evaluations = 0
        self._recent: dict[Any, list[F64] | None] = {}

    def nominal(self) -> Fit:
        """No cause at all."""
        return self._measure((), None)

    def tighten(self, fit: Fit) -> Fit:
        """Weigh errors against what this fit leaves, and measure it anew."""
        self.screen.comparison.temper(self.screen.runs, fit.predictions)
        return self.remeasure(fit)

    def remeasure(self, fit: Fit) -> Fit:
        """The same fit under the present weights."""
        evidence = self.screen.evidence(fit.predictions)
        return replace(fit, evidence=evidence, misfit=marginal(evidence, fit.prior)[2])

    def fit(self, causes: Sequence[Cause], starts: Sequence[Sequence[float]] = (), iterations: int = 4) -> Fit | None:
        """The best values near the causes' own and the further `starts` (all values in a row); None if none runs."""
        candidates = [c.candidate for c in causes]
        parameters = self._parameters(candidates)
        best: tuple[float, F64] | None = None
        for start in [[v for c in causes for v in c.values], *starts]:
            z = self._clip(np.array(start, float), parameters)
            value = self._misfit(candidates, z)
            if value is not None and (best is None or value < best[0]):
                best = (value, z)
        if best is None:
            return None
        value, z = best
        damping = 1e-3
        for _ in range(iterations):
            step = self._newton(candidates, z, parameters, damping)
            if step is None:
                break
            improved = False
            for shrink in (1.0, 0.4, 0.1):
                trial = self._clip(z + shrink * step, parameters)
                new = self._misfit(candidates, trial)
                if new is not None and new < value - 1e-3:
                    gained = value - new
                    z, value, improved = trial, new, True
                    damping = max(damping / 5, 1e-6)
                    break
            if not improved:
                break
            if gained < 0.02 + 1e-4 * abs(value):
                break
        split, fitted = 0, []
        for candidate in candidates:
            count = len(candidate.names)
            fitted.append(Cause(candidate, tuple(float(v) for v in z[split : split + count])))
            split += count
        return self._measure(tuple(fitted), parameters)

    # ------------------------------------------------------------ inside

    def _parameters(self, candidates: Sequence[Candidate]) -> list[Parameter]:
        found = []
        for c in candidates:
            every = {p.name: p for p in lookup(c.effect).parameters(self.screen.simulator.context, c.place)}
            found += [every[n] for n in c.names]
        return found

    def _clip(self, z: F64, parameters: list[Parameter]) -> F64:
        return np.clip(z, [p.bounds[0] for p in parameters], [p.bounds[1] for p in parameters])

    def _settings(self, candidates: Sequence[Candidate], z: F64) -> list[Setting]:
        settings: list[Setting] = []
        i = 0
        for c in candidates:
            named = {n: float(v) for n, v in zip(c.names, z[i : i + len(c.names)], strict=True)}
            settings += [(c.effect, place, named) for place in c.places]
            i += len(c.names)
        return settings

    def _predict(self, candidates: Sequence[Candidate], z: F64) -> list[F64] | None:
        key = (tuple(c.key for c in candidates), z.tobytes())
        if key in self._recent:
            return self._recent[key]
        self.evaluations += 1
        try:
            made = self.screen.simulator.simulate(self._settings(candidates, z), runs=self.screen.runs)
            found = made if all(np.isfinite(y).all() for y in made) else None
        except GapError:
            found = None
        self._recent[key] = found
        if len(self._recent) > 12:  # a line search ends where the next slopes begin: no need to simulate it again
            self._recent.pop(next(iter(self._recent)))
        return found

    def prior_beside(self, candidates: Sequence[Candidate]) -> F64:
        """A parameter that is a cause is not a nuisance at the same time."""
        prior = self.screen.prior.copy()
        for c in candidates:
            for place in c.places:
                for name in c.names:
                    i = self.screen.index.get((c.effect, place, name))
                    if i is not None:
                        prior[i] = 0.0
        return prior

    def _misfit(self, candidates: Sequence[Candidate], z: F64) -> float | None:
        predicted = self._predict(candidates, z)
        if predicted is None:
            return None
        evidence = self.screen.evidence(predicted)
        return marginal(evidence, self.prior_beside(candidates))[2]

    def _slopes(
        self, candidates: Sequence[Candidate], z: F64, parameters: list[Parameter], base: list[F64]
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
                    moved = self._predict(candidates, other)
                    if moved is not None:
                        width *= sign
                        break
            if moved is None:
                return None
            for k, (run, m, y) in enumerate(zip(self.screen.runs, moved, base, strict=True)):
                columns[k].append(np.asarray(self.screen.comparison.change(run, m, y).reshape(-1) / width))
        return [np.stack(c, axis=1) for c in columns]

    def _local(self, candidates: Sequence[Candidate], z: F64, parameters: list[Parameter]):
        """Marginal information (m, m) and the scores (runs, m) at z; None if it cannot be simulated."""
        base = self._predict(candidates, z)
        if base is None:
            return None
        slopes = self._slopes(candidates, z, parameters, base)
        if slopes is None:
            return None
        evidence = self.screen.evidence(base)
        prior = self.prior_beside(candidates)
        A, b = np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0)
        mean, cov = posterior(A, b, prior)
        info = np.zeros((len(z), len(z)))
        cross = np.zeros((len(prior), len(z)))
        crosses, direct = [], []
        for k, run in enumerate(self.screen.runs):
            w = self.screen.comparison.weights[run].reshape(-1)
            r = np.nan_to_num(self.screen.comparison.residual(run, base[k])).reshape(-1)
            D = slopes[k]
            crosses.append(self.screen._weighted[k].T.astype(float) @ D)
            direct.append(D.T @ (w * r))
            info += D.T @ (w[:, None] * D)
            cross += crosses[-1]
        info -= cross.T @ cov @ cross
        scores = np.array([d - c.T @ mean for d, c in zip(direct, crosses, strict=True)])
        return info, scores, base

    def _newton(
        self, candidates: Sequence[Candidate], z: F64, parameters: list[Parameter], damping: float
    ) -> F64 | None:
        local = self._local(candidates, z, parameters)
        if local is None:
            return None
        info, scores, _ = local
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
        return np.clip(step, -4 * scale, 4 * scale)

    def _measure(self, causes: tuple[Cause, ...], parameters: list[Parameter] | None) -> Fit:
        candidates = [c.candidate for c in causes]
        z = np.array([v for c in causes for v in c.values])
        prior = self.prior_beside(candidates)
        if parameters:
            local = self._local(candidates, z, parameters)
            predicted = local[2] if local is not None else self._predict(candidates, z)
        else:
            local, predicted = None, self._predict(candidates, z)
        if predicted is None:
            raise GapError("the simulator fails with the values found", hint="look at the units of the log")
        evidence = self.screen.evidence(predicted)
        covariance = np.zeros((len(z), len(z)))
        at_bounds = []
        if local is not None and parameters is not None:
            covariance = self._covariance(local[0], local[1], parameters)
            for p, v in zip(parameters, z, strict=True):
                span = p.bounds[1] - p.bounds[0]
                if v >= p.bounds[1] - 1e-3 * span or (p.bounds[0] != 0 and v <= p.bounds[0] + 1e-3 * span):
                    at_bounds.append(p.name)
        return Fit(
            causes, marginal(evidence, prior)[2], covariance, tuple(predicted), evidence, prior, tuple(at_bounds)
        )

    def _covariance(self, info: F64, scores: F64, parameters: list[Parameter]) -> F64:
        """The model's own, or the one that the runs' disagreement speaks of (sandwich), whichever is larger."""
        scale = np.array([abs(p.step) for p in parameters])
        inverse: F64 = np.asarray(np.linalg.inv(info + np.diag(1e-2 / scale**2)), dtype=np.float64)
        runs = len(scores)
        if runs < 3:
            return inverse
        centred = scores - scores.mean(axis=0)
        sandwich = inverse @ (centred.T @ centred * runs / (runs - 1)) @ inverse
        ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-30), 1.0))
        return np.asarray(inverse * np.outer(ratio, ratio))
