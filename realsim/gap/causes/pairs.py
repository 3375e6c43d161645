"""Two causes at once: what looks best alone may be neither of them.

A cause that is chosen while another is still missing is chosen to imitate both. Where one cause leaves a gap, the
runners-up of the first stage are therefore tried as first causes too, each with the partners that suit it best.
"""

from __future__ import annotations

from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.merit import complexity
from realsim.gap.causes.rivals import Trial, near, ranked, refit, searched, tried
from realsim.gap.causes.screen import Screen

RUNNERS_UP, PARTNERS = 3, 3
"""At most so many other first causes, and so many partners of each."""
LEAST_SHARE = 0.25
"""A runner-up alone removes at least this share of what the winner removed."""
CLEARLY = 5.0
"""Log-likelihood by which a pair must beat the best one that holds the winner."""


def better_pair(
    screen: Screen, fitter: Fitter, nominal: Fit, winner: Fit, first: list[Fit], second: list[Fit], trials: list[Trial]
) -> tuple[Fit, list[Fit]] | None:
    """(a runner-up alone, fits of two causes that hold it, best first), if they clearly beat the winner's pairs.

    `first`: the fits of the first stage, best first. `second`: those of two causes, the winner among them.
    """
    nominal = fitter.remeasure(nominal)
    best = min([winner, *second], key=lambda f: _price(screen, f))
    found: tuple[Fit, list[Fit]] | None = None
    for alone in _runners_up(fitter, nominal, fitter.remeasure(winner), first):
        partners: set[str] = set()
        fits = []
        for gain, candidate, estimate in ranked(screen, alone):
            if len(partners) == PARTNERS or gain <= 0:
                break
            if candidate.effect in partners or _holds(winner, candidate.effect, candidate.place):
                continue
            partners.add(candidate.effect)
            aim = searched(screen, best)
            fit = refit(screen, fitter, alone, candidate, estimate, aim + near(searched(screen, alone) - aim))
            if fit is not None:
                trials.append(tried(screen, alone, fit, 1, gain))
                fits.append(fit)
        fits.sort(key=lambda f: _price(screen, f))
        if fits and _price(screen, fits[0]) < _price(screen, best) - CLEARLY:
            best, found = fits[0], (alone, fits)
    return found


def _runners_up(fitter: Fitter, nominal: Fit, winner: Fit, first: list[Fit]) -> list[Fit]:
    """The best fit of each further effect, under the present weights."""
    seen = {(winner.causes[-1].candidate.effect, winner.causes[-1].candidate.place)}
    found = []
    for fit in first:
        cause = fit.causes[-1].candidate
        if (cause.effect, cause.place) in seen:
            continue
        seen.add((cause.effect, cause.place))
        again = fitter.remeasure(fit)
        if nominal.misfit - again.misfit > LEAST_SHARE * (nominal.misfit - winner.misfit):
            found.append(again)
        if len(found) == RUNNERS_UP:
            break
    return found


def _price(screen: Screen, fit: Fit) -> float:
    return fit.misfit + complexity(screen, fit)


def _holds(fit: Fit, effect: str, place: tuple[str, ...]) -> bool:
    return any(c.candidate.effect == effect and c.candidate.place == place for c in fit.causes)
