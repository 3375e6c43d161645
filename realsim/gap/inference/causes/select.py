"""From the linear screen to the causes: the search, and what each cause brings."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from realsim.gap import figures
from realsim.gap.config import DiagnoseConfig
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import Trial, imitates
from realsim.gap.inference.causes.score import alike, determined, holds, left_out, near, score
from realsim.gap.inference.causes.search import Search, Tick
from realsim.gap.inference.causes.starts import contains
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import OutOfTime


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
    fitter: Fitter
    """Under the conditions that all of them are compared under."""
    cut_short: bool = False
    """Whether time was over before all was compared: `fit` is the best so far."""


def select(fitter: Fitter, config: DiagnoseConfig, tick: Tick = lambda what, share: None) -> Selection:
    """Causes of the gap on the screened runs."""
    nothing = fitter.nominal()
    with suppress(OutOfTime):
        nothing = fitter.with_likelier_solver(nothing)
    search = Search(fitter.under_those_of(nothing), config.max_causes, nothing, cut_short=fitter.screen.cut_short)
    search.run(tick)
    fitter = search.fitter
    try:
        nominal, best, equivalent, gains = _compared(search, nothing)
    except OutOfTime:
        search.cut_short = True
    fitter.screen.simulator.stop_after(np.inf)  # what is still to be done takes little
    if search.cut_short:
        nominal, best = fitter.looked_at(nothing, ()) or nothing, search.best
        equivalent, gains = list[Fit](), dict[int, float]()
    if best.causes:
        best = fitter.reweighted(best)
        fitter = fitter.under(weights=best.conditions.weights)
        best, nominal = fitter.spread(best), fitter.remeasure(nominal)
    if len(fitter.screen.runs) == 1 and best.causes:
        search.notes.append("a single run: no cause could be held against a run that is left out")
    return Selection(best, nominal, search.trials, equivalent, gains, search.notes, fitter, search.cut_short)


def _compared(search: Search, nothing: Fit) -> tuple[Fit, Fit, list[Fit], dict[int, float]]:
    """(no cause at all, the best set, the others that explain the runs alike, what is lost without each cause of the
    best), if there is time."""
    fitter, gains = search.fitter, {}
    nominal = fitter.looked_at(nothing, ()) or nothing
    best, equivalent = _alike(search, nominal)
    if (apart := by_joint(fitter, best)) is not None:
        search.notes.append("a value that joints shared was replaced by one a joint")
        best, equivalent = apart, []
    for i in range(len(best.causes)):
        rest = [c for j, c in enumerate(best.causes) if j != i]
        less = fitter.fit(rest, few=fitter.rough(best, every=True)) if rest else nominal
        gains[i] = less.misfit - best.misfit if less is not None else 0.0
    return nominal, best, equivalent, gains


def by_joint(fitter: Fitter, fit: Fit) -> Fit | None:
    """The set with a value a joint where one was shared by a few, if the runs call for it: that is no further cause, so
    only its parameters have a price. None where they do not, or where nothing is shared."""
    parts = [_parts(fitter.screen, c) for c in fit.causes]
    causes = [one for cause, found in zip(fit.causes, parts, strict=True) for one in (found or [cause])]
    apart = fitter.fit(causes) if len(causes) > len(fit.causes) else None
    if apart is None:
        return None
    apart, fit = fitter.spread(apart), fitter.spread(fit)
    gain = fit.misfit - apart.misfit - figures.PRICE * (determined(apart) - determined(fit))
    return apart if gain > figures.CLEARLY and holds(left_out(fitter, fit, apart)) else None


def _parts(screen: Screen, cause: Cause) -> list[Cause]:
    """The same cause at each of its places; empty where they are one, or many."""
    own = cause.candidate
    if not 2 <= len(own.places) <= figures.APART:
        return []
    alone = {
        c.places[0]: c
        for c in screen.candidates
        if c.effect == own.effect and c.names == own.names and len(c.places) == 1
    }
    found = [Cause(alone[p], cause.values) for p in own.places if p in alone]
    return found if len(found) == len(own.places) else []


def _alike(search: Search, nominal: Fit) -> tuple[Fit, list[Fit]]:
    """(the set with the lowest score, the others that explain the runs alike), all under the same weights."""
    fitter, best = search.fitter, search.fitter.spread(search.best)
    if not best.causes:
        return best, []
    removed = nominal.misfit - best.misfit
    others = [f for k, f in search.seen.items() if k != best.key and len(f.causes) == len(best.causes)]
    again = (fitter.looked_at(f, f.causes) for f in others)
    others = [f for f in again if f is not None and f.misfit - best.misfit < near(removed)]
    # Their values were found under other weights, and on some of the runs: at their best, all are compared.
    others = [
        min(fitter.fit(f.causes, (), 3, fitter.rough(f, every=True)) or f, f, key=lambda f: f.misfit) for f in others
    ]
    same = [best, *(f for f in others if alike(fitter, best, f, removed))]
    best, *rest = _in_order(fitter, same)
    return fitter.spread(best), rest


def _in_order(fitter: Fitter, same: Sequence[Fit]) -> list[Fit]:
    """The lowest score first, those that imitate last; without laws that hold another one with a lower score as a
    special case, which always fit as well. What holds another one as a special case comes after it: runs that were left
    out need no more."""
    kept: list[Fit] = []
    for fit in sorted(same, key=lambda f: (imitates(f), score(fitter, f))):
        if not any(_richer(fit, better) for better in kept):
            kept.append(fit)
    order = list[Fit]()
    for fit in kept:
        plainer = [other for other in kept if _richer(fit, other)]
        order += [f for f in (*plainer, fit) if all(f is not done for done in order)]
    return order


def _richer(fit: Fit, other: Fit) -> bool:
    """Whether a set is the other one with a law in a cause's place that holds it as a special case."""
    ours, theirs = (
        [c.candidate for c in a.causes if not b.has(c.candidate.effect, c.candidate.place)]
        for a, b in ((fit, other), (other, fit))
    )
    return bool(ours) and all(any(contains(c, o) for o in theirs) for c in ours)
