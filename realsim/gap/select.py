"""Which causes: forward selection with backward removal, decided by unseen runs; rivals that cannot be told apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from realsim.gap.config import DiagnoseConfig
from realsim.gap.fit import Cause, Fit, Fitter
from realsim.gap.heldout import leftover
from realsim.gap.screen import Candidate, Screen, marginal, posterior, score, slab
from realsim.gap.simulate import lookup
from realsim.gap.windows import window_candidates
from realsim.types import F64

GATE_MEDIAN, GATE_MEAN = 1.4, 2.8
"""Mean square in units of the floor, over runs, above which there is a gap."""
LEAST_IMPROVEMENT = 0.08
"""Share of what is left that a further cause must remove."""


@dataclass(frozen=True)
class Trial:
    """A rival that was looked at, for the ranking table."""

    effect: str
    place: tuple[str, ...]
    names: tuple[str, ...]
    stage: int
    linear_gain: float
    """Log-evidence gain by the linear screen."""
    gain: float | None = None
    """Gain after the nonlinear fit, or None if it was not refitted."""
    heldout_gain: float | None = None
    """Gain per unseen run, the mean over the runs left out in turn."""
    heldout_se: float | None = None
    values: dict[str, float] = field(default_factory=dict)
    outcome: str = "screened"


@dataclass
class Selection:
    """What the selection came to."""

    fit: Fit
    nominal: Fit
    trials: list[Trial]
    equivalent: list[Fit]
    gains: dict[int, float]
    """Loss in log-likelihood without cause i of the fit."""
    notes: list[str]


def select(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, tick: Callable[[str, float], None] = lambda w, s: None
) -> Selection:
    """Causes of the gap on the screened runs."""
    nominal = fitter.nominal()
    current = nominal
    trials: list[Trial] = []
    notes: list[str] = []
    stages: list[tuple[Fit, list[Fit]]] = []
    for stage in range(config.max_causes):
        tick(f"selection, cause {stage + 1}", stage / config.max_causes)
        current = fitter.tighten(current)
        if not is_gap(leftover(screen, current)):
            notes.append("what is left is within the floor and the small deviations")
            break
        fits = _rivals(screen, fitter, config, current, stage, trials)
        best = next((f for f in fits if _acceptable(screen, config, current, f, trials)), None)
        if best is None:
            break
        stages.append((current, fits))
        current = best
    current = fitter.tighten(current)
    nominal = fitter.remeasure(nominal)
    if current.causes:
        current = fitter.fit(current.causes) or current
        current = _exchange(screen, fitter, current, notes)
    current = _prune(screen, fitter, config, current, notes)
    gains = {}
    for i in range(len(current.causes)):
        less = _without(fitter, current, i, nominal)
        gains[i] = less.misfit - current.misfit if less is not None else 0.0
    equivalent = _equivalent(screen, fitter, config, current, nominal, stages) if current.causes else []
    return Selection(current, nominal, trials, equivalent, gains, notes)


# ---------------------------------------------------------------- one stage


def ranked(screen: Screen, current: Fit) -> list[tuple[float, Candidate, F64]]:
    """All candidates by the linear evidence they add to `current`, best first."""
    A, b, _ = marginal(current.evidence, current.prior)
    taken = {(c.candidate.effect, p) for c in current.causes for p in c.candidate.places}
    found = []
    for candidate in screen.candidates:
        if any((candidate.effect, p) in taken for p in candidate.places):
            continue
        gain, estimate, _ = score(A, b, candidate.directions, slab(candidate, screen))
        found.append((gain, candidate, estimate))
    return sorted(found, key=lambda item: -item[0])


def _rivals(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, current: Fit, stage: int, trials: list[Trial]
) -> list[Fit]:
    """The best candidates of the linear screen, refitted together with what is already accepted; best first."""
    order = ranked(screen, current)
    # Far behind the leader by the linear screen, only effects that are far from linear can still win.
    least = max(0.5 * config.min_gain, 0.04 * order[0][0] if order else 0.0)
    finalists: list[tuple[float, Candidate, F64]] = []
    per_effect: dict[str, int] = {}
    for gain, candidate, estimate in order:
        if gain > least and len(finalists) < config.finalists + 4:
            count = per_effect.get(candidate.effect, 0)
            # The first few take what is best; then every further effect gets its best place, so none is overlooked.
            if count < 2 or (len(finalists) < 3 and count < 3):
                if len(finalists) >= config.finalists and count:
                    continue
                finalists.append((gain, candidate, estimate))
                per_effect[candidate.effect] = count + 1
                continue
        if len(trials) < 4000:
            trials.append(Trial(candidate.effect, candidate.place, candidate.names, stage, gain))
    fits = []
    forces = [(g, c, v) for g, c, v in window_candidates(screen, current) if not _has(current, c)]
    chosen: list[tuple[float, Candidate, Any]] = [*finalists, *forces]
    for gain, candidate, estimate in chosen:
        if isinstance(estimate, dict):
            values = tuple(float(estimate[n]) for n in candidate.names)
            fit = fitter.fit([*current.causes, Cause(candidate, values)], iterations=8)
        else:
            fit = _refit(screen, fitter, current, candidate, estimate)
        if fit is None:
            trials.append(
                Trial(candidate.effect, candidate.place, candidate.names, stage, gain, outcome="fails to run")
            )
            continue
        mean, error, _ = heldout(screen, current, fit)
        trials.append(
            Trial(
                candidate.effect, candidate.place, candidate.names, stage, gain,
                current.misfit - fit.misfit, mean, error, fit.causes[-1].named, "refitted",
            )
        )  # fmt: skip
        fits.append(fit)
    return sorted(fits, key=lambda f: f.misfit + _complexity(f))


def _has(fit: Fit, candidate: Candidate) -> bool:
    return any(c.candidate.effect == candidate.effect and c.candidate.place == candidate.place for c in fit.causes)


def _complexity(fit: Fit) -> float:
    """Half a log of the data a parameter, in round numbers."""
    return 4.0 * sum(len(c.values) for c in fit.causes)


def _refit(screen: Screen, fitter: Fitter, current: Fit, candidate: Candidate, estimate: F64) -> Fit | None:
    parameters = {p.name: p for p in lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)}
    linear = dict(zip(candidate.linear, estimate, strict=True))
    starts = []
    for factor in (1.0, 0.4):
        values = []
        for name in candidate.names:
            p = parameters[name]
            guess = linear.get(name, 0.0) * (factor if p.default == 0 else 0.0) + p.default
            if candidate.effect == "payload" and name in "xyz":
                mass = linear.get("mass", 1.0) or 1.0
                body = screen.simulator.case.model.body(candidate.place[0])
                guess = p.default + float(np.clip(linear.get(name, 0.0) * body.mass[0] / mass, -0.3, 0.3))
            if p.bounds[0] == 0 and guess < 0.1 * p.step:
                guess = 0.3 * p.step * factor
            values.append(float(guess))
        starts.append(values)
    first = parameters[candidate.names[0]]
    if first.bounds[0] == 0:  # one-sided effects are the least linear: start small and large too
        for factor in (0.25, 1.0, 2.0):
            starts.append([factor * first.step, *starts[0][1:]])
    done = [v for c in current.causes for v in c.values]
    causes = [*current.causes, Cause(candidate, tuple(starts[0]))]
    return fitter.fit(causes, [[*done, *s] for s in starts[1:]])


def _acceptable(screen: Screen, config: DiagnoseConfig, current: Fit, fit: Fit, trials: list[Trial]) -> bool:
    """Whether the last cause of `fit` is more than noise, more than a small deviation, and holds on unseen runs."""
    gain = current.misfit - fit.misfit
    cause = fit.causes[-1]
    mean, error, positive = heldout(screen, current, fit)
    reasons = []
    if gain < config.min_gain + 2.0 * len(cause.values):
        reasons.append(f"gain {gain:.1f} is within noise")
    if deviation(screen, cause) < config.min_deviation:
        reasons.append("no larger than everyday deviations")
    if len(screen.runs) >= 4 and significance(fit) < 2.0:  # three runs say too little about their own scatter
        reasons.append("within two standard errors of nothing")
    if not holds(mean, error, positive):
        reasons.append("does not hold on unseen runs")
    share = config.min_share if not current.causes else 2 * config.min_share
    left = leftover(screen, current), leftover(screen, fit)
    if (
        np.mean(np.log(left[1] / left[0])) > np.log(1 - LEAST_IMPROVEMENT)
        and left[1].mean() > (1 - LEAST_IMPROVEMENT) * left[0].mean()
    ):
        reasons.append("leaves as much as before")
    if mean < share * max(total_gap(screen, current), 1e-9):
        reasons.append("too small a share of the gap")
    for i in range(len(trials) - 1, -1, -1):
        t = trials[i]
        if (t.effect, t.place, t.names) == cause.candidate.key and t.outcome == "refitted":
            trials[i] = Trial(
                t.effect, t.place, t.names, t.stage, t.linear_gain, t.gain, t.heldout_gain, t.heldout_se, t.values,
                "; ".join(reasons) or "accepted",
            )  # fmt: skip
            break
    return not reasons


def holds(mean: float, error: float, positive: float) -> bool:
    """Whether unseen runs gain: most of them, and on balance (runs excite an effect to very different degrees)."""
    return mean > 0.5 * error and positive >= 0.6


def significance(fit: Fit) -> float:
    """Size of the last cause's best-determined value in its own standard errors."""
    cause = fit.causes[-1]
    count = len(cause.values)
    errors = np.sqrt(np.maximum(np.diag(fit.covariance)[-count:], 1e-30))
    defaults = np.array([0.0 if v else v for v in cause.values])
    return float(np.max(np.abs(np.array(cause.values) - defaults) / errors))


