"""Forward selection: causes are accepted one after the other, while what they leave calls for one more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.hidden import FAR, NEARLY_ALL, hidden, needed
from realsim.gap.causes.leftover import leftover
from realsim.gap.causes.merit import deviation, heldout, holds, is_gap, total_gap
from realsim.gap.causes.pairs import better_pair, joint_pair
from realsim.gap.causes.rivals import Trial, duel, refitted
from realsim.gap.causes.screen import Screen
from realsim.gap.config import DiagnoseConfig
from realsim.gap.evidence.onsets import find_onsets

STEADY = 3.0
"""A gain this many times its standard error, on runs left out in turn, counts however small its share."""
SHARPEST = 0.3
"""Least share of the allowance that is left after a cause."""
SLIGHT = 5.0
"""Mean square in units of the floor below which a gap is hardly one."""
TOO_LONG = 25
"""Driven joints, times how much finer a law makes the time step, from which on slopes are taken once only."""
LEAST_IMPROVEMENT = 0.08
"""Share of what is left that a further cause must remove."""


@dataclass
class Forward:
    """Forward selection: cause after cause, as long as one more is called for."""

    screen: Screen
    fitter: Fitter
    config: DiagnoseConfig
    nominal: Fit
    trials: list[Trial] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stages: list[tuple[Fit, list[Fit]]] = field(default_factory=list)
    """(causes so far, fits with one more, best first) of every stage that found one."""

    def run(self, current: Fit, tick: Callable[[str, float], None]) -> Fit:
        small = False  # whether small deviations could hide the gap from the first: no large one drowns smaller causes
        for stage in range(self.config.max_causes):
            if len(current.causes) == self.config.max_causes:
                break
            tick(f"selection, cause {stage + 1}", stage / self.config.max_causes)
            current = self.fitter.tighten(current)
            if is_gap(leftover(self.screen, current)):
                current = self.fitter.unbend(current)
                further = self.gross(current, stage)
            else:
                small = small or not stage
                current = current if small else sharpened(self.screen, self.fitter, current)
                further = self.hidden(current, stage)
            if further is None:
                break
            current = beside(self.screen, self.fitter, further)
        current = self.fitter.tighten(current)
        return current if small else sharpened(self.screen, self.fitter, current)

    def hidden(self, current: Fit, stage: int) -> Fit | None:
        """One more cause of a gap that small deviations could hide."""
        fits = hidden(self.screen, self.fitter, current, stage, self.trials)
        if not fits:
            self.notes.append("what is left is within the floor and the small deviations")
            return None
        self.stages.append((current, fits))
        return straightened(self.fitter, fits[0])

    def gross(self, current: Fit, stage: int) -> Fit | None:
        """One more cause of a gap that nothing small explains, or two at once."""
        fits = refitted(self.screen, self.fitter, self.config, current, stage, self.trials)
        if not fits:
            return None
        current, fits = duel(self.screen, self.fitter, current, fits)
        if stage == len(current.causes) == 1:
            first = self.stages[0][1]
            pair = better_pair(self.screen, self.fitter, self.nominal, current, first, fits, self.trials)
            if pair:
                named = ", ".join(c.candidate.effect for c in pair[1][0].causes)
                self.notes.append(f"{named} together beat what was best alone")
                current, fits = pair
        further = self.accept(current, fits)
        if further is None and not stage and self.config.max_causes > 1:
            further = self.joint(current, fits)
        if further is not None:
            look_for_onsets(self.screen, further)
        return further

    def joint(self, nothing: Fit, alone: list[Fit]) -> Fit | None:
        """Two causes at once, where none of those `alone` would do."""
        pair = joint_pair(self.screen, self.fitter, nothing, alone, self.trials)
        if pair is None:
            return None
        before, fits = pair
        further = self.accept(before, [f for f in fits if holds(*heldout(self.screen, nothing, f))])
        if further is not None:
            self.stages.insert(0, (nothing, alone))
        return further

    def accept(self, current: Fit, fits: list[Fit]) -> Fit | None:
        """The best acceptable one; its stage is noted."""
        for fit in fits:
            if _acceptable(self.screen, self.fitter, self.config, current, fit, self.trials):
                self.stages.append((current, fits))
                return fit
        return None


def look_for_onsets(screen: Screen, fit: Fit) -> None:
    """Moments at which something sudden begins beside these causes; a lasting one drowns a push until it is known."""
    simulator = screen.simulator
    if not simulator.onsets:
        simulator.onsets = find_onsets(screen.comparison, simulator.simulate(fit.settings()))


def beside(screen: Screen, fitter: Fitter, fit: Fit) -> Fit:
    """The fit where slopes are taken about its own causes, and the solver is the likelier one beside them.

    Of very many joints, or of many at a finer time step, that would take as long as all the rest.
    """
    context = screen.simulator.context
    finer = context.timestep / screen.simulator.edited(fit.settings()).spec.option.timestep
    if len(context.driven) * finer < TOO_LONG:
        screen.look_from(fit.settings())
    return fitter.switched(fitter.remeasure(fit))


def straightened(fitter: Fitter, fit: Fit) -> Fit:
    """The fit without small deviations that were bent to imitate its causes while those were missing."""
    straight = fitter.unbend(fit)
    return fit if straight is fit else fitter.fit(straight.causes) or straight


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
