"""A second look at the best neighbours of a set, where everyday deviations hide what a cause does."""

from __future__ import annotations

from collections.abc import Sequence

from realsim.gap import figures
from realsim.gap.effects.nuisances import MANY_JOINTS
from realsim.gap.inference.causes.fit import Fit, Fitter
from realsim.gap.inference.causes.leftover import is_gap, leftover
from realsim.gap.inference.causes.score import asked, near, score


def second_look(fitter: Fitter, here: Fit, fits: Sequence[Fit]) -> tuple[Fit, list[Fit]]:
    """(a set, its best neighbours) under weights for what the best one leaves: beside a large gap every one looks good
    enough. Each stands beside its own everyday deviations.

    Args:
        fits: neighbours of the set `here`, the lowest score first.
    """
    screen, simulator = fitter.screen, fitter.screen.simulator
    if not fits or (len(simulator.case.joint_names) < MANY_JOINTS and not simulator.context.touches):
        return here, list(fits)  # few deviations hide nothing: slopes tell them from causes
    if not is_gap(leftover(screen, here)):  # weights hardly change: only what comes near can win
        least = asked(screen, here) if len(fits[0].causes) > len(here.causes) else figures.CLEARLY
        before = score(screen, here)
        fits = [f for f in fits if before - score(screen, f) + near(here.misfit - f.misfit) > least]
        if not fits:
            return here, []
    # Of each effect its best place, or places of one effect would be all that is looked at.
    ways = {tuple(c.candidate.effect for c in f.causes): f for f in reversed(fits)}
    best = sorted(ways.values(), key=lambda f: score(screen, f))[: figures.PLACES]
    settled = [fitter.settled(f) for f in (here, *best)]
    fitter.reweighted(min(settled[1:], key=lambda f: score(screen, f)))
    # Deviations have many optima, above all where feet land: the set itself may have those that its neighbours found.
    heres = [settled[0], *filter(None, (fitter.beside_those(f, here) for f in settled[1:]))]
    here = min(map(fitter.remeasure, heres), key=lambda f: f.misfit)
    if not here.causes:  # beside those there may be no gap
        screen.gap = is_gap(leftover(screen, here))
    again = map(fitter.remeasure, settled[1:])
    return here, sorted(again, key=lambda f: score(screen, f))