def is_gap(left: F64) -> bool:
    """Whether what stays beside everyday deviations is more than a floor's worth, in most runs or on the whole.

    A single run near a resonance blows up small deviations, so one moderate outlier is no gap.
    """
    return bool(np.median(left) > GATE_MEDIAN or left.mean() > GATE_MEAN)


def deviation(screen: Screen, cause: Cause) -> float:
    """Size of a cause in everyday deviations of its kind (or in tenths of a step, where there are none)."""
    effect = lookup(cause.candidate.effect)
    parameters = {p.name: p for p in effect.parameters(screen.simulator.context, cause.candidate.place)}
    sizes = []
    for name, value in cause.named.items():
        p = parameters[name]
        if p.default == 0.0:
            sizes.append(abs(value) / (p.nuisance or 0.1 * abs(p.step)))
    return float(np.sqrt(np.sum(np.square(sizes)) / 1.0)) if sizes else 0.0


def total_gap(screen: Screen, current: Fit) -> float:
    """Mean misfit a run that the current causes leave: what a further cause could gain."""
    return current.misfit / len(screen.runs)


def heldout(screen: Screen, before: Fit, after: Fit) -> tuple[float, float, float]:
    """(mean, standard error, share positive) of the gain on each run when the nuisances are fitted on the others."""
    count = len(screen.runs)
    if count == 1:
        gain = before.misfit - after.misfit
        return gain, gain / 4, 1.0
    gains = []
    for k in range(count):
        others = [i for i in range(count) if i != k]
        gains.append(_unseen(before, others, k) - _unseen(after, others, k))
    g = np.array(gains)
    return float(g.mean()), float(g.std(ddof=1) / np.sqrt(count)), float((g > 0).mean())


