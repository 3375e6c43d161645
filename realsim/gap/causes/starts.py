"""Values from which a fit begins, and how the forms of a law contain each other."""

from __future__ import annotations

import numpy as np

from realsim.gap.causes.figures import LEVER
from realsim.gap.causes.fitted import Cause
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

Guess = F64 | dict[str, float]
"""What a fit begins from: the linear screen's estimate, or values that were simulated."""


def starts(screen: Screen, candidate: Candidate, guess: Guess) -> list[list[float]]:
    """Values of all the candidate's parameters, about the screen's estimate or as they were simulated."""
    if isinstance(guess, dict):
        return [[float(guess[n]) for n in candidate.names]]
    effect, context = lookup(candidate.effect), screen.simulator.context
    parameters = {p.name: p for p in effect.parameters(context, candidate.place)}
    linear = dict(zip(candidate.linear, guess, strict=True))
    found = []
    for factor in (1.0, 0.4):
        values = []
        for name in candidate.names:
            p, slope = parameters[name], linear.get(name, 0.0)
            value = p.default + (slope * factor if p.default == 0 else 0.0)
            if p.shape:  # the slope is a shift of the body's centre of mass, by what sits there
                body = screen.simulator.case.model.body(candidate.place[0])
                lever = slope * body.mass[0] / (linear.get("mass", 1.0) or 1.0)
                value = p.default + float(np.clip(lever, -LEVER, LEVER))
            if p.bounds[0] == 0 and value < 0.1 * p.step:
                value = 0.3 * p.step * factor
            values.append(float(value))
        found.append(values)
    first = parameters[candidate.names[0]]
    if first.bounds[0] == 0:  # one-sided effects are the least linear: start small and large too
        found += [[factor * first.step, *found[0][1:]] for factor in (0.25, 1.0, 2.0)]
    elif effect.scope == "global" and len(candidate.names) == 1:  # slipping sets in at a threshold
        found += [[factor * first.step] for factor in (0.5, 1.0, 1.5)]
    return found


def fullest(screen: Screen, candidate: Candidate) -> Candidate | None:
    """The same effect at the same place with the most parameters, if that is more than it has."""
    more = [c for c in screen.candidates if nested(c, candidate) and len(c.names) > len(candidate.names)]
    return max(more, key=lambda c: len(c.names)) if more else None


def suggested(screen: Screen, cause: Cause) -> list[tuple[Candidate, list[list[float]]]]:
    """(candidate, values to begin from) of what the cause's effect suggests in its place."""
    context = screen.simulator.context
    found: dict[tuple, tuple[Candidate, list[list[float]]]] = {}
    for other in lookup(cause.candidate.effect).suggests(context, cause.candidate.place, cause.named):
        for c in screen.candidates:
            if (c.effect, c.place) == (other.effect, other.place) and set(c.names) == set(other.values):
                found.setdefault(c.key, (c, []))[1].append([other.values[n] for n in c.names])
    return list(found.values())


def nested(a: Candidate, b: Candidate) -> bool:
    """Whether one is the other with further parameters."""
    few, many = sorted((set(a.names), set(b.names)), key=len)
    return a.effect == b.effect and a.place == b.place and few <= many


def contains(rich: Candidate, plain: Candidate) -> bool:
    """Whether one law holds the other as a special case, at the same place."""
    return lookup(rich.effect).plain == plain.effect and rich.places == plain.places


def extended(screen: Screen, cause: Cause, full: Candidate) -> Cause:
    """The cause's values as the start of the fuller form."""
    parameters = lookup(full.effect).parameters(screen.simulator.context, full.place)
    defaults = {p.name: p.default for p in parameters}
    return Cause(full, tuple(cause.named.get(n, defaults[n]) for n in full.names))
