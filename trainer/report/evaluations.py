"""Trials that were run on a policy: evaluation*.json of `realsim evaluate`, and before and after in result.json."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from realsim.core.errors import RealsimError
from realsim.core.files import read_json

FORMAT = "realsim.evaluation/1"


@dataclass(frozen=True)
class Evaluated:
    """A policy on one terrain."""

    title: str
    """Which evaluation: the name of its file, or before or after."""
    terrain: str
    """Its name, and whether its contact geometry is another than the one trained on."""
    trials: int
    successes: int
    interval: tuple[float, float]
    """95 percent interval of the success rate."""
    reasons: Mapping[str, int]
    """Cause -> failed trials."""
    where: tuple[tuple[float, float, Mapping[str, int]], ...]
    """Bins along the course with failures: from, to (m, from the start platform's centre), count by cause."""
    seconds: float | None
    """Mean duration of a success."""
    covered: float
    """Mean share of the way."""
    overflowed: int
    """Contacts that were dropped."""

    @property
    def rate(self) -> float:
        return self.successes / self.trials


def read_evaluations(folder: Path, result: Mapping[str, Any]) -> tuple[tuple[Evaluated, ...], list[str]]:
    """All that the folder of a run holds, and what could not be read.

    Args:
        folder: of the run.
        result: what its result.json says, as far as it was readable.
    """
    sources = [(name, result[name]) for name in ("before", "after") if result.get(name) is not None]
    notes = []
    for path in sorted(folder.glob("evaluation*.json")):
        try:
            sources.append((path.stem, read_json(path)))
        except RealsimError as error:
            notes.append(f"{path.name}: {error.message}")
    found: list[Evaluated] = []
    for title, data in sources:
        try:
            if data.get("format") != FORMAT:
                raise ValueError(f"format {data.get('format')!r} instead of {FORMAT!r}")
            found += [_terrain(title, terrain) for terrain in data["terrains"]]
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            notes.append(f"{title}: not an evaluation of realsim ({type(error).__name__}: {error})")
    return tuple(found), notes


def _terrain(title: str, data: Mapping[str, Any]) -> Evaluated:
    name = str(data["terrain"])
    trials, successes = int(data["trials"]), int(data["successes"])
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes} successes in {trials} trials")
    low, high = map(_finite, data["interval"])
    return Evaluated(
        title=title,
        terrain=name if data.get("geometry", "trained") == "trained" else f"{name}, {data['geometry']} contact",
        trials=trials,
        successes=successes,
        interval=(low, high),
        reasons=_counts(data["reasons"]),
        where=tuple((_finite(w["from_m"]), _finite(w["to_m"]), _counts(w)) for w in data["where"]),
        seconds=None if data.get("seconds") is None else _finite(data["seconds"]),
        covered=_finite(data["covered"]),
        overflowed=int(data.get("overflowed", 0)),
    )


def _counts(data: Mapping[str, Any]) -> dict[str, int]:
    return {str(name): int(count) for name, count in data.items() if name not in ("from_m", "to_m")}


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not a finite number")
    return number
