"""Reads and checks a user's file of everyday deviations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from realsim.core.errors import GapError
from realsim.core.files import read_json
from realsim.gap.case.model.deviations import Deviations
from realsim.gap.effects.lookup import lookup

if TYPE_CHECKING:
    from realsim.gap.case.model.context import Context


def read_deviations(path: Path | None) -> Deviations:
    """The file's sizes; none without a file. Raises GapError with what is wrong."""
    if path is None:
        return Deviations()
    data = read_json(Path(path))
    if not isinstance(data, dict):
        raise GapError("not a file of deviations", file=path, expected='{"effect": {"parameter": size}}')
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


def check_places(deviations: Deviations, known: Callable[[str], list[tuple[str, ...]]], context: Context) -> None:
    """Refuse parameters and places that this robot has not.

    Args:
        known: effect -> places where it can act.
    """
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
