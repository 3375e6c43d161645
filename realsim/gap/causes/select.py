"""Which causes: those that forward selection came to, exchanged, pruned, and set beside their rivals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from realsim.gap.causes.equivalent import equivalents, likelier, simplest
from realsim.gap.causes.exchange import exchanged
from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.fitted import Z90
from realsim.gap.causes.forward import Forward
from realsim.gap.causes.merit import deviation, heldout, no_better
from realsim.gap.causes.rivals import Trial
from realsim.gap.causes.screen import Screen
from realsim.gap.config import DiagnoseConfig


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
    forward = Forward(screen, fitter, config, nominal)
    current = forward.run(fitter.switched(nominal), tick)
    notes = forward.notes
    nominal = fitter.remeasure(nominal)
    if current.causes:
        # A superfluous cause bends the others, and would be exchanged for what is superfluous too: it goes first.
        before = _prune(screen, fitter, config, fitter.fit(current.causes) or current, notes)
        current = exchanged(screen, fitter, before, notes)
        if current is not before:
            current = _prune(screen, fitter, config, current, notes)
        nominal = fitter.remeasure(nominal)
    current = fitter.spread(current)
    equivalent = equivalents(screen, fitter, config, current, nominal, forward.stages) if current.causes else []
    least = no_better(screen, nominal.misfit - current.misfit)
    current, equivalent = likelier(*simplest(current, equivalent, least))
    gains = {}
    for i in range(len(current.causes)):
        less = _without(fitter, current, i, nominal)
        gains[i] = less.misfit - current.misfit if less is not None else 0.0
    if current.causes:
        current, nominal = fitter.spread(fitter.tighten(current)), fitter.remeasure(nominal)
    return Selection(current, nominal, forward.trials, equivalent, gains, notes)


def without_causes(selection: Selection) -> Selection:
    """The same search that came to nothing: what it found does not hold."""
    found = ", ".join(dict.fromkeys(c.candidate.effect for c in selection.fit.causes))
    note = f"{found} fits best, and makes the unseen run worse: no cause"
    return replace(selection, fit=selection.nominal, equivalent=[], gains={}, notes=[*selection.notes, note])


def _without(fitter: Fitter, fit: Fit, i: int, nominal: Fit) -> Fit | None:
    rest = [c for j, c in enumerate(fit.causes) if j != i]
    return fitter.fit(rest) if rest else nominal


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
