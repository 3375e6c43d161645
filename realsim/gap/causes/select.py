"""From the linear screen to the causes: the search, and what each cause brings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.search import Search, Tick
from realsim.gap.causes.trials import Trial as Trial
from realsim.gap.config import DiagnoseConfig


@dataclass
class Selection:
    """What the search came to."""

    fit: Fit
    nominal: Fit
    trials: list[Trial]
    equivalent: list[Fit]
    """Other sets that explain the runs alike."""
    gains: dict[int, float]
    """Loss in log-likelihood without cause i of the fit."""
    notes: list[str]


def select(screen: Screen, fitter: Fitter, config: DiagnoseConfig, tick: Tick = lambda what, share: None) -> Selection:
    """Causes of the gap on the screened runs."""
    nothing = fitter.switched(fitter.nominal())
    search = Search(fitter, config.max_causes, nothing)
    search.run(tick)
    nominal = fitter.remeasure(nothing)
    best, equivalent = search.conclude(nominal)
    gains = {}
    for i in range(len(best.causes)):
        rest = [c for j, c in enumerate(best.causes) if j != i]
        less = fitter.fit(rest) if rest else nominal
        gains[i] = less.misfit - best.misfit if less is not None else 0.0
    if best.causes:
        best, nominal = fitter.spread(fitter.tighten(best)), fitter.remeasure(nominal)
    if len(screen.runs) == 1 and best.causes:
        search.notes.append("a single run: no cause could be held against a run that is left out")
    return Selection(best, nominal, search.trials, equivalent, gains, search.notes)


def without_causes(selection: Selection) -> Selection:
    """The same search that came to nothing: what it found does not hold."""
    found = ", ".join(dict.fromkeys(c.candidate.effect for c in selection.fit.causes))
    note = f"{found} fits best, and makes the unseen run worse: no cause"
    return replace(selection, fit=selection.nominal, equivalent=[], gains={}, notes=[*selection.notes, note])
