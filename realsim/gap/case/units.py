"""Units that logs come in: their factors to SI, and what a signal's size and sign say of its unit."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError, refuse_unknown
from realsim.core.statistics import alike
from realsim.core.types import F64

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
ANGLE = {"rad": 1.0, "deg": pi / 180, "rev": 2 * pi, "mrad": 1e-3, "mdeg": pi / 180e3}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
TURNING = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30, "rev/s": 2 * pi, "mrad/s": 1e-3, "mdeg/s": pi / 180e3}
MOVING = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
TORQUE = {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N cm": 1e-2, "kgf cm": 0.0980665}
FORCE = {"N": 1.0, "kgf": 9.80665}
ACCELERATION = {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3}
NONE = {"1": 1.0}

UNITS: dict[str, dict[str, float]] = {
    "time": TIME,
    "joint_pos": ANGLE | LENGTH,
    "joint_vel": TURNING | MOVING,
    "joint_torque": TORQUE | FORCE,
    "base_pos": LENGTH,
    "base_quat": NONE,
    "imu_gyro": TURNING,
    "imu_acc": ACCELERATION,
    "contact": NONE,
}
_OF_COMMAND = {"position": "joint_pos", "velocity": "joint_vel", "torque": "joint_torque"}


def unit_factor(array: str, unit: str, command_kind: str, file: Path) -> float:
    """Factor from `unit` to the unit of `array`. Raises GapError with the units that are known."""
    known = UNITS.get(_OF_COMMAND[command_kind] if array == "command" else array)
    if known is None:
        raise GapError(
            f"a unit is given for {array!r}, which is no array of a log", file=file, expected=", ".join(UNITS)
        )
    refuse_unknown(unit, known, f"unknown unit {unit!r} of {array}", file)
    return known[unit]


def in_si(values: F64, array: str, unit: str, command_kind: str, file: Path) -> F64:
    """Values of an array in the contract's unit."""
    return values * unit_factor(array, unit, command_kind, file)


G = 9.81
NEAR = 0.15
"""Relative difference up to which a measured factor is that of a known unit."""


@dataclass(frozen=True)
class Factor:
    """One signal against another that it should be, without means."""

    ratio: float
    """The first over the second, with the sign; NaN where nothing moves."""
    corr: float
    unit: str
    """The unit in which the first would be so many times as large."""
    near: bool
    """Whether it is that unit within NEAR."""


def factor(a: F64, b: F64) -> float:
    """f of least squares in a = f b, without means, both taken to be noisy (the ratio of spreads, with the sign)."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 20:
        return np.nan
    x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
    spread = float(np.std(y))
    return float(np.sign(x @ y) * np.std(x) / spread) if spread > 1e-12 else np.nan


def nearest_unit(ratio: float, units: Mapping[str, float]) -> str:
    """The unit in which values are `ratio` times as large as in SI; the sign does not matter."""
    return min(units, key=lambda u: abs(np.log(max(abs(ratio), 1e-12) * units[u])))


def travelled(times: F64, position: F64, velocity: F64) -> tuple[F64, F64]:
    """(differences of the position, integrals of the velocity) (T,) over the same short stretches of 0.1 s or more.

    An integral does not mind noise as a derivative does, so what stays is the factor between them.
    """
    step = float(np.median(np.diff(times))) if len(times) > 2 else np.nan
    if not np.isfinite(step):
        return np.zeros(0), np.zeros(0)
    lag = max(2, round(0.1 / max(step, 1e-6)))
    good = np.isfinite(velocity)
    filled = np.interp(np.arange(len(velocity)), np.flatnonzero(good), velocity[good]) if good.any() else velocity
    total = np.concatenate([[0.0], np.cumsum(0.5 * (filled[1:] + filled[:-1]) * np.diff(times))])
    if len(times) <= lag:
        return np.zeros(0), np.zeros(0)
    return position[lag:] - position[:-lag], total[lag:] - total[:-lag]


def speed_factor(moved: F64, sums: F64) -> Factor:
    """A velocity's integrals against ways travelled (`travelled`, of any runs one after another)."""
    known = moved[np.isfinite(moved)]
    ratio = factor(sums, moved) if len(known) and np.std(known) > 1e-3 else np.nan
    if not np.isfinite(ratio):
        return Factor(np.nan, 0.0, "rad/s", False)
    unit = nearest_unit(ratio, TURNING)
    return Factor(ratio, alike(sums, moved), unit, abs(abs(ratio) * TURNING[unit] - 1) < NEAR)


def gravity_unit(size: float) -> str:
    """The unit in which the median length of a specific force is gravity's; empty where it is in none."""
    unit = nearest_unit(size / G, ACCELERATION)
    return unit if 0.7 < size * ACCELERATION[unit] / G < 1.4 else ""
