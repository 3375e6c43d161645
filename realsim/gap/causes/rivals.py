"""The rivals of one stage: all candidates by the linear screen, the best of them refitted by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.leftover import leftover
from realsim.gap.causes.linear import marginal, score
from realsim.gap.causes.merit import heldout, no_better, price
from realsim.gap.causes.probes import alone, foretold, probed, probed_footing, probed_ground
from realsim.gap.causes.refits import Guess, extended, fullest, nested, once_more, refit_from
from realsim.gap.causes.screen import Candidate, Screen, slab
from realsim.gap.causes.windows import carried, slid, window_candidates
from realsim.gap.config import DiagnoseConfig
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

GROWN = 3
"""The best rivals of a stage are also tried with all their parameters."""

DUELLISTS = 5
NEIGHBOURS = (0.65, 0.8, 0.9, 1.1, 1.25, 1.5)
"""Factors on a cause's strength at which a search begins anew, where feet slip and land: the misfit is jagged."""

MORE = 4
"""So many further effects are refitted where slopes foretell what a cause does."""
MOST_TRIALS = 4000
"""Rows of the ranking table."""

ALONE, MOST_ALONE = 0.3, 2
"""Share of what is left that an effect must explain all by itself to be refitted whatever the screen says, and how many
such effects are."""
MORE_THAN_SMALL = 3.0
"""Mean square in units of the floor from which on they are looked for: less is a matter of small deviations."""


Scored = tuple[float, Candidate, F64]
"""(gain in log-evidence by the linear screen, candidate, estimate of its linear parameters)."""


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


def ranked(screen: Screen, current: Fit) -> list[Scored]:
    """All candidates by the linear evidence they add to `current`, best first."""
    about = [marginal(e, current.prior) for e in screen.centred(current.evidence)]
    least = min(misfit for _, _, misfit in about)
    taken = {(c.candidate.effect, p) for c in current.causes for p in c.candidate.places}
    taken |= {(screen.simulator.twin(effect) or effect, p) for effect, p in taken}
    found = []
    for candidate in screen.candidates:
        if any((candidate.effect, p) in taken for p in candidate.places):
            continue
        size = slab(candidate, screen)
        scored = [(*score(A, b, candidate.directions, size)[:2], misfit - least) for A, b, misfit in about]
        gain, estimate = max(((gain - behind, estimate) for gain, estimate, behind in scored), key=lambda g: g[0])
        found.append((gain, candidate, estimate))
    return sorted(found, key=lambda item: -item[0])


def outstanding(screen: Screen, current: Fit, taken: Sequence[str]) -> list[Scored]:
    """The effects that explain most of what is left all by themselves, the best place of each, best first.

    Beside many small deviations the linear screen may see nothing of a gross cause: to first order they imitate it at a
    price that is small against a large gap, but they would have to be absurd.

    Args:
        taken: effects that need not be looked at.
    """
    total = 0.5 * float(sum(current.evidence.c))
    best: dict[str, Scored] = {}
    for found in alone(screen, current, [c for c in screen.candidates if c.effect not in taken]):
        gain, candidate, _ = found
        if gain > max(ALONE * total, best.get(candidate.effect, (0.0,))[0]):
            best[candidate.effect] = found
    return sorted(best.values(), key=lambda item: -item[0])[:MOST_ALONE]


def refitted(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, current: Fit, stage: int, trials: list[Trial]
) -> list[Fit]:
    """The best candidates of the linear screen, refitted together with what is already accepted; best first."""
    fits: list[Fit] = []

    def keep(fit: Fit, foretold_gain: float) -> None:
        trials.append(tried(screen, current, fit, stage, foretold_gain))
        fits.append(fit)

    for gain, candidate, start in _contenders(screen, fitter, config, current, stage, trials):
        best = min((searched(screen, f) for f in fits), default=np.inf)
        target = best + near(searched(screen, current) - best)
        fit = refit_from(screen, fitter, current, candidate, start, target)
        if fit is None:
            trials.append(
                Trial(candidate.effect, candidate.place, candidate.names, stage, gain, outcome="fails to run")
            )
            continue
        keep(fit, gain)
        again = once_more(fitter, fit, target)
        if again is not None:
            keep(again, gain)
    fits.sort(key=partial(price, screen))
    if fits and _slides(screen, fits[0].causes[-1].candidate):
        here = slid(fitter, fits[0])
        for push in (here, *(slid(fitter, f) for f in carried(screen, fitter, here))):
            moved = fitter.fit(push.causes, iterations=6, rough=True)
            if moved is not None:
                keep(moved, 0.0)
        fits.sort(key=partial(price, screen))
    for fit in fits[:GROWN]:  # with all its parameters an effect may do what the simple form cannot
        full = fullest(screen, fit.causes[-1].candidate)
        if full is not None:
            grown = fitter.fit([*current.causes, extended(screen, fit.causes[-1], full)], iterations=6, rough=True)
            if grown is not None:
                keep(grown, 0.0)
    return sorted(fits, key=partial(price, screen))


