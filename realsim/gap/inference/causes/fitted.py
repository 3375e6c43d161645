"""What a fit finds: causes with values, how well they explain the runs, and what stays beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.base import Parameter, Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.likelihood.comparison import Conditions
from realsim.gap.inference.likelihood.linear import Evidence, bounded
from realsim.gap.inference.likelihood.screen import Candidate, Key, Screen
from realsim.gap.simulation.simulate import Setting

EffectSet = frozenset[tuple[str, tuple[Place, ...]]]
"""Of a set of causes: their effects, each with its places."""


@dataclass(frozen=True)
class Cause:
    """A candidate with values (coordinates in which 0 is nominal)."""

    candidate: Candidate
    values: tuple[float, ...]

    @property
    def named(self) -> dict[str, float]:
        return dict(zip(self.candidate.names, self.values, strict=True))

    def settings(self) -> list[Setting]:
        """What the simulator is told."""
        return self.candidate.settings(self.named)


@dataclass(frozen=True)
class Fit:
    """Causes at their best values, and how well they explain the screened runs."""

    causes: tuple[Cause, ...]
    misfit: float
    """Half the weighted squared residual after the nuisances, plus their prior: lower is better."""
    covariance: F64
    """(m, m) of all values, nuisances marginalised; the larger of model-based and run-to-run."""
    predictions: tuple[F64, ...]
    """(T, C) a screened run."""
    conditions: Conditions
    """Under which it was measured."""
    evidence: Evidence
    prior: F64
    """(p,) prior of the nuisances that stay beside these causes, times the scale."""
    scale: float
    """Of all nuisances, at its most probable value."""

    @property
    def about(self) -> F64:
        """(p,) nuisance parameters that were simulated."""
        return self.conditions.about

    @property
    def sigmas(self) -> F64:
        """(m,) standard errors of all values in a row."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def under(self, **changes: Any) -> Fit:
        """The same, to be compared under other conditions."""
        return replace(self, conditions=replace(self.conditions, **changes))

    def settings(self) -> list[Setting]:
        return [s for c in self.causes for s in c.settings()]

    @property
    def key(self) -> EffectSet:
        """The set of causes, whatever their parameters: effects at places."""
        return frozenset((c.candidate.effect, c.candidate.places) for c in self.causes)

    @property
    def full_key(self) -> frozenset[Key]:
        """The set of causes with the parameters that are fitted."""
        return frozenset(c.candidate.key for c in self.causes)

    def has(self, effect: str, place: Place) -> bool:
        """Whether this effect at this place is among the causes."""
        return any((c.candidate.effect, c.candidate.place) == (effect, place) for c in self.causes)


@dataclass
class Trial:
    """A further cause beside a set: a row of the ranking."""

    candidate: Candidate
    stage: int
    """Causes of the set."""
    linear_gain: float
    """Log-evidence gain by the linear screen."""
    outcome: str = "refitted"
    gain: float | None = None
    """Gain of the fit, or None if it was only screened."""
    values: tuple[float, ...] = ()
    held: tuple[float, float] | None = None
    """Gain on runs left out in turn, as the logarithm of a ratio, and its error; if looked at."""


def exchanged(trials: Sequence[Trial], before: Fit, fit: Fit) -> Trial:
    """The row of a cause in another one's place: it gains what that one did, and what it fits better."""
    new, stay = fit.causes[-1], {c.candidate.key for c in fit.causes[:-1]}
    gone = {c.candidate.key for c in before.causes} - stay
    old = next(t for t in reversed(trials) if t.candidate.key in gone and t.gain is not None)
    linear = max((t.linear_gain for t in trials if t.candidate.key == new.candidate.key), default=0.0)
    gain = old.gain + before.misfit - fit.misfit if old.gain is not None else None
    return Trial(new.candidate, old.stage, linear, "accepted", gain, new.values)


def values_of(causes: Sequence[Cause]) -> F64:
    """(m,) of all causes in a row."""
    return np.array([v for c in causes for v in c.values], float)


def with_errors(fit: Fit, sigmas: F64 | None = None) -> list[tuple[Cause, F64]]:
    """Causes with the standard errors of their values; `sigmas`: (m,) of all values, the fit's own if None."""
    ends = np.cumsum([len(c.values) for c in fit.causes], dtype=int)[:-1]
    return list(zip(fit.causes, np.split(fit.sigmas if sigmas is None else sigmas, ends), strict=False))


def parameters_of(causes: Sequence[Cause]) -> list[Parameter]:
    """Of all values in a row."""
    return [p for c in causes for p in c.candidate.parameters]


