"""A candidate refitted by simulation beside the causes that are accepted already: where its search starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

LEVER = 0.3
"""m off a body's centre of mass within which a search for what sits on it begins."""

Guess = F64 | dict[str, float]
"""What a refit starts from: the screen's estimate, or values that were simulated."""


def refit_from(
    screen: Screen, fitter: Fitter, current: Fit, candidate: Candidate, start: Guess, target: float
) -> Fit | None:
    """The candidate beside the current causes: from values that were simulated, or from the screen's estimate."""
    if not isinstance(start, dict):
        return refit(screen, fitter, current, candidate, start, target)
    cause = Cause(candidate, tuple(float(start[n]) for n in candidate.names))
    return fitter.fit([*current.causes, cause], iterations=8, rough=True, coarse=True, target=target)


def refit(
    screen: Screen, fitter: Fitter, current: Fit, candidate: Candidate, estimate: F64, target: float = np.inf
) -> Fit | None:
    """The candidate beside the current causes, from several starts about the screen's estimate; None if none runs.

    Args:
        estimate: (m,) of the candidate's linear parameters.
        target: misfit that must stay in sight for the search to go on.
    """
    plain = next((c for c in current.causes if _contains(candidate, c.candidate)), None)
    if plain is not None:
        return _enriched(screen, fitter, current, plain, candidate, target)
    first, *more = _starts(screen, candidate, estimate)
    done = [v for c in current.causes for v in c.values]
    causes = [*current.causes, Cause(candidate, tuple(first))]
    return fitter.fit(causes, [[*done, *s] for s in more], rough=True, coarse=True, target=target)


def _starts(screen: Screen, candidate: Candidate, estimate: F64) -> list[list[float]]:
    """Values of all the candidate's parameters to begin a search from."""
    effect, context = lookup(candidate.effect), screen.simulator.context
    parameters = {p.name: p for p in effect.parameters(context, candidate.place)}
    linear = dict(zip(candidate.linear, estimate, strict=True))
    starts = []
    for factor in (1.0, 0.4):
        values = []
        for name in candidate.names:
            p, slope = parameters[name], linear.get(name, 0.0)
            guess = p.default + (slope * factor if p.default == 0 else 0.0)
            if p.shape:  # the slope is a shift of the body's centre of mass, by what sits there
                body = screen.simulator.case.model.body(candidate.place[0])
                lever = slope * body.mass[0] / (linear.get("mass", 1.0) or 1.0)
                guess = p.default + float(np.clip(lever, -LEVER, LEVER))
            if p.bounds[0] == 0 and guess < 0.1 * p.step:
                guess = 0.3 * p.step * factor
            values.append(float(guess))
        starts.append(values)
    first = parameters[candidate.names[0]]
    if first.bounds[0] == 0:  # one-sided effects are the least linear: start small and large too
        starts += [[factor * first.step, *starts[0][1:]] for factor in (0.25, 1.0, 2.0)]
    elif effect.scope == "global" and len(candidate.names) == 1:  # slipping sets in at a threshold
        starts += [[factor * first.step] for factor in (0.5, 1.0, 1.5)]
    return starts


def _enriched(
    screen: Screen, fitter: Fitter, current: Fit, plain: Cause, candidate: Candidate, target: float
) -> Fit | None:
    """The richer law in place of the plain one: beside it, both would be friction twice over."""
    full = fullest(screen, candidate) or candidate
    effect = lookup(full.effect)
    parameters = effect.parameters(screen.simulator.context, full.place)
    shared = {p.name: plain.named[p.like[1]] for p in parameters if p.like is not None}
    values = {p.name: p.default for p in parameters} | shared
    others = [c for c in current.causes if c is not plain]
    start = Cause(full, tuple(values[n] for n in full.names))
    return once_more(fitter, replace(current, causes=(*others, start)), target)


def once_more(fitter: Fitter, fit: Fit, target: float) -> Fit | None:
    """A second search from another valley, the best of those that the last cause's effect knows of."""
    cause, others = fit.causes[-1], fit.causes[:-1]
    further = lookup(cause.candidate.effect).further_starts
    valleys = further(cause.named) if further else []
    if not valleys or set(valleys[0]) != set(cause.candidate.names):
        return None
    first, *more = (tuple(values[n] for n in cause.candidate.names) for values in valleys)
    done = [v for c in others for v in c.values]
    starts = [[*done, *values] for values in more]
    return fitter.fit([*others, Cause(cause.candidate, first)], starts, iterations=8, rough=True, target=target)


def fullest(screen: Screen, candidate: Candidate) -> Candidate | None:
    """The same effect at the same place with the most parameters, if that is more than it has."""
    more = [c for c in screen.candidates if nested(c, candidate) and len(c.names) > len(candidate.names)]
    return max(more, key=lambda c: len(c.names)) if more else None


def nested(a: Candidate, b: Candidate) -> bool:
    """Whether one is the other with further parameters."""
    few, many = sorted((set(a.names), set(b.names)), key=len)
    return a.effect == b.effect and a.place == b.place and few <= many


def extended(screen: Screen, cause: Cause, full: Candidate) -> Cause:
    """The cause's values as the start of the fuller form."""
    parameters = lookup(full.effect).parameters(screen.simulator.context, full.place)
    defaults = {p.name: p.default for p in parameters}
    return Cause(full, tuple(cause.named.get(n, defaults[n]) for n in full.names))


def _contains(rich: Candidate, plain: Candidate) -> bool:
    """Whether one law is a richer form of the other, at the same place."""
    return lookup(rich.effect).plain == plain.effect and rich.places == plain.places
