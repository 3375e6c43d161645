"""What a set is measured against before its neighbours are fitted, and a second fit of those near the best."""

from __future__ import annotations

from functools import partial

import numpy as np

from realsim.gap.causes.figures import FINALISTS, NEIGHBOURS, SHARPEST, TOO_LONG
from realsim.gap.causes.fit import Fit, Fitter
from realsim.gap.causes.leftover import is_gap, leftover
from realsim.gap.causes.score import asked, near, score
from realsim.gap.causes.windows import adjusted, at_other_bodies
from realsim.gap.evidence.onsets import find_onsets
from realsim.gap.simulation.simulate import lookup


def prepared(fitter: Fitter, fit: Fit) -> Fit:
    """The set under weights that follow from what it leaves, with slopes about its causes.

    The discrepancy between robot and model is estimated with each set. Else a large gap would be fitted by absurd
    values of many nuisance parameters, since sensors are so precise that their prior does not count.
    """
    screen = fitter.screen
    simulator, context = screen.simulator, screen.simulator.context
    settings = fit.settings()
    if fit.causes:
        if not simulator.onsets:  # a lasting cause drowns a push until it is known
            simulator.onsets = find_onsets(screen.comparison, simulator.simulate(settings), screen.runs)
        finer = context.timestep / simulator.edited(settings).spec.option.timestep
        if len(context.driven) * finer < TOO_LONG:
            screen.relinearise(settings)
        fit = fitter.with_likelier_solver(fitter.remeasure(fit))
    fit = fitter.reweighted(fit)
    left = leftover(screen, fit)
    if is_gap(left):
        return fitter.reset_nuisances(fit)
    if not fit.causes:
        fitter.slight = True  # nuisance parameters could explain it: no large gap drowns a smaller cause
    elif not fitter.slight:
        share = float(np.sqrt(left.mean()))  # half way: what stays is in part no noise
        screen.comparison.sharpen(float(np.clip(share, SHARPEST, 1.0)))
        fit = fitter.remeasure(fit)
    return fit


def refined(fitter: Fitter, base: Fit, fits: list[Fit]) -> tuple[Fit, list[Fit]]:
    """(a set, its neighbours, the lowest score first) once more, under weights for what the best neighbour leaves.

    Beside a large gap every tolerance is wide, and rivals look alike that the small rest tells apart.
    """
    screen = fitter.screen
    gap = is_gap(leftover(screen, base))
    if not gap:  # the weights stay as they are: what would not win if it came much nearer is not looked at again
        now, least = score(screen, base), asked(base)
        fits = [f for f in fits if now - score(screen, f) + near(base.misfit - f.misfit) > least]
    if not fits:
        return base, fits
    jagged = screen.simulator.context.touches
    close = [f for f in fits if f.misfit - fits[0].misfit <= near(base.misfit - fits[0].misfit)][:FINALISTS]
    names = fits[0].causes[-1].candidate.names
    if "since" in names or ("start" in names and jagged):  # what lifts a foot or starts a swing, no slope foretells
        here = adjusted(fitter, fits[0])
        close += [here, *(adjusted(fitter, f) for f in at_other_bodies(screen, fitter, here))]
    if gap:
        fitter.reweighted(fits[0])
        again = [fit for f in close if (fit := _anew(fitter, f)) is not None] or [fitter.remeasure(fits[0])]
    else:
        with fitter.nuisances_reset():
            again = [fitter.with_own_nuisances(f, rounds=2) for f in close]
    return fitter.remeasure(base), sorted(again, key=partial(score, screen))


def _anew(fitter: Fitter, fit: Fit) -> Fit | None:
    """The set fitted again; where feet slip and land from several strengths, beside its own nuisance parameters."""
    screen = fitter.screen
    if not screen.simulator.context.touches:
        return fitter.fit(fit.causes, rough=True)
    *others, cause = fit.causes
    parameters = lookup(cause.candidate.effect).parameters(screen.simulator.context, cause.candidate.place)
    strength = {p.name for p in parameters if p.strength}
    done = [v for c in others for v in c.values]
    starts = [
        [*done, *(v * factor if name in strength else v for name, v in cause.named.items())] for factor in NEIGHBOURS
    ]
    with fitter.nuisances_reset():
        again = fitter.fit(fit.causes, starts, rough=True)
        return again and fitter.with_own_nuisances(again, rounds=2)
