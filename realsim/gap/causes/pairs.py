"""Two causes at once: what looks best alone may be neither of them.

A cause that is chosen while another is still missing is chosen to imitate both. Where one cause leaves a gap, the
runners-up of the first stage are therefore tried as first causes too, each with the partners that suit it best. And
where no cause by itself explains enough of a gap, two together may.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import islice

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.merit import CLEARLY, price
from realsim.gap.causes.refits import refit
from realsim.gap.causes.rivals import Trial, near, ranked, searched, tried
from realsim.gap.causes.screen import Screen
from realsim.gap.effects.base import Place

RUNNERS_UP, PARTNERS = 3, 3
"""At most so many other first causes, and so many partners of each."""
LEAST_SHARE = 0.25
"""A runner-up alone removes at least this share of what the winner removed."""


def better_pair(
    screen: Screen, fitter: Fitter, nominal: Fit, winner: Fit, first: list[Fit], second: list[Fit], trials: list[Trial]
) -> tuple[Fit, list[Fit]] | None:
    """(a runner-up alone, fits of two causes that hold it, best first), if they clearly beat the winner's pairs.

    `first`: the fits of the first stage, best first. `second`: those of two causes, the winner among them.
    """
    nominal, winner = fitter.remeasure(nominal), fitter.remeasure(winner)
    best = min([winner, *second], key=partial(price, screen))
    others = [f for f in _of_each_effect(first) if not winner.has(*_last(f))]
    least = LEAST_SHARE * (nominal.misfit - winner.misfit)
    worthy = (a for a in map(fitter.remeasure, others) if nominal.misfit - a.misfit > least)
    return _best_of(screen, fitter, islice(worthy, RUNNERS_UP), winner, best, trials)


def joint_pair(
    screen: Screen, fitter: Fitter, nominal: Fit, first: list[Fit], trials: list[Trial]
) -> tuple[Fit, list[Fit]] | None:
    """(a cause alone, fits of two causes that hold it, best first) where none is good enough by itself.

    Two that act on one joint in opposite senses, or a late command that a weak damper sets swinging, explain little
    each, and nearly all together.

    Args:
        first: the fits of the first stage, best first.
    """
    alone = islice(_of_each_effect(first), RUNNERS_UP + 1)
    return _best_of(screen, fitter, alone, nominal, first[0], trials)


def _best_of(
    screen: Screen, fitter: Fitter, singles: Iterable[Fit], known: Fit, best: Fit, trials: list[Trial]
) -> tuple[Fit, list[Fit]] | None:
    """(one of the singles, its pairs, best first): the single whose best pair clearly beats all others and `best`.

    Args:
        known: whose causes are no partners: their pairs are known.
    """
    found: tuple[Fit, list[Fit]] | None = None
    for alone in singles:
        partners: set[str] = set()
        fits = []
        for gain, candidate, estimate in ranked(screen, alone):
            if len(partners) == PARTNERS or gain <= 0:
                break
            if candidate.effect in partners or known.has(candidate.effect, candidate.place):
                continue
            partners.add(candidate.effect)
            aim = searched(screen, best)
            fit = refit(screen, fitter, alone, candidate, estimate, aim + near(searched(screen, alone) - aim))
            if fit is not None:
                trials.append(tried(screen, alone, fit, 1, gain))
                fits.append(fit)
        fits.sort(key=partial(price, screen))
        if fits and price(screen, fits[0]) < price(screen, best) - CLEARLY:
            best, found = fits[0], (alone, fits)
    return found


def _of_each_effect(fits: Iterable[Fit]) -> Iterator[Fit]:
    """The first fit of each last cause's effect and place."""
    seen = set()
    for fit in fits:
        if _last(fit) not in seen:
            seen.add(_last(fit))
            yield fit


def _last(fit: Fit) -> tuple[str, Place]:
    candidate = fit.causes[-1].candidate
    return candidate.effect, candidate.place
