"""The sets of causes that a diagnosis cannot tell apart, in the coordinates that the simulator takes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.case.model.context import Context
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.base import Parameter, Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fitted import Fit
from realsim.gap.simulation.simulate import Setting


@dataclass(frozen=True)
class Part:
    """One cause of a rival."""

    effect: str
    places: tuple[Place, ...]
    """Told to the simulator one by one, with the same values."""
    values: dict[str, float]
    """Coordinates by parameter (0 is nominal), not the contract's units."""


@dataclass(frozen=True)
class Rival:
    """One of the sets of causes that explain a log equally well, as it was fitted."""

    parts: tuple[Part, ...]
    covariance: F64
    """(m, m) of all coordinates in the order of the parts, everyday deviations integrated out."""
    says: str
    """The set in words."""

    @property
    def values(self) -> F64:
        """(m,) all coordinates in a row."""
        return np.array([v for part in self.parts for v in part.values.values()])

    def settings(self, values: F64 | None = None) -> list[Setting]:
        """What the simulator is told; `values` (m,) in place of the fitted ones."""
        row = list(self.values if values is None else values)
        found: list[Setting] = []
        for part in self.parts:
            named = {name: float(row.pop(0)) for name in part.values}
            found += [(part.effect, place, named) for place in part.places]
        return found

    def parameters(self, context: Context) -> list[Parameter]:
        """Of all coordinates in a row."""
        found = []
        for part in self.parts:
            known = {p.name: p for p in lookup(part.effect).parameters(context, part.places[0])}
            found += [known[name] for name in part.values]
        return found

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; `rivals_from` reads it again."""
        parts = [{"effect": p.effect, "places": [list(n) for n in p.places], "values": p.values} for p in self.parts]
        return {"says": self.says, "causes": parts, "covariance": self.covariance.tolist()}


def rival_of(fit: Fit, says: str) -> Rival:
    """A fit as a rival."""
    parts = []
    for cause in fit.causes:
        c = cause.candidate
        places = (c.place,) if lookup(c.effect).law.joint_figure else c.places
        parts.append(Part(c.effect, places, cause.named))
    return Rival(tuple(parts), np.asarray(fit.covariance), says)


def rivals_from(entries: Sequence[Mapping[str, Any]], context: Context) -> tuple[Rival, ...]:
    """Rivals of diagnosis.json (`next_experiment.rivals`). Raises GapError where they are not of this robot."""
    found = []
    for entry in entries:
        try:
            parts = tuple(
                Part(
                    str(c["effect"]),
                    tuple(tuple(str(n) for n in place) for place in c["places"]),
                    {str(name): float(value) for name, value in c["values"].items()},
                )
                for c in entry["causes"]
            )
            covariance = np.array(entry["covariance"], dtype=np.float64)
            rival = Rival(parts, covariance, str(entry["says"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise GapError(
                "next_experiment of diagnosis.json cannot be read",
                found=repr(entry)[:80],
                hint="diagnose the case again",
            ) from error
        _check(rival, context)
        found.append(rival)
    return tuple(found)


def _check(rival: Rival, context: Context) -> None:
    """Refuse places and parameters that the case's model does not have."""
    model = context.case.model
    known = {*context.case.joint_names, *context.case.actuator_names, *(model.body(i).name for i in range(model.nbody))}
    for part in rival.parts:
        EFFECTS[part.effect]
        missing = [name for place in part.places for name in place if name not in known]
        if missing:
            raise GapError(
                "the diagnosis is of another robot",
                expected="joints, bodies and actuators of model.xml",
                found=missing[0],
                hint="give the case that was diagnosed (--case)",
            )
    count = len(rival.values)
    names = [p.name for p in rival.parameters(context)] if count else []
    if rival.covariance.shape != (count, count) or not np.isfinite(rival.covariance).all() or len(names) != count:
        raise GapError("the covariance of a rival does not fit its values", found=str(rival.covariance.shape))
