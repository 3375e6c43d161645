"""Which causes: best-first search over sets of them, by one score and four moves (add, drop, exchange, widen).

The neighbours of the best set are fitted: with one cause less, with one more (or a law that contains one of them), with
another one in a cause's place. One that has a lower score, and against which nothing speaks, becomes the best set, and
so on. Where the best set leaves a gap and no neighbour is better, those of the next best sets are fitted as well: what
looks best alone may imitate two others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from realsim.gap.causes.figures import CLEARLY, EXPANSIONS, NAMED_SHARE, RUNNER_SHARE, RUNNERS_UP
from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.leftover import is_gap, leftover
from realsim.gap.causes.proposals import ADD, EXCHANGE, Propose, ranked
from realsim.gap.causes.refine import prepared, refined
from realsim.gap.causes.score import doubts, near, score, searched
from realsim.gap.causes.trials import Trial, screened, trial, with_outcome
from realsim.types import F64

Tick = Callable[[str, float], None]


@dataclass
class Search:
    """Best-first over sets of causes."""

    fitter: Fitter
    most: int
    """Causes of a set."""
    best: Fit
    """The set with the lowest score of those that nothing speaks against."""
    seen: dict[frozenset, Fit] = field(default_factory=dict)
    gap: float = 0.0
    """Mean square above the floor that stays beside everyday deviations alone."""
    expanded: set[frozenset] = field(default_factory=set)
    """Full keys of the sets whose neighbours were fitted."""
    trials: list[Trial] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def run(self, tick: Tick) -> None:
        self._keep(self.best)
        self.trials = screened(ranked(self.fitter.screen, self.best))
        in_vain = 0
        for k in range(EXPANSIONS):
            tick("search for causes", k / EXPANSIONS)
            here = self._next()
            if here is None or in_vain > RUNNERS_UP:
                break
            self.expanded.add(here.full_key)
            in_vain = 0 if self._expand(here) else in_vain + (here.key != self.best.key)
        self.best = prepared(self.fitter, self.best)

    def _next(self) -> Fit | None:
        """The best set; once its neighbours are known and it leaves a gap, the next best that removes something."""
        left = leftover(self.fitter.screen, self.fitter.remeasure(self.best))
        if self._hopeless(left):
            return None
        if self.best.full_key not in self.expanded:
            return self.best
        if not is_gap(left):
            return None
        self.seen = {k: self.fitter.looked_at(f, f.causes) or f for k, f in self.seen.items()}
        nothing = self.seen[frozenset()].misfit
        least = RUNNER_SHARE * (nothing - min(f.misfit for f in self.seen.values()))
        worth = [f for f in self.seen.values() if len(f.causes) < self.most and f.full_key not in self.expanded]
        return min((f for f in worth if nothing - f.misfit > least), key=self._score, default=None)

    def _hopeless(self, left: F64) -> bool:
        """Whether nothing in the library fits: with all the causes that a set may have, each as good as those so far,
        it would still not remove the share of the gap above the floor that causes must to be named."""
        if not self.best.causes:
            self.gap = max(left.mean() - 1, 0.0)
            return False
        stays = (left.mean() - 1) / self.gap if self.gap else 0.0
        return bool(max(stays, 0.0) ** (self.most / len(self.best.causes)) > 1 - NAMED_SHARE)

    def _expand(self, here: Fit) -> bool:
        """Fit a set's neighbours; whether one of them is better than the best set."""
        best = here.key == self.best.key
        here = prepared(self.fitter, here)
        if best:
            self.best = here
            if self._dropped(here):
                return True
        # Each of several causes was chosen while another one was missing: they are exchanged before one more is added.
        for moves in (EXCHANGE, ADD) if len(here.causes) > 1 else (ADD, EXCHANGE):
            if moves is ADD and len(here.causes) < self.most:
                base, fits = refined(self.fitter, *self._fitted(here, ADD))
                if self._better(base if best else self.fitter.remeasure(self.best), fits):
                    return True
            elif moves is EXCHANGE and best and here.causes:
                self.best = here = prepared(self.fitter, here)
                if self._better(here, self._fitted(here, EXCHANGE)[1]):
                    return True
        return False

    def _dropped(self, here: Fit) -> bool:
        """Whether a cause is superfluous beside the others; the one that brings least is looked at first."""
        if len(here.causes) < 2:
            return False
        fits = [self.fitter.fit(here.causes[:i] + here.causes[i + 1 :]) for i in range(len(here.causes))]
        for less in sorted((f for f in fits if f is not None), key=self._score):
            if said := doubts(self.fitter, less, here)[0]:
                self._replace(less, "; ".join(said))
                return True
        return False

    def _fitted(self, here: Fit, moves: Sequence[Propose]) -> tuple[Fit, list[Fit]]:
        """(a set, fits of its neighbours by score), beside nuisance parameters that no cause has bent yet."""
        fitter, screen = self.fitter, self.fitter.screen
        fits: list[Fit] = []
        known: set[tuple] = set()
        with fitter.nuisances_reset():
            base = fitter.looked_at(here, here.causes) or here if moves is ADD else here
            aim = near(self.seen[frozenset()].misfit - base.misfit)
            for p in (p for propose in moves for p in propose(fitter, base)):
                what = tuple(c.candidate.key for c in p.causes)
                if what in known and not p.starts:
                    continue
                known.add(what)
                if moves is ADD:
                    least = min((searched(screen, f) for f in fits), default=np.inf)
                    target = least + near(searched(screen, base) - least)
                    fit = fitter.fit(p.causes, p.starts, 8, rough=True, coarse=True, target=target)
                else:
                    still = not screen.simulator.context.touches
                    fit = fitter.fit(p.causes, p.starts, 8, target=base.misfit + aim, nearer=still)
                if fit is not None:
                    fits.append(fit)
                    self._keep(fit)
                    self.trials += [trial(base, fit, p.foretold)] if moves is ADD else []
        return base, sorted(fits, key=self._score)

    def _better(self, before: Fit, fits: Sequence[Fit]) -> bool:
        """Whether one of the fits takes the place of the best set."""
        for fit in fits:
            if self._score(before) - self._score(fit) < CLEARLY:
                break
            said, held = doubts(self.fitter, before, fit) if len(fit.causes) > len(before.causes) else ([], None)
            self.trials = with_outcome(self.trials, fit, "; ".join(said) or "accepted", held)
            if not said:
                self._replace(fit, "")
                return True
        return False

    def _replace(self, fit: Fit, why: str) -> None:
        gone = [c.candidate for c in self.best.causes if c.candidate.key not in {o.candidate.key for o in fit.causes}]
        self.notes += [f"{c.effect} {', '.join(c.place)} was taken out again {why}".strip() for c in gone]
        self.best = fit
        self._keep(fit)

    def _keep(self, fit: Fit) -> None:
        old = self.seen.get(fit.key)
        if old is None or old.evidence.version != fit.evidence.version or self._score(fit) < self._score(old):
            self.seen[fit.key] = fit

    def _score(self, fit: Fit) -> float:
        return score(self.fitter.screen, fit)
