"""Everyday deviations that a user knows better than the library: how much robots of this kind differ from their model.

A JSON file gives standard deviations by effect and parameter, in the unit that diagnosis.json reports:

    {"payload": {"mass": 0.05}, "coulomb_friction": {"friction": {"hip": 0.3, "knee": 0.1}}}

A figure holds at every place; a mapping gives one a joint or body. 0 means that there is no such deviation.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

Sizes = Mapping[str, Mapping[str, float | Mapping[str, float]]]
"""Effect -> parameter -> standard deviation, or place -> standard deviation."""


@dataclass(frozen=True)
class Deviations:
    """Standard deviations that take the place of the library's."""

    sizes: Sizes = field(default_factory=dict)
    file: Path | None = None

    def of(self, effect: str, parameter: str, place: tuple[str, ...]) -> float | None:
        """In the reported unit; None where the library's own holds."""
        size = self.sizes.get(effect, {}).get(parameter)
        if isinstance(size, Mapping):
            known = [float(size[name]) for name in place if name in size]
            return max(known) if known else None
        return None if size is None else float(size)


def with_deviations(
    name: str, parameters: tuple[Any, ...], place: tuple[str, ...], known: Deviations
) -> tuple[Any, ...]:
    """Parameters of an effect at a place, with the user's sizes for the library's."""
    if name not in known.sizes:
        return parameters
    found = []
    for p in parameters:
        size = known.of(name, p.name, place)
        found.append(p if size is None else replace(p, nuisance=_coordinate(p, size)))
    return tuple(found)


def _coordinate(p: Any, size: float) -> float:
    """The size of a deviation in a parameter's coordinate. A stiffness is endless in the model, and its coordinate is
    what gives: there the size is itself reported (c / z is its own inverse), and no slope about the model says it."""
    if size and math.isclose(p.report(p.report(size)), size, rel_tol=1e-6):
        return abs(float(p.report(size)))
    return size / _unit(p)


def _unit(p: Any) -> float:
    """What one unit of a parameter's coordinate is in its reported unit, about the nominal model."""
    width: float = 1e-3 * abs(p.step)
    up = p.default + width <= p.bounds[1]
    change = p.report(p.default + (width if up else -width)) - p.report(p.default)
    return max(abs(float(change)) / width, 1e-12)
