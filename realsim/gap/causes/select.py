"""From the linear screen to the causes: the search, and what each cause brings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.score import alike, near, score
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.search import Search, Tick
from realsim.gap.causes.starts import contains
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
    nothing = fitter.with_likelier_solver(fitter.nominal())
    search = Search(fitter, config.max_causes, nothing)
    search.run(tick)
    nominal = fitter.remeasure(nothing)
    best, equivalent = _alike(search, nominal)
    gains = {}
    for i in range(len(best.causes)):
        rest = [c for j, c in enumerate(best.causes) if j != i]
        less = fitter.fit(rest) if rest else nominal
        gains[i] = less.misfit - best.misfit if less is not None else 0.0
    if best.causes:
        best, nominal = fitter.spread(fitter.reweighted(best)), fitter.remeasure(nominal)
    if len(screen.runs) == 1 and best.causes:
        search.notes.append("a single run: no cause could be held against a run that is left out")
    return Selection(best, nominal, search.trials, equivalent, gains, search.notes)


def _alike(search: Search, nominal: Fit) -> tuple[Fit, list[Fit]]:
    """(the set with the lowest score, the others that explain the runs alike), all under the same weights."""
    fitter, best = search.fitter, search.fitter.spread(search.best)
    if not best.causes:
        return best, []
    removed = nominal.misfit - best.misfit
    others = [f for k, f in search.seen.items() if k != best.key and len(f.causes) == len(best.causes)]
    again = (fitter.looked_at(f, f.causes) for f in others)
    others = [f for f in again if f is not None and f.misfit - best.misfit < near(removed)]
    same = [best, *(f for f in others if alike(fitter, best, f, removed))]
    best, *rest = sorted(same, key=lambda f: score(fitter.screen, f))
    return fitter.spread(best), [f for f in rest if not _richer(f, best)]


def _richer(fit: Fit, best: Fit) -> bool:
    """Whether a set has a law that holds one of the best set as a special case, and so always fits as well."""
    return any(contains(c.candidate, o.candidate) for c in fit.causes for o in best.causes)


def without_causes(selection: Selection) -> Selection:
    """The same search that came to nothing: what it found does not hold."""
    found = ", ".join(dict.fromkeys(c.candidate.effect for c in selection.fit.causes))
    note = f"{found} fits best, and makes the unseen run worse: no cause"
    return replace(selection, fit=selection.nominal, equivalent=[], gains={}, notes=[*selection.notes, note])
