"""Which causes: forward selection with backward removal, decided by unseen runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from realsim.gap.causes.equivalent import equivalents, likelier, simplest
from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.fitted import Z90
from realsim.gap.causes.hidden import FAR, NEARLY_ALL, hidden, needed
from realsim.gap.causes.leftover import leftover
from realsim.gap.causes.merit import complexity, deviation, heldout, holds, is_gap, total_gap
from realsim.gap.causes.pairs import better_pair, joint_pair
from realsim.gap.causes.rivals import Trial, duel, ranked, refit, refitted
from realsim.gap.causes.screen import Screen
from realsim.gap.config import DiagnoseConfig
from realsim.gap.evidence.onsets import find_onsets

STEADY = 3.0
"""A gain this many times its standard error, on runs left out in turn, counts however small its share."""
SHARPEST = 0.3
"""Least share of the allowance that is left after a cause."""
SLIGHT = 5.0
"""Mean square in units of the floor below which a gap is hardly one."""
VERY_MANY_JOINTS = 20
"""Driven joints from which on slopes are taken once only."""
LEAST_IMPROVEMENT = 0.08
"""Share of what is left that a further cause must remove."""


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
    current = fitter.switched(nominal)
    trials: list[Trial] = []
    notes: list[str] = []
    stages: list[tuple[Fit, list[Fit]]] = []
    small = False  # whether small deviations could hide the gap from the first: no large one then drowns smaller causes
    for stage in range(config.max_causes):
        if len(current.causes) == config.max_causes:
            break
        tick(f"selection, cause {stage + 1}", stage / config.max_causes)
        current = fitter.tighten(current)
        if not is_gap(leftover(screen, current)):
            small = small or not stage
            current = current if small else sharpened(screen, fitter, current)
            fits = hidden(screen, fitter, current, stage, trials)
            if not fits:
                notes.append("what is left is within the floor and the small deviations")
                break
            stages.append((current, fits))
            current = straightened(fitter, fits[0])
            current = beside(screen, fitter, current)
            continue
        current = fitter.unbend(current)
        fits = refitted(screen, fitter, config, current, stage, trials)
        if not fits:
            break
        current, fits = duel(screen, fitter, current, fits)
        if stage == len(current.causes) == 1 and (
            pair := better_pair(screen, fitter, nominal, current, stages[0][1], fits, trials)
        ):
            notes.append(
                f"{', '.join(c.candidate.effect for c in pair[1][0].causes)} together beat what was best alone"
            )
            current, fits = pair
        best = next((f for f in fits if _acceptable(screen, fitter, config, current, f, trials)), None)
        if best is None and not stage and config.max_causes > 1:
            alone, pairs = joint_pair(screen, fitter, current, fits, trials) or (current, [])
            good = (f for f in pairs if _acceptable(screen, fitter, config, alone, f, trials))
            best = next((f for f in good if holds(*heldout(screen, current, f))), None)
            if best is not None:
                stages.append((current, fits))
                current, fits = alone, pairs
        if best is None:
            break
        stages.append((current, fits))
        current = best
        look_for_onsets(screen, current)
        current = beside(screen, fitter, current)
    current = fitter.tighten(current)
    current = current if small else sharpened(screen, fitter, current)
    nominal = fitter.remeasure(nominal)
    if current.causes:
        current = fitter.fit(current.causes) or current
        current = _exchange(screen, fitter, current, notes)
    current = _prune(screen, fitter, config, current, notes)
    current = fitter.spread(current)
    equivalent = equivalents(screen, fitter, config, current, nominal, stages) if current.causes else []
    current, equivalent = likelier(*simplest(current, equivalent))
    gains = {}
    for i in range(len(current.causes)):
        less = _without(fitter, current, i, nominal)
        gains[i] = less.misfit - current.misfit if less is not None else 0.0
    if current.causes:
        current, nominal = fitter.spread(fitter.tighten(current)), fitter.remeasure(nominal)
    return Selection(current, nominal, trials, equivalent, gains, notes)


def look_for_onsets(screen: Screen, fit: Fit) -> None:
    """Moments at which something sudden begins beside these causes; a lasting one drowns a push until it is known."""
    simulator = screen.simulator
    if not simulator.onsets:
        simulator.onsets = find_onsets(screen.comparison, simulator.simulate(fit.settings()))


def beside(screen: Screen, fitter: Fitter, fit: Fit) -> Fit:
    """The fit where slopes are taken about its own causes, and the solver is the likelier one beside them.

    Of very many joints that would take as long as all the rest.
    """
    if len(screen.simulator.context.driven) < VERY_MANY_JOINTS:
        screen.look_from(fit.settings())
    return fitter.switched(fitter.remeasure(fit))


def straightened(fitter: Fitter, fit: Fit) -> Fit:
    """The fit without small deviations that were bent to imitate its causes while those were missing."""
    straight = fitter.unbend(fit)
    return fit if straight is fit else fitter.fit(straight.causes) or straight


def without_causes(selection: Selection) -> Selection:
    """The same search that came to nothing: what it found does not hold."""
    found = ", ".join(dict.fromkeys(c.candidate.effect for c in selection.fit.causes))
    note = f"{found} fits best, and makes the unseen run worse: no cause"
    return replace(selection, fit=selection.nominal, equivalent=[], gains={}, notes=[*selection.notes, note])


def sharpened(screen: Screen, fitter: Fitter, fit: Fit) -> Fit:
    """The fit under weights that its own leftover justifies; without a cause the allowance stays as it is.

    What is allowed for in any good simulator is too much for most. Beside one cause that explains a large gap, a
    smaller one would go under in it.
    """
    if fit.causes:
        left = float(np.sqrt(leftover(screen, fit).mean()))  # half way: what stays is in part no noise
        screen.comparison.sharpen(float(np.clip(left, SHARPEST, 1.0)))
        fit = fitter.remeasure(fit)
    return fit


def _acceptable(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, current: Fit, fit: Fit, trials: list[Trial]
) -> bool:
    """Whether the last cause of `fit` is more than noise, more than a small deviation, and holds on unseen runs."""
    gain = current.misfit - fit.misfit
    cause = fit.causes[-1]
    mean, error, positive = heldout(screen, current, fit)
    reasons = []
    if gain < config.min_gain + 2.0 * len(cause.values):
        reasons.append(f"gain {gain:.1f} is within noise")
    if deviation(screen, cause) < config.min_deviation:
        reasons.append("no larger than everyday deviations")
    if not fitter.clear(fit)[-1]:
        reasons.append("too few standard errors off nothing")
    if not holds(mean, error, positive):
        reasons.append("does not hold on unseen runs")
    share = config.min_share if not current.causes else 2 * config.min_share
    left = leftover(screen, current), leftover(screen, fit)
    if (
        np.mean(np.log(left[1] / left[0])) > np.log(1 - LEAST_IMPROVEMENT)
        and left[1].mean() > (1 - LEAST_IMPROVEMENT) * left[0].mean()
    ):
        reasons.append("leaves as much as before")
    steady = mean > STEADY * error and gain > STEADY * config.min_gain
    # Of a slight gap most is noise, of which no cause takes a share: what would do where there is none does here.
    far = deviation(screen, cause) >= FAR and positive >= NEARLY_ALL and gain > needed(screen, cause)
    slight = left[0].mean() < SLIGHT and far
    if mean < share * max(total_gap(screen, current), 1e-9) and not (steady or slight):
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
            trial = refit(screen, fitter, beside, candidate, estimate)
            if trial is None:
                continue
            better = fit.misfit + complexity(screen, fit) - trial.misfit - complexity(screen, trial)
            if better > 5.0:
                gone = fit.causes[i].candidate
                notes.append(f"{gone.effect} {', '.join(gone.place)} gave way to {candidate.effect}")
                return _exchange(screen, fitter, trial, notes) if len(notes) < 6 else trial
    return fit


def _prune(screen: Screen, fitter: Fitter, config: DiagnoseConfig, fit: Fit, notes: list[str]) -> Fit:
    """Take out causes that later ones have made superfluous, or that lie too near to nothing beside them."""
    while len(fit.causes) > 1:
        losses = []
        clear = fitter.clear(fit, of_few=Z90)  # no cause is named whose own interval holds nothing
        for i in range(len(fit.causes)):
            less = fitter.fit([c for j, c in enumerate(fit.causes) if j != i])
            if less is not None:
                mean, _, _ = heldout(screen, less, fit)
                small = deviation(screen, fit.causes[i]) < config.min_deviation
                keep = less.misfit - fit.misfit > config.min_gain and mean > 0 and not small and clear[i]
                losses.append((keep, less.misfit - fit.misfit, i, less))
        out = [item for item in losses if not item[0]]
        if not out:
            return fit
        _, loss, i, less = min(out, key=lambda item: item[1])
        gone = fit.causes[i].candidate
        notes.append(f"{gone.effect} {', '.join(gone.place)} was taken out again (loss {loss:.1f})")
        fit = less
    return fit
