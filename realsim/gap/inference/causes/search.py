"""Which causes: a search over sets of them, by one score and three moves (drop, add, exchange).

The neighbours of the best set are fitted: with one cause less, with one more, with another one or a richer law in a
cause's place. One that has a lower score, and against which nothing speaks, becomes the best set, and so on.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.inference.causes.fit import Fit, Fitter
from realsim.gap.inference.causes.fitted import EffectSet, Trial, exchanged, imitates, is_gap, leftover
from realsim.gap.inference.causes.gauss_newton import Few
from realsim.gap.inference.causes.proposals import ADD, EXCHANGE, Proposal, Propose, ranked
from realsim.gap.inference.causes.score import bent, doubts, least_gain, near, score, searched
from realsim.gap.inference.likelihood.screen import Key
from realsim.gap.simulation.simulate import OutOfTime

Tick = Callable[[str, float], None]


@dataclass
class Search:
    """From one set of causes to a better neighbour, as long as there is one."""

    fitter: Fitter
    most: int
    """Causes of a set."""
    best: Fit
    """The set with the lowest score of those that nothing speaks against."""
    seen: dict[EffectSet, Fit] = field(default_factory=dict)
    gap: float = 0.0
    """Mean square above the floor that stays beside everyday deviations alone."""
    trials: list[Trial] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    cut_short: bool = False
    """Whether time was over before the search came to its end."""
    _looked_at: tuple[Fit, list[Fit]] | None = None
    """A set, and its neighbours so far, while they are fitted."""

    def run(self, tick: Tick) -> None:
        """Search until no neighbour is better, or until the simulator's time is over: then the best so far counts."""
        try:
            self._search(tick)
        except OutOfTime:
            self.cut_short = True
            here, fits = self._looked_at or (self.best, [])
            nearest = min(fits, key=self._score, default=here)
            if self._score(here) - self._score(nearest) > figures.CLEARLY:
                self.best = nearest

    def _search(self, tick: Tick) -> None:
        self._keep(self.best)
        best: dict[str, Trial] = {}
        for gain, c, _ in ranked(self.fitter.screen, self.best):
            best.setdefault(c.effect, Trial(c, 0, gain, "screened"))
        self.trials = list(best.values())
        expanded: set[frozenset[Key]] = set()
        better = True
        while better:
            tick("search for causes", len(expanded) / (len(expanded) + 3))
            new = self.best.full_key not in expanded  # else with better values, so that another cause may help it now
            expanded.add(self.best.full_key)
            if self._hopeless(leftover(self.fitter.screen, self.fitter.remeasure(self.best))):
                break
            # A poor law, or a cause that was chosen while another one was missing, is exchanged before one is added.
            better = (new and (self._dropped() or self._moved(EXCHANGE))) or (
                self._calls_for_more() and self._moved(ADD)
            )
        self._prepare()
        if self.best.causes:  # what was found on some of the runs, on all of them
            self.best = self.fitter.fit(self.best.causes) or self.best
            self._keep(self.best)

    def _prepare(self, further: bool = False) -> Fit:
        """The best set under weights of its residual, which are kept for all alternatives."""
        self.best = self.fitter.prepared(self.best, further)
        self.fitter = self.fitter.under_those_of(self.best)
        return self.best

    def _hopeless(self, left: F64) -> bool:
        """Whether nothing in the library fits: with all the causes that a set may have, each as good as those so far,
        it would still not remove the share of the gap above the floor that causes must to be named."""
        if not self.best.causes:
            self.gap, self.fitter = max(left.mean() - 1, 0.0), self.fitter.under(gap=is_gap(left))
            return False
        stays = (left.mean() - 1) / self.gap if self.gap else 0.0
        return bool(max(stays, 0.0) ** (self.most / len(self.best.causes)) > 1 - figures.NAMED_SHARE)

    def _calls_for_more(self) -> bool:
        """Whether a further cause is looked for: among many deviations only where those so far leave a gap. Beside
        none, on legs, as many wrong causes were found as right ones (one each), in the time of the first search."""
        if not (self.best.causes and self.fitter.screen.crowded):
            return True
        return is_gap(leftover(self.fitter.screen, self._prepare()))

    def _dropped(self) -> bool:
        """Whether a cause is superfluous beside the others; the one that brings least is looked at first."""
        if len(self.best.causes) < 2:
            return False
        here = self._prepare()
        few = self.fitter.rough(here, every=True)
        fits = [self.fitter.fit(here.causes[:i] + here.causes[i + 1 :], few=few) for i in range(len(here.causes))]
        for less in sorted((f for f in fits if f is not None), key=self._score):
            if objections := doubts(self.fitter, less, here)[0]:
                self._replace(less, "; ".join(objections))
                return True
        return False

    def _moved(self, moves: Sequence[Propose]) -> bool:
        """Fit the neighbours of the best set that some moves lead to; whether one of them takes its place."""
        further = moves is ADD
        if len(self.best.causes) == (self.most if further else 0):
            return False
        screen, here = self.fitter.screen, self._prepare(further)
        if screen.simulator.context.touches and not here.causes:  # now deviations are simulated: do they leave a gap?
            here = self.best = here.under(gap=is_gap(leftover(screen, here)))
            self.fitter = self.fitter.under_those_of(here)
        fits, few = list[Fit](), self.fitter.rough(here, every=not further)
        self._looked_at = here, fits
        proposed, at_once = self._proposed(moves, here), 1
        while now := list(islice(proposed, at_once)):
            # Of many further causes each is looked at roughly; what would not catch up with the best is broken off, or
            # not begun where that takes long.
            least = min((searched(self.fitter, f) for f in fits), default=np.inf) if further else here.misfit
            before = searched(self.fitter, here) if further else self.seen[frozenset()].misfit
            target = least + near(before - least)
            now = [p for p in now if p.misfit <= target or not screen.slow]
            found = self.fitter.each(partial(self._fitted, few=few, target=target), now)
            for p, fit in zip(now, found, strict=True):
                if fit is None:
                    continue
                fits.append(fit)
                self._keep(fit)
                if further:
                    c, gain = fit.causes[-1], here.misfit - fit.misfit
                    self.trials.append(Trial(c.candidate, len(here.causes), p.foretold, gain=gain, values=c.values))
            at_once = figures.AT_ONCE if screen.slow else 1
        here, fits = second_look(self.fitter, here, sorted(fits, key=self._score))
        self.fitter, self._looked_at = self.fitter.under_those_of(here), (here, fits)
        for fit in fits:
            self._keep(fit)
        better, self._looked_at = self._better(here, fits), None
        return better

    def _fitted(self, p: Proposal, few: Few, target: float) -> Fit | None:
        return self.fitter.fit(p.causes, p.starts, 8, few, target)

    def _proposed(self, moves: Sequence[Propose], here: Fit) -> Iterator[Proposal]:
        """Neighbours of a set; of those that begin from the linear estimate alone, each once."""
        known: set[tuple[Key, ...]] = set()
        for p in (p for propose in moves for p in propose(self.fitter, here)):
            what = tuple(c.candidate.key for c in p.causes)
            if what not in known or p.starts:
                yield p
            known.add(what)

    def _better(self, before: Fit, fits: Sequence[Fit]) -> bool:
        """Whether one of the fits takes the place of the best set; beside no gap one that imitates only where no other
        may."""
        least = figures.CLEARLY if before.causes else least_gain(self.fitter, before)
        gap = self.fitter.conditions.gap
        for fit in sorted(fits, key=lambda f: (not gap and imitates(f), self._score(f) + bent(before, f))):
            if self._score(before) - self._score(fit) < least:
                continue
            objections, held = doubts(self.fitter, before, fit)
            for trial in [t for t in self.trials if t.candidate.key == fit.causes[-1].candidate.key][-1:]:
                trial.outcome, trial.held = "; ".join(objections) or "accepted", held
            if not objections:
                if len(fit.causes) == len(before.causes):
                    self.trials.append(exchanged(self.trials, before, fit))
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
        return score(self.fitter, fit)


