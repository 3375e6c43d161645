"""Values from which a fit begins, and how the forms of a law contain each other."""

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.base import Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fitted import Cause
from realsim.gap.inference.likelihood.screen import Candidate, Key, Screen
from realsim.gap.simulation.simulate import Simulator

Guess = F64 | dict[str, float]
"""What a fit begins from: the linear screen's estimate, or values that were simulated."""


def starts(screen: Screen, candidate: Candidate, guess: Guess) -> list[list[float]]:
    """Values of all the candidate's parameters, about the screen's estimate or as they were simulated."""
    if isinstance(guess, dict):
        return [[float(guess[n]) for n in candidate.names]]
    linear = dict(zip(candidate.linear, guess, strict=True))
    found = []
    for factor in (1.0, 0.4):
        values = []
        for p in candidate.parameters:
            slope = linear.get(p.name, 0.0)
            value = p.default + (slope * factor if p.default == 0 else 0.0)
            if p.shape:  # the slope is a shift of the body's centre of mass, by what sits there
                body = screen.simulator.case.model.body(candidate.place[0])
                lever = slope * body.mass[0] / (linear.get("mass", 1.0) or 1.0)
                value = p.default + float(np.clip(lever, -figures.LEVER, figures.LEVER))
            if p.bounds[0] == 0 and value < 0.1 * p.step:
                value = 0.3 * p.step * factor
            values.append(float(value))
        found.append(values)
    first = candidate.parameters[0]
    if first.bounds[0] == 0:  # one-sided effects are the least linear: start small and large too
        found += [[factor * first.step, *found[0][1:]] for factor in (0.25, 1.0, 2.0)]
    elif lookup(candidate.effect).scope == "global" and len(candidate.names) == 1:  # slipping sets in at a threshold
        found += [[factor * first.step] for factor in (0.5, 1.0, 1.5)]
    return found


def suggested(screen: Screen, cause: Cause) -> list[tuple[Candidate, list[list[float]]]]:
    """(candidate, values to begin from) of what may stand in a cause's place: the same with all its parameters, and
    what its effect suggests."""
    own = cause.candidate
    found: dict[Key, tuple[Candidate, list[list[float]]]] = {}
    more = [c for c in screen.candidates if nested(c, own) and len(c.names) > len(own.names)]
    for full in sorted(more, key=lambda c: -len(c.names))[:1]:
        found[full.key] = full, [[cause.named.get(p.name, p.default) for p in full.parameters]]
    for other in lookup(own.effect).rivals.suggest(screen.simulator.context, own.place, cause.named):
        for c in screen.candidates:
            if (c.effect, c.place) == (other.effect, other.place) and set(c.names) == set(other.values):
                found.setdefault(c.key, (c, []))[1].append([other.values[n] for n in c.names])
    return list(found.values())


def twins(simulator: Simulator, effect: str, place: Place, values: dict[str, float]) -> list[str]:
    """Effects that do exactly the same at this place with these values, so that no score tells them apart: of a robot
    that begins at rest, joints alone do not tell late commands from late readings."""
    if any(start.reads_the_log for start in simulator.starts):
        return []
    others = lookup(effect).rivals.suggest(simulator.context, place, values)
    return [o.effect for o in others if o.effect != effect and (o.place, o.values) == (place, values)]


def nested(a: Candidate, b: Candidate) -> bool:
    """Whether one is the other with further parameters."""
    few, many = sorted((set(a.names), set(b.names)), key=len)
    return a.effect == b.effect and a.place == b.place and few <= many


def contains(rich: Candidate, plain: Candidate) -> bool:
    """Whether one law holds the other as a special case, at the same place."""
    return lookup(rich.effect).rivals.special_case == plain.effect and rich.places == plain.places
