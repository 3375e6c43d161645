"""Everyday deviations that a user knows better than the library: how much robots of this kind differ from their model.

A JSON file gives standard deviations by effect and parameter, in the unit that diagnosis.json reports:

    {"payload": {"mass": 0.05}, "coulomb_friction": {"friction": {"hip": 0.3, "knee": 0.1}}}

A figure holds at every place; a mapping gives one a joint or body. 0 means that there is no such deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from realsim.errors import GapError
from realsim.files import read_json

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


def read_deviations(path: Path | None) -> Deviations:
    """The file's sizes; none without a file. Raises GapError with what is wrong."""
    if path is None:
        return Deviations()
    data = read_json(Path(path))
    if not isinstance(data, dict):
        raise GapError("not a file of deviations", file=path, expected='{"effect": {"parameter": size}}')
    from realsim.gap.simulation.simulate import lookup

    for effect, sizes in data.items():
        lookup(effect)  # an unknown name is refused with the closest ones
        if not isinstance(sizes, dict) or not sizes:
            raise GapError(f"{effect} has no sizes", file=path, expected=f'{{"{effect}": {{"parameter": size}}}}')
        for parameter, size in sizes.items():
            for value in size.values() if isinstance(size, dict) else [size]:
                good = isinstance(value, int | float) and not isinstance(value, bool)
                if not (good and math.isfinite(value) and value >= 0):
                    raise GapError(
                        f"the size of {effect}, {parameter} is no standard deviation",
                        file=path,
                        expected="a number, 0 or above, in the unit that diagnosis.json reports",
                        found=repr(value),
                    )
    return Deviations(data, Path(path))


def check_places(deviations: Deviations, known: Callable[[str], list[tuple[str, ...]]], context: Any) -> None:
    """Refuse parameters and places that this robot has not.

    Args:
        known: effect -> places where it can act.
    """
    from realsim.gap.simulation.simulate import lookup

    for effect, sizes in deviations.sizes.items():
        places = known(effect)
        names = {p.name for place in places for p in lookup(effect).parameters(context, place)}
        parts = {n for place in places for n in place}
        for parameter, size in sizes.items():
            unknown = set(size) - parts if isinstance(size, Mapping) else set()
            if (names and parameter not in names) or unknown:
                raise GapError(
                    f"{effect} has no {'place ' + repr(min(unknown)) if unknown else 'parameter ' + repr(parameter)}",
                    file=deviations.file,
                    expected=", ".join(sorted(parts if unknown else names)),
                )


def with_deviations(name: str, parameters: tuple[Any, ...], place: tuple[str, ...], known: Deviations) -> tuple:
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
    width = 1e-3 * abs(p.step)
    up = p.default + width <= p.bounds[1]
    change = p.report(p.default + (width if up else -width)) - p.report(p.default)
    return max(abs(float(change)) / width, 1e-12)