def _contenders(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, current: Fit, stage: int, trials: list[Trial]
) -> list[tuple[float, Candidate, Guess]]:
    """What is worth a refit: the finalists of the screen, passing forces, what simulation or sheer size speaks for."""
    order = ranked(screen, current)
    best = order[0][0] if order else 0.0
    by_slopes = foretold(screen, current, best)
    # Far behind the leader by the linear screen, only effects that are far from linear can still win.
    least = max(0.5 * config.min_gain, 0.04 * best)
    finalists, others = _finalists(order, least, config.finalists, config.finalists + (MORE if by_slopes else 0))
    trials += [Trial(c.effect, c.place, c.names, stage, g) for g, c, _ in others[: max(MOST_TRIALS - len(trials), 0)]]
    everything = [c for _, c, _ in order]
    chosen: list[tuple[float, Candidate, Guess]] = [*finalists]
    chosen += [(g, c, v) for g, c, v in window_candidates(screen, current) if not current.has(c.effect, c.place)]
    chosen += [found for found in probed_ground(screen, fitter, current, everything) if found[0] > least]
    chosen += probed_footing(screen, fitter, current, everything)
    if not by_slopes:
        known = {(c.effect, c.place) for _, c, _ in chosen}
        chosen += [p for p in probed(screen, fitter, current, everything) if (p[1].effect, p[1].place) not in known]
    if leftover(screen, current).mean() > MORE_THAN_SMALL:
        taken = [c.effect for _, c, _ in chosen] + [c.candidate.effect for c in current.causes]
        chosen += outstanding(screen, current, taken)
    return chosen


def _finalists(order: list[Scored], least: float, few: int, most: int) -> tuple[list[Scored], list[Scored]]:
    """(finalists, the others) of the screen's order: a `few` by gain, then up to `most` with new effects only."""
    finalists: list[Scored] = []
    others: list[Scored] = []
    for found in order:
        gain, candidate, _ = found
        count = sum(c.effect == candidate.effect for _, c, _ in finalists)
        # The first few take what is best; then every further effect gets its best place, so none is overlooked.
        most_of_it = 1 if len(finalists) >= few else 3 if len(finalists) < 3 else 2
        contained = any(nested(candidate, other) for _, other, _ in finalists)
        if gain > least and len(finalists) < most and count < most_of_it and not contained:
            finalists.append(found)
        else:
            others.append(found)
    return finalists, others


def duel(screen: Screen, fitter: Fitter, current: Fit, fits: list[Fit]) -> tuple[Fit, list[Fit]]:
    """(current, fits) anew: those that came near the best are fitted again where it counts, on what the best leaves.

    Beside a large gap every tolerance is wide, and rivals look alike that the small rest tells apart.
    """
    best = fits[0]
    jagged = screen.simulator.context.touches
    behind = (2 if jagged else 1) * near(current.misfit - best.misfit)
    close = [f for f in fits if f.misfit - best.misfit <= behind][:DUELLISTS]
    if len(close) < 2:
        return current, [_anew(screen, fitter, best) or best, *fits[1:]] if jagged else fits
    fitter.tighten(best)
    again = [fit for f in close if (fit := (_explored if jagged else _anew)(screen, fitter, f)) is not None]
    again = sorted(again or [fitter.remeasure(best)], key=partial(price, screen))
    current = fitter.remeasure(current)
    return current, _plain_first(screen, current, again) if jagged else again


def _plain_first(screen: Screen, current: Fit, fits: list[Fit]) -> list[Fit]:
    """The fits with a plain law before a richer one that is hardly better: it bends to what neither explains."""
    best = fits[0]
    richer = best.causes[-1].candidate
    allowed = no_better(screen, current.misfit - best.misfit)
    for fit in fits[1:]:
        law = fit.causes[-1].candidate
        plain = lookup(richer.effect).plain == law.effect and richer.places == law.places
        if plain and fit.misfit - best.misfit < allowed:
            return [fit, *(f for f in fits if f is not fit)]
    return fits


def _anew(screen: Screen, fitter: Fitter, fit: Fit) -> Fit | None:
    """Its causes fitted again; where feet slip and land, from their neighbours too: a search stops in every dent."""
    starts = _neighbours(screen, fit) if screen.simulator.context.touches else []
    return fitter.fit(fit.causes, starts, iterations=6, rough=True)


def _explored(screen: Screen, fitter: Fitter, fit: Fit) -> Fit | None:
    """The same with small deviations of its own, not with those that suit the best: there, they are jagged too."""
    with fitter.unbent():
        again = _anew(screen, fitter, fit)
        return again and fitter.settled(again, rounds=2)


def _neighbours(screen: Screen, fit: Fit) -> list[list[float]]:
    """Values of all causes in a row, the last one stronger or weaker."""
    *others, cause = fit.causes
    parameters = lookup(cause.candidate.effect).parameters(screen.simulator.context, cause.candidate.place)
    strength = {p.name for p in parameters if p.strength}
    done = [v for c in others for v in c.values]
    return [
        [*done, *(v * factor if name in strength else v for name, v in cause.named.items())] for factor in NEIGHBOURS
    ]


def tried(screen: Screen, current: Fit, fit: Fit, stage: int, gain: float) -> Trial:
    """What is kept of a refitted rival."""
    mean, error, _ = heldout(screen, current, fit)
    cause = fit.causes[-1]
    return Trial(
        cause.candidate.effect, cause.candidate.place, cause.candidate.names, stage, gain,
        current.misfit - fit.misfit, mean, error, cause.named, "refitted",
    )  # fmt: skip


def _slides(screen: Screen, candidate: Candidate) -> bool:
    """Whether slopes may have found a wrong window: what lifts a foot or sets a robot swinging foretells none."""
    names = candidate.names
    return "since" in names or ("start" in names and screen.simulator.context.touches)


def searched(screen: Screen, fit: Fit) -> float:
    """Misfit on the runs that a rough fit looks at."""
    few = screen.varied
    seen = fit.predictions if few is None else [fit.predictions[k] for k in few]
    return screen.misfit(screen.evidence(seen, few, fit.about), fit.prior)


def near(gain: float) -> float:
    """A rival that stays further than this behind the best of a stage cannot catch up by a joint refit."""
    return max(0.15 * gain, 20.0) if np.isfinite(gain) else np.inf