def second_look(fitter: Fitter, here: Fit, fits: Sequence[Fit]) -> tuple[Fit, list[Fit]]:
    """(a set, its best neighbours) under weights for what the best one leaves: beside a large gap every one looks good
    enough. Each is beside its own everyday deviations; the conditions of the set hold for what follows.

    Args:
        fits: neighbours of the set `here`, the lowest score first.
    """
    screen = fitter.screen
    if not fits or not screen.crowded:
        return here, list(fits)  # few deviations hide nothing: slopes tell them from causes
    if not is_gap(leftover(screen, here)):  # weights hardly change: only what comes near can win
        least = least_gain(fitter, here) if len(fits[0].causes) > len(here.causes) else figures.CLEARLY
        before = score(fitter, here)
        fits = [f for f in fits if before - score(fitter, f) + near(here.misfit - f.misfit) > least]
        if not fits:
            return here, []
    # Of each effect its best place, or places of one effect would be all that is looked at.
    ways = {tuple(c.candidate.effect for c in f.causes): f for f in reversed(fits)}
    best = sorted(ways.values(), key=partial(score, fitter))[: figures.PLACES]
    most = score(fitter, best[0]) + near(here.misfit - best[0].misfit)
    close = [f for f in best if score(fitter, f) <= most]  # the others would not catch up
    settled = [fitter.settled(f) for f in (here, *close)]
    fitter = fitter.under(weights=fitter.reweighted(min(settled[1:], key=partial(score, fitter))).conditions.weights)
    # Deviations have many optima, above all where feet land: the set itself may have those that its neighbours found.
    heres = [settled[0], *filter(None, (fitter.beside_those(f, here) for f in settled[1:]))]
    here = min(map(fitter.remeasure, heres), key=lambda f: f.misfit)
    if not here.causes:  # beside those there may be no gap
        here = here.under(gap=is_gap(leftover(screen, here)))
    again = map(fitter.remeasure, (*settled[1:], *best[len(close) :]))
    return here, sorted(again, key=partial(score, fitter.under_those_of(here)))
