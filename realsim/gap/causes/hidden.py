"""A gap that everyday deviations could hide: many small ones fit the runs, but one cause is far likelier.

The gate asks what stays beside the small deviations. With dozens of them free, each within its usual size, a modest
cause can be shared out among them until nothing stays. What it costs them to be all off at once is in the misfit, so
the evidence still tells: here a cause must bring much more than elsewhere, and hold on nearly every run.

On robots of few joints it need only do no harm there: what a robot's own deviations imitate on the fitted runs they
imitate on the others, so unseen runs decide nothing, and few deviations are known well enough to believe their price.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from realsim.gap.causes.fit import ENOUGH, Cause, Fit, Fitter
from realsim.gap.causes.merit import deviation, heldout, holds, price
from realsim.gap.causes.probes import Probe, probed_footing
from realsim.gap.causes.refits import Guess, refit_from
from realsim.gap.causes.rivals import Trial, outstanding, ranked
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.simulation.nuisances import MANY_JOINTS
from realsim.types import F64

WORTH_TRYING = 10.0
"""Gain in log-evidence by the linear screen from which on a candidate is simulated."""
TRIED = 5
"""At most so many effects are simulated, the best place of each."""
SURE, SURE_A_JOINT = 10.0, 2.5
"""Gain in log-likelihood that it must then bring, beside its price: the first, and the second a joint.

A servo's unmodelled form is worth some on every joint, and more joints have more small deviations to bend.
"""
FAR = 4.0
"""Everyday deviations of its own kind that it must exceed."""
NEARLY_ALL = 0.75
"""Share of the unseen runs that must gain; of few runs two of three, if it brings twice what it must."""


def hidden(screen: Screen, fitter: Fitter, current: Fit, stage: int, trials: list[Trial]) -> list[Fit]:
    """Fits with one further cause that is far likelier than the small deviations alone, best first."""
    found = []
    joints = len(screen.simulator.case.joint_names)
    for gain, candidate, start in worth_trying(screen, fitter, current):
        fit = refit_from(screen, fitter, current, candidate, start, np.inf)
        if fit is None or current.misfit - fit.misfit < gain:
            with fitter.unbent():  # deviations that imitate it would leave it only what they do not
                straight = refit_from(screen, fitter, current, candidate, start, np.inf)
                if straight is not None and isinstance(start, dict):  # nor do slopes foretell what suits it
                    straight = fitter.settled(straight, rounds=2)
            fit = min((f for f in (fit, straight) if f is not None), key=lambda f: f.misfit, default=None)
        if fit is None:
            continue
        mean, error, positive = heldout(screen, current, fit)
        cause = fit.causes[-1]
        brings = current.misfit - fit.misfit
        least = needed(screen, cause)
        few = len(screen.runs) < ENOUGH and brings > 2 * least
        held = holds(mean, error, positive) and (positive >= NEARLY_ALL or few)
        sure = (
            brings > least
            and deviation(screen, cause) >= FAR
            and fitter.clear(fit)[-1]
            and (held or (joints < MANY_JOINTS and mean > -error))
        )
        outcome = "accepted" if sure else "small deviations explain it as well"
        where = (candidate.effect, candidate.place, candidate.names)
        trials.append(Trial(*where, stage, gain, brings, mean, error, cause.named, outcome))
        if sure:
            found.append(fit)
    return sorted(found, key=partial(price, screen))


def worth_trying(screen: Screen, fitter: Fitter, current: Fit) -> list[tuple[float, Candidate, Guess]]:
    """The best place of each effect that the linear screen favours, what explains much by itself, what lifts a foot."""
    best: dict[str, tuple[float, Candidate, F64]] = {}
    for found in ranked(screen, current):
        if found[0] < WORTH_TRYING or len(best) == TRIED:
            break
        best.setdefault(found[1].effect, found)
    taken = [*best, *(c.candidate.effect for c in current.causes)]
    by_slopes = [*best.values(), *outstanding(screen, current, taken)]
    known = {c.key for _, c, _ in by_slopes}
    return [*by_slopes, *(f for f in _footing(screen, fitter, current) if f[1].key not in known)]


def _footing(screen: Screen, fitter: Fitter, current: Fit) -> list[Probe]:
    """What slopes do not foretell: an encoder that sets a foot higher, beside deviations that are not bent to it."""
    if not screen.simulator.context.touches:
        return []
    with fitter.unbent():
        straight = fitter.looked_at(current, current.causes)
        free = [c for c in screen.candidates if not current.has(c.effect, c.place)]
        return probed_footing(screen, fitter, straight, free) if straight else []


def needed(screen: Screen, cause: Cause) -> float:
    """Log-likelihood that a cause must bring to be far likelier than small deviations that do the same."""
    return SURE + SURE_A_JOINT * len(screen.simulator.case.joint_names) + 2.0 * len(cause.values)
