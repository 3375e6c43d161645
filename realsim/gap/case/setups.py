"""Known differences of single runs from model.xml: an added mass, another firmware gain."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, refuse_unknown
from realsim.core.types import MjModel

LIGHTEST, HEAVIEST, FARTHEST = 1e-6, 1000.0, 10.0
"""kg and metres: what no robot carries, so that the number is damaged or in another unit. The least is a milligram, set
on fuzz seed 3, where one of 2,000 trials went on in silence with less; what it gains on others was not measured."""
EXAMPLE = '{"run_03": {"payload": [{"body": "hand", "mass": 0.5, "at": [0, 0, 0.1]}], "gains": {"elbow": {"kp": 40}}}}'


@dataclass(frozen=True)
class Setup:
    """Differences of one run's robot from model.xml, known to its operator."""

    payload: tuple[tuple[str, float, tuple[float, float, float]], ...] = ()
    """(body, kg, place in the body's frame, m) of masses that are fixed to it."""
    gains: tuple[tuple[str, str, float], ...] = ()
    """(actuator, `kp` or `kd`, its value in N m/rad or N m s/rad of the actuator)."""
    later: bool = False
    """Whether the run is of the later one of two logs that are compared."""


def read_setups(given: Any, model: MjModel, file: Path) -> dict[str, Setup]:
    """Run -> its setup, from `runs` of log.json (`file`). Raises GapError for what is not in the model."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise _unreadable(file, given)
    return {str(name): _setup(entry, model, file) for name, entry in given.items()}


def _setup(entry: Any, model: MjModel, file: Path) -> Setup:
    if not isinstance(entry, Mapping) or set(entry) - {"payload", "gains"}:
        raise _unreadable(file, entry)

    def known(name: Any, kind: str, count: int) -> str:
        names = [getattr(model, kind)(i).name for i in range(count)]
        refuse_unknown(name, names, f"runs of log.json name the {kind} {name!r}, which is not in model.xml", file)
        return str(name)

    masses, gains = [], []
    try:
        for item in entry.get("payload", []):
            mass, (x, y, z) = float(item["mass"]), map(float, item["at"])
            weighs = mass == 0 or LIGHTEST <= mass < HEAVIEST
            if not (np.isfinite([mass, x, y, z]).all() and weighs and max(abs(x), abs(y), abs(z)) < FARTHEST):
                raise ValueError(item)
            masses.append((known(item["body"], "body", model.nbody), mass, (x, y, z)))
        for actuator, values in entry.get("gains", {}).items():
            name = known(actuator, "actuator", model.nu)
            for which, value in values.items():
                if which not in ("kp", "kd"):
                    raise ValueError(which)
                if model.actuator(name).biasprm[1 if which == "kp" else 2] >= 0:
                    message = f"runs of log.json give {name} a {which}, which it does not have in model.xml"
                    raise GapError(message, file=file, expected="a position servo with this gain")
                if not (np.isfinite(float(value)) and float(value) >= 0 and (which == "kd" or float(value) > 0)):
                    raise ValueError(value)  # a drive that is off is marked by `enabled`
                gains.append((name, which, float(value)))
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise _unreadable(file, entry) from error
    return Setup(tuple(masses), tuple(gains))


def _unreadable(file: Path, found: Any) -> GapError:
    return GapError("runs of log.json cannot be read", file=file, expected=EXAMPLE, found=repr(found)[:80])