def _unseen(fit: Fit, others: list[int], k: int) -> float:
    e = fit.evidence
    A, b = np.sum([e.A[i] for i in others], axis=0), np.sum([e.b[i] for i in others], axis=0)
    x, _ = posterior(A, b, fit.prior)
    return 0.5 * float(e.c[k] - 2 * e.b[k] @ x + x @ e.A[k] @ x)


# ---------------------------------------------------------------- after the stages


def _without(fitter: Fitter, fit: Fit, i: int, nominal: Fit) -> Fit | None:
    rest = [c for j, c in enumerate(fit.causes) if j != i]
    return fitter.fit(rest) if rest else nominal


def _exchange(screen: Screen, fitter: Fitter, fit: Fit, notes: list[str]) -> Fit:
    """Try every cause's rivals once more beside the others: the first choice was made when they were still missing."""
    if len(fit.causes) < 2:
        return fit
    for i in range(len(fit.causes)):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        beside = fitter.fit(others, iterations=2)
        if beside is None:
            continue
        tried = 0
        for gain, candidate, estimate in ranked(screen, beside):
            if gain <= 0 or tried >= 3:
                break
            if candidate.key == fit.causes[i].candidate.key:
                continue
            tried += 1
            trial = _refit(screen, fitter, beside, candidate, estimate)
            if trial is not None and trial.misfit + _complexity(trial) < fit.misfit + _complexity(fit) - 5.0:
                gone = fit.causes[i].candidate
                notes.append(f"{gone.effect} {', '.join(gone.place)} gave way to {candidate.effect}")
                return _exchange(screen, fitter, trial, notes) if len(notes) < 6 else trial
    return fit


