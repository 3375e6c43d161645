"""The score of a set of causes, what speaks against a further cause, and when two sets explain the runs alike."""

from dataclasses import replace

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.base import Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fit import Fit, Fitter
from realsim.gap.inference.causes.fitted import acts_for, imitates, leftover
from realsim.gap.inference.causes.starts import contains, twins
from realsim.gap.inference.likelihood.screen import Screen

Held = tuple[float, float]
"""(mean, standard error) of a gain on runs that are left out in turn."""


def score(fitter: Fitter, fit: Fit) -> float:
    """Penalised misfit of a set in nats, lower is better: half the weighted squares that stay beside the nuisance
    parameters, and the price of causes, of parameters that the data determine, of shared values and of rare effects.
    Where deviations leave a gap there is a cause, and the first one costs what it takes to say which."""
    screen, total = fitter.screen, fit.misfit + figures.PRICE * determined(fit)
    if fit.causes:
        dear = figures.CAUSE + figures.CAUSE_A_JOINT * len(screen.simulator.case.joint_names)
        first = float(np.log(len(screen.candidates))) if fitter.conditions.gap else dear
        total += first + (len(fit.causes) - 1) * dear
    total += figures.SHARED * sum(len(c.candidate.places) > 1 for c in fit.causes)
    return total + figures.PRICE * sum(lookup(c.candidate.effect).rivals.commoner is not None for c in fit.causes)


def bent(before: Fit, fit: Fit) -> float:
    """Nats that a set counts less, beside others, where one of its causes imitates something."""
    return figures.IMITATION * max(before.misfit - fit.misfit, 0.0) if imitates(fit) else 0.0


def determined(fit: Fit) -> float:
    """How many parameters the data determine: a force across a planar arm is none."""
    sizes = np.array([2 * p.step for c in fit.causes for p in c.candidate.parameters])
    return float(np.clip(1 - np.diag(fit.covariance) / sizes**2, 0.0, 1.0).sum())


def least_gain(fitter: Fitter, before: Fit) -> float:
    """Nats by which one more cause must lower the score of a set: clearly, and beside others by a share of what is no
    noise, since each of them leaves a little that a wrong one can bend to. Feet that slip and land differ from a
    simulator's by many nats whatever stays, so there it is a share of all, for a first cause, too. Where deviations
    leave a gap, the likeliest first cause is looked at: the check says whether it is one."""
    gap, touches = fitter.conditions.gap, fitter.screen.simulator.context.touches
    if not before.causes and (gap or not touches):
        return 0.0 if gap else figures.CLEARLY
    noise = 0.0 if touches else 1 / max(leftover(fitter.screen, before).mean(), 1.0)
    return max(figures.CLEARLY, figures.SHARE * before.misfit * (1 - noise))


def doubts(fitter: Fitter, before: Fit, after: Fit) -> tuple[list[str], Held | None]:
    """(what speaks against the last cause of `after`: it gains too little, or not on runs that are left out, as must a
    law that contains the one whose place it takes; its gain on those)."""
    if any(acts_for(c) < figures.BRIEF for c in after.causes if c.candidate.key not in before.full_key):
        return [f"acts for less than {figures.BRIEF:g} s of a run, as an error of its start does"], None
    if len(after.causes) <= len(before.causes):
        if not any(contains(after.causes[-1].candidate, c.candidate) for c in before.causes):
            return [], None
        held = left_out(fitter, before, after)
        return [] if holds(held) else ["runs left out in turn do not need the richer law"], held
    found = []
    gain, least = score(fitter, before) - score(fitter, after), least_gain(fitter, before)
    gain -= bent(before, after) if before.causes else 0.0  # beside others it would bend their values, too
    if gain < least:
        found.append(f"gains {gain:.1f} nats, must gain {least:.1f}")
    held = left_out(fitter, before, after)
    # Deviations imitate a first cause on runs left out as well as on the others, at their price: the check is on it,
    # without them. Feet may slip with it in some runs only.
    alone = not before.causes and not fitter.screen.simulator.context.touches
    if not (alone or holds(held)):
        found.append("does not hold on runs left out in turn")
    return found, held


def left_out(fitter: Fitter, before: Fit, after: Fit) -> Held | None:
    """What a set gains over another on runs left out in turn, each fitted to the others. None of a single run."""
    return gained(*map(fitter.left_out, (before, after))) if len(fitter.screen.runs) > 1 else None


def gained(before: F64, after: F64) -> Held:
    """(mean, standard error) over runs of the logarithm of the ratio of errors: one run that diverges counts once."""
    gains = np.log(np.maximum(before, 1e-9) / np.maximum(after, 1e-9))
    return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else 0.0


def holds(held: Held | None, least: float = 0.0) -> bool:
    """Whether runs left out in turn need what gains so much on them, as a logarithm."""
    return held is None or held[0] > max(figures.HOLDS * held[1], least)


def alike(fitter: Fitter, best: Fit, rival: Fit, removed: float) -> bool:
    """Whether the runs do not tell a rival from the best set, of which `removed` is the gain over no cause."""
    screen = fitter.screen
    loss = score(fitter, rival) - score(fitter, best)
    if _kinds(screen, best) == _kinds(screen, rival):  # between the steps of a simulator, not even twins are the same
        return True
    if loss < figures.CLEARLY or loss >= figures.EQUAL * removed:
        return loss < figures.CLEARLY
    held = left_out(fitter, rival, best)
    return held is None or not holds(held)


def _kinds(screen: Screen, fit: Fit) -> set[tuple[str, tuple[Place, ...]]]:
    """Effects at places; twins have one name."""
    found = [(c.candidate, twins(screen.simulator, c.candidate.effect, c.candidate.place, c.named)) for c in fit.causes]
    return {(min([c.effect, *same]), c.places) for c, same in found}


def near(gain: float) -> float:
    """Nats within which a fit can still catch up with the best of its kind, which gains so much."""
    return max(figures.NEAR_SHARE * gain, figures.NEAR) if np.isfinite(gain) else np.inf


def searched(fitter: Fitter, fit: Fit) -> float:
    """Misfit on the runs that a rough fit looks at."""
    screen, few = fitter.screen, fitter.screen.varied
    given = replace(fitter.conditions, about=fit.about)
    seen = fit.predictions if few is None else [fit.predictions[k] for k in few]
    return screen.misfit(screen.evidence(seen, given, few), fit.prior / fit.scale)[0]
