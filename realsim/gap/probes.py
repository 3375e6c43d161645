"""Candidates looked at by simulation, where slopes at the nominal model foretell nothing.

Whether a foot meets higher ground, no slope foretells. And where a robot swings so far from its simulator that the
two share little, every slope is of another motion than the robot's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice

import numpy as np

from realsim.gap.effects.base import Place
from realsim.gap.fit import Cause, Fit, Fitter
from realsim.gap.screen import Candidate, Screen, score, slab
from realsim.gap.simulate import lookup
from realsim.types import F64

Probe = tuple[float, Candidate, dict[str, float]]
"""(gain in log-likelihood, candidate, values to start from) beside the current causes."""

SIZES = (2.0, 0.7, -0.7, -2.0)
"""Steps of the parameter."""
MOST_GROUND, KEPT_GROUND = 12, 2
"""Places on the terrain that are looked at, and those of them that are worth a fit."""
MOST, KEPT = 60, 5
"""Candidates of any kind that are looked at, and effects of them that are worth a fit."""
FORETOLD = 0.2
"""Share of the misfit that the best candidate must explain by its slopes, for the slopes to be believed."""


def probed_ground(screen: Screen, fitter: Fitter, current: Fit, order: Iterable[Candidate]) -> list[Probe]:
    """The best places for higher or lower ground. `order`: all candidates, those to look at first before the others."""
    single = (c for c in order if lookup(c.effect).scope == "terrain" and len(c.places) == len(c.names) == 1)

    def gain(cause: Cause) -> float:  # a foot may meet the ground in one run only: all of them, at the model's own step
        moved = fitter.looked_at(current, (*current.causes, cause))
        return current.misfit - moved.misfit if moved else float("-inf")

    ground = ((c, np.zeros(len(c.linear))) for c in islice(single, MOST_GROUND))
    return _probed(screen, gain, ground)[:KEPT_GROUND]


def probed(screen: Screen, fitter: Fitter, current: Fit, candidates: Iterable[Candidate]) -> list[Probe]:
    """The best places of the best effects, at the sizes that are looked at.

    To first order many small deviations imitate a gross cause, at a price that is small against a large gap; so the
    order here is by what a candidate explains all by itself. Abrupt effects have no slope to be ordered by.
    """
    A, b = np.sum(current.evidence.A, axis=0), np.sum(current.evidence.b, axis=0)
    best: dict[tuple[str, Place], tuple[float, Candidate, F64]] = {}
    for c in candidates:
        effect = lookup(c.effect)
        if len(c.places) == 1 and effect.scope != "terrain":
            gain, estimate, _ = score(A, b, c.directions, slab(c, screen))
            gain = np.inf if effect.abrupt else gain
            if gain > best.get((c.effect, c.place), (-np.inf,))[0]:
                best[c.effect, c.place] = gain, c, estimate
    order = sorted(best.values(), key=lambda item: -item[0])[:MOST]
    gain_of = lambda cause: fitter.glance(current.causes, cause)  # noqa: E731
    found: dict[str, Probe] = {}
    for probe in _probed(screen, gain_of, [(c, estimate) for _, c, estimate in order]):
        found.setdefault(probe[1].effect, probe)
    return list(found.values())[:KEPT]


def _probed(
    screen: Screen, gain_of: Callable[[Cause], float], candidates: Iterable[tuple[Candidate, F64]]
) -> list[Probe]:
    """Candidates that gain, best first, each at its best size along its estimate."""
    found = []
    for candidate, estimate in candidates:
        parameters = {p.name: p for p in lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)}
        start = {n: parameters[n].default for n in candidate.names}
        steps = np.array([abs(parameters[n].step) for n in candidate.linear])
        size = float(np.linalg.norm(estimate / steps))
        unit = estimate / size if size else np.eye(len(steps))[0] * steps
        tried = []
        for factor in SIZES:
            moved = dict(zip(candidate.linear, unit * factor, strict=True))
            if all(parameters[n].bounds[0] <= v <= parameters[n].bounds[1] for n, v in moved.items()):
                values = start | moved
                tried.append((gain_of(Cause(candidate, tuple(values[n] for n in candidate.names))), factor, values))
        gain, _, values = max(tried, default=(0.0, 0.0, start))
        if gain > 0:
            found.append((gain, candidate, values))
    return sorted(found, key=lambda item: -item[0])
