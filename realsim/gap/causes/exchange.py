"""Causes exchanged once all are known: the first choice was made when the others were still missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain

from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.forward import beside
from realsim.gap.causes.leftover import leftover
from realsim.gap.causes.merit import CLEARLY, price
from realsim.gap.causes.probes import Probe, probed, probed_footing, probed_ground
from realsim.gap.causes.refits import refit, refit_from
from realsim.gap.causes.rivals import near, ranked, searched
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.effects.base import Place
from realsim.gap.simulation.simulate import lookup

MOST_EXCHANGES = 3
"""By each way of finding a better one; what goes on being exchanged has no right cause among those known."""
TRIED = 3
"""Rivals of each cause by the linear screen."""
CLEAN = 1.2
"""Mean square in units of the floor above which the right causes leave hardly anything, on the ground too."""

Step = Callable[[Screen, Fitter, Fit, int], Fit | None]


def exchanged(screen: Screen, fitter: Fitter, fit: Fit, notes: list[str]) -> Fit:
    """Every cause's rivals once more beside the others, as long as one is clearly better than the cause."""
    if len(fit.causes) > 1:
        fit = _as_long_as(_by_slopes, screen, fitter, fit, notes)
    if screen.simulator.context.touches:
        fit = _as_long_as(_by_simulation, screen, fitter, fit, notes)
    return fit


def _as_long_as(better: Step, screen: Screen, fitter: Fitter, fit: Fit, notes: list[str]) -> Fit:
    """The fit after exchanges, each of which began the round of its causes anew."""
    i = exchanges = 0
    while i < len(fit.causes) and exchanges < MOST_EXCHANGES:
        other = better(screen, fitter, fit, i)
        if other is None:
            i += 1
            continue
        gone, came = fit.causes[i].candidate, other.causes[-1].candidate
        notes.append(f"{_said(gone)} gave way to {_said(came)}")
        # On the ground a robot beside another cause hardly answers as before.
        fit = fitter.tighten(beside(screen, fitter, other)) if screen.simulator.context.touches else other
        i, exchanges = 0, exchanges + 1
    return fit


def _said(candidate: Candidate) -> str:
    return " ".join([candidate.effect, ", ".join(candidate.place)]).strip()


def _by_slopes(screen: Screen, fitter: Fitter, fit: Fit, i: int) -> Fit | None:
    """A fit that is clearly better with another cause in the place of the i-th, one that slopes name."""
    rest = fitter.fit(_others(fit, i), iterations=2)
    if rest is None:
        return None
    target = _in_sight(screen, fitter, fit, rest)
    own = fit.causes[i].candidate.key
    worth = [(c, estimate) for gain, c, estimate in ranked(screen, rest) if gain > 0 and c.key != own]
    for candidate, estimate in worth[:TRIED]:
        trial = refit(screen, fitter, rest, candidate, estimate, target)
        if trial is not None and price(screen, fit) - price(screen, trial) > CLEARLY:
            return trial
    return None


def _by_simulation(screen: Screen, fitter: Fitter, fit: Fit, i: int) -> Fit | None:
    """The same, of those that simulation names.

    Where feet slip and land, slopes foretell little and a search ends in the first dent. Causes that leave more than
    the floor are then hardly the right ones: those whose small deviations stand out without the cause are looked at.
    What sets a foot higher is always tried in the place of what does the like.
    """
    cause = fit.causes[i].candidate
    unclean = leftover(screen, fit).mean() > CLEAN
    if not (unclean or _moves_a_foot(cause)):
        return None
    best = None
    with fitter.unbent():  # small deviations that suit the cause would speak against its rivals
        rest = fitter.looked_at(fit, _others(fit, i))
        if rest is None:
            return None
        target = _in_sight(screen, fitter, fit, rest)
        free = [c for c in screen.candidates if c.key != cause.key and not rest.has(c.effect, c.place)]
        found = chain(
            probed_ground(screen, fitter, rest, free),
            probed_footing(screen, fitter, rest, free),
            probed(screen, fitter, rest, []) if unclean else [],
        )
        for _, candidate, start in _once(found):
            if candidate not in free:
                continue
            trial = refit_from(screen, fitter, rest, candidate, start, target)
            trial = trial and fitter.settled(trial, rounds=2)
            if trial is not None and (best is None or price(screen, trial) < price(screen, best)):
                best = trial
    return best if best is not None and price(screen, fit) - price(screen, best) > CLEARLY else None


def _in_sight(screen: Screen, fitter: Fitter, fit: Fit, rest: Fit) -> float:
    """Misfit above which a search for another cause beside the `rest` need not go on."""
    aim = searched(screen, fitter.remeasure(fit))
    return aim + near(searched(screen, rest) - aim)


def _others(fit: Fit, i: int) -> list[Cause]:
    return [c for j, c in enumerate(fit.causes) if j != i]


def _moves_a_foot(candidate: Candidate) -> bool:
    effect = lookup(candidate.effect)
    return effect.scope == "terrain" or candidate.names == effect.footing


def _once(probes: Iterable[Probe]) -> Iterator[Probe]:
    seen: set[tuple[str, Place]] = set()
    for probe in probes:
        key = (probe[1].effect, probe[1].place)
        if key not in seen:
            seen.add(key)
            yield probe
