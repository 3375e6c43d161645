"""Candidates looked at by simulation, where slopes at the nominal model foretell nothing.

Whether a foot meets higher ground, no slope foretells. And where a robot swings so far from its simulator that the
two share little, every slope is of another motion than the robot's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice

from realsim.gap.fit import Cause, Fit, Fitter
from realsim.gap.screen import Candidate, Screen
from realsim.gap.simulate import lookup

Probe = tuple[float, Candidate, dict[str, float]]
"""(gain in log-likelihood, candidate, values to start from) beside the current causes."""

SIZES = (2.0, 0.7, -0.7, -2.0)
"""Steps of the parameter."""
MOST_GROUND, KEPT_GROUND = 12, 2
"""Places on the terrain that are looked at, and those of them that are worth a fit."""
MOST = 60
"""Candidates of any kind that are looked at."""
FORETOLD = 0.2
"""Share of the misfit that the best candidate must explain by its slopes, for the slopes to be believed."""


def probed_ground(screen: Screen, fitter: Fitter, current: Fit, order: Iterable[Candidate]) -> list[Probe]:
    """The best places for higher or lower ground. `order`: all candidates, those to look at first before the others."""
    single = (c for c in order if lookup(c.effect).scope == "terrain" and len(c.places) == len(c.names) == 1)

    def gain(cause: Cause) -> float:  # a foot may meet the ground in one run only: all of them, at the model's own step
        moved = fitter.looked_at(current, (*current.causes, cause))
        return current.misfit - moved.misfit if moved else float("-inf")

    return _probed(screen, gain, islice(single, MOST_GROUND))[:KEPT_GROUND]


def probed(screen: Screen, fitter: Fitter, current: Fit, order: Iterable[Candidate], kept: int) -> list[Probe]:
    """The best place of each effect, by the first parameter of its simpler forms; at most `kept`."""
    seen, single = set[tuple[str, tuple[str, ...], str]](), []
    for c in order:
        what = (c.effect, c.place, c.names[0])
        if len(c.places) == 1 and what not in seen and lookup(c.effect).scope != "terrain":
            seen.add(what)
            single.append(c)
    best: dict[str, Probe] = {}
    for probe in _probed(screen, lambda cause: fitter.glance(current.causes, cause), single[:MOST]):
        best.setdefault(probe[1].effect, probe)
    return list(best.values())[:kept]


def _probed(screen: Screen, gain_of: Callable[[Cause], float], candidates: Iterable[Candidate]) -> list[Probe]:
    found = []
    for candidate in candidates:
        parameters = lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)
        start = {p.name: p.default for p in parameters if p.name in candidate.names}
        first = next(p for p in parameters if p.name == candidate.names[0])
        values = [v for size in SIZES if first.bounds[0] <= (v := first.default + size * first.step) <= first.bounds[1]]
        tried = []
        for v in values:
            named = {**start, first.name: v}
            tried.append((gain_of(Cause(candidate, tuple(named[n] for n in candidate.names))), v))
        gain, value = max(tried, default=(0.0, 0.0))
        if gain > 0:
            found.append((gain, candidate, {**start, first.name: value}))
    return sorted(found, key=lambda item: -item[0])