def _prune(screen: Screen, fitter: Fitter, config: DiagnoseConfig, fit: Fit, notes: list[str]) -> Fit:
    """Take out causes that later ones have made superfluous."""
    while len(fit.causes) > 1:
        losses = []
        for i in range(len(fit.causes)):
            less = fitter.fit([c for j, c in enumerate(fit.causes) if j != i])
            if less is not None:
                mean, _, _ = heldout(screen, less, fit)
                small = deviation(screen, fit.causes[i]) < config.min_deviation
                keep = less.misfit - fit.misfit > config.min_gain and mean > 0 and not small
                losses.append((keep, less.misfit - fit.misfit, i, less))
        out = [item for item in losses if not item[0]]
        if not out:
            return fit
        _, loss, i, less = min(out, key=lambda item: item[1])
        gone = fit.causes[i].candidate
        notes.append(f"{gone.effect} {', '.join(gone.place)} was taken out again (loss {loss:.1f})")
        fit = less
    return fit


def _equivalent(
    screen: Screen,
    fitter: Fitter,
    config: DiagnoseConfig,
    fit: Fit,
    nominal: Fit,
    stages: Sequence[tuple[Fit, list[Fit]]],
) -> list[Fit]:
    """Sets that explain the runs as well: each cause exchanged for its rivals, everything refitted."""
    found: dict[tuple, Fit] = {}
    removed = nominal.misfit - fit.misfit
    for i, cause in enumerate(fit.causes):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        for rival in _close_rivals(stages, fit):
            trial = fitter.fit([*others, rival], iterations=3)
            if trial is None:
                continue
            if _as_good(screen, config, fit, trial, removed) and deviation(screen, rival) >= config.min_deviation:
                found.setdefault((cause.candidate.key, rival.candidate.key), trial)
    return sorted(found.values(), key=lambda f: f.misfit)


def _close_rivals(stages: Sequence[tuple[Fit, list[Fit]]], fit: Fit) -> list[Cause]:
    """Rivals that came near the winner of their stage; the others cannot catch up by a joint refit."""
    rivals: dict[tuple, Cause] = {}
    for before, fits in stages:
        best = min(f.misfit for f in fits)
        for f in fits:
            cause = f.causes[-1]
            if f.misfit - best > max(0.15 * (before.misfit - best), 20.0):
                continue
            if any(_same_thing(cause.candidate, c.candidate) for c in fit.causes):
                continue
            rivals.setdefault(cause.candidate.key, cause)
    return list(rivals.values())[:5]


def _same_thing(a: Candidate, b: Candidate) -> bool:
    return (a.effect == b.effect and bool(set(a.place) & set(b.place))) or (a.effect == b.effect and not a.place)


def _as_good(screen: Screen, config: DiagnoseConfig, best: Fit, rival: Fit, removed: float) -> bool:
    """Within a small share of what the best removes, and no run by run preference beyond its scatter."""
    loss = rival.misfit - best.misfit + _complexity(rival) - _complexity(best)
    if loss < 4.0:
        return True
    if _complexity(rival) > _complexity(best):
        return False  # a richer effect that is no better only mimics the simpler one
    mean, error, _ = heldout(screen, rival, best)
    return loss < max(config.equivalent_loss * removed, 8.0) and mean < 2 * error
