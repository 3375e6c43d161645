"""Terrain that stands higher or lower, looked at by simulation: whether a foot meets it, no slope foretells."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from realsim.gap.fit import Cause, Fit, Fitter
from realsim.gap.screen import Candidate, Screen
from realsim.gap.simulate import lookup

SIZES = (2.0, 0.7, -0.7, -2.0)
"""Steps of the parameter."""
MOST, KEPT = 12, 2
"""Places that are looked at, and those of them that are worth a fit."""


def probed(
    screen: Screen, fitter: Fitter, current: Fit, order: Iterable[Candidate]
) -> list[tuple[float, Candidate, dict[str, float]]]:
    """(gain in log-likelihood, candidate, value to start from) of the best places, beside the current causes.

    `order`: all candidates, those to look at first before the others.
    """
    found = []
    single = (c for c in order if lookup(c.effect).scope == "terrain" and len(c.places) == len(c.names) == 1)
    for candidate in islice(single, MOST):
        (parameter,) = lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)
        low, high = parameter.bounds
        values = [v for size in SIZES if low <= (v := size * parameter.step) <= high]
        tried = [_gain(fitter, current, candidate, v) for v in values]
        gain, value = max(tried, default=(0.0, 0.0))
        if gain > 0:
            found.append((gain, candidate, {parameter.name: value}))
    return sorted(found, key=lambda item: -item[0])[:KEPT]


def _gain(fitter: Fitter, current: Fit, candidate: Candidate, value: float) -> tuple[float, float]:
    moved = fitter.looked_at(current, (*current.causes, Cause(candidate, (value,))))
    return (current.misfit - moved.misfit if moved else float("-inf")), value