def at(causes: Sequence[Cause], z: F64) -> tuple[Cause, ...]:
    """The same causes with other values (all in a row)."""
    row = iter(z)
    return tuple(replace(c, values=tuple(float(next(row)) for _ in c.values)) for c in causes)


def spread(info: F64, scores: F64, parameters: list[Parameter]) -> F64:
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


def form(fit: Fit) -> float:
    """Share of the correction that the laws of these causes may miss: that of the roughest one."""
    return max((lookup(c.candidate.effect).law.form for c in fit.causes), default=0.0)


def acts_for(cause: Cause) -> float:
    """Seconds of a run in which a cause acts: of one that passes, its window without what lies before the run."""
    named = cause.named
    return named.get("lasts", named.get("end", np.inf) - max(named.get("start", 0.0), 0.0))


def at_bound(p: Parameter, value: float) -> bool:
    """Whether a value lies at an end of its range; zero, where an effect begins, and nothing left of it are no ends."""
    low, high = p.bounds
    near = min(1e-3 * (high - low), 0.05 * abs(p.step))
    return value >= high - near or (low != 0 and not p.none_left and value <= low + near)


def at_an_end(cause: Cause) -> list[str]:
    """Strengths of a cause that lie at an end of their range."""
    rows = zip(cause.candidate.parameters, cause.values, strict=True)
    return [p.name for p, value in rows if p.strength and at_bound(p, value)]


def implausible(causes: Sequence[Cause]) -> list[str]:
    """One sentence for each value that is larger than the model's own figures make plausible."""
    found = []
    for cause in causes:
        for p, value in zip(cause.candidate.parameters, cause.values, strict=True):
            most, of_what = _most(p)
            if abs(value) > most:
                name = f"{cause.candidate.effect} {', '.join(cause.candidate.place)}".strip()
                size = f"{p.name} {p.report(value):.3g} {p.unit}"
                found.append(f"{name}: {size} is more than {of_what}, so it imitates something")
    return found


def imitates(fit: Fit) -> bool:
    """Whether a cause is larger than plausible, or its strength at an end of its range."""
    values = [(p, v) for c in fit.causes for p, v in zip(c.candidate.parameters, c.values, strict=True)]
    return any(abs(v) > _most(p)[0] or (p.strength and at_bound(p, v)) for p, v in values)


def _most(p: Parameter) -> tuple[float, str]:
    """(largest plausible size of a parameter's coordinate, what that is in words); infinite where nothing says so."""
    if p.logarithmic:
        return float(np.log(figures.RATIO)), f"{figures.RATIO:g} times more or less than in the model"
    return p.plausible


# ---------------------------------------------------------------- what stays beside a fit and everyday deviations


def deviations(screen: Screen, fit: Fit) -> F64:
    """(atoms,) the most probable everyday deviations beside a fit's causes. What is beyond reason of one is cut off
    and not taken over by others: a log that needs it has a gap, which they would hide."""
    A, b, prior = np.sum(fit.evidence.A, axis=0), np.sum(fit.evidence.b, axis=0), fit.prior / fit.scale
    most, (free, _) = figures.REASONABLE * prior, bounded(A, b, prior, np.inf)
    return np.clip(free, -most, most)


def nuisance_settings(screen: Screen, fit: Fit, scale: float = 1.0) -> list[Setting]:
    """The most probable everyday deviations, times `scale` as settings for the simulator; tiny ones are left out."""
    x = deviations(screen, fit)
    x = fit.evidence.centre + np.where((np.abs(x) > 0.02 * fit.prior) & ~screen.stiff, x, 0.0)
    return screen.settings(scale * x)


def leftover(screen: Screen, fit: Fit) -> F64:
    """(runs,) mean square in units of the tolerance that stays beside causes and everyday deviations."""
    rows = zip(screen.runs, rests(screen, fit), strict=True)
    tolerance, weights = screen.comparison.tolerance, fit.conditions.weights
    return np.array([float(np.nanmean(r**2 / tolerance(run, weights))) for run, r in rows])


def rests(screen: Screen, fit: Fit) -> list[F64]:
    """(B, C) a run: residual beside causes and everyday deviations."""
    x = fit.evidence.centre + deviations(screen, fit) - fit.about
    return [screen.residual(k, y, x) for k, y in enumerate(fit.predictions)]


def is_gap(left: F64) -> bool:
    """Whether what stays beside the nuisance parameters (runs,) is more than a floor's worth, in most runs or on the
    whole; a single run near a resonance blows up small deviations."""
    return bool(np.median(left) > figures.GATE_MEDIAN or left.mean() > figures.GATE_MEAN)
