"""Units that logs come in, and the contract's SI units that they become."""

from __future__ import annotations

from math import pi
from pathlib import Path

from realsim.core.errors import GapError, did_you_mean
from realsim.core.types import F64

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLE = {"rad": 1.0, "deg": pi / 180, "rev": 2 * pi, "mrad": 1e-3}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
TURNING = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30, "rev/s": 2 * pi, "mrad/s": 1e-3}
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


def factor(array: str, unit: str, command_kind: str, file: Path) -> float:
    """Factor from `unit` to the unit of `array`. Raises GapError with the units that are known."""
    known = UNITS.get(_OF_COMMAND[command_kind] if array == "command" else array)
    if known is None:
        raise GapError(
            f"a unit is given for {array!r}, which is no array of a log", file=file, expected=", ".join(UNITS)
        )
    if unit not in known:
        raise GapError(
            f"unknown unit {unit!r} of {array}",
            file=file,
            expected=f"one of {', '.join(known)}",
            hint=did_you_mean(unit, known),
        )
    return known[unit]


def in_si(values: F64, array: str, unit: str, command_kind: str, file: Path) -> F64:
    """Values of an array in the contract's unit."""
    return values * factor(array, unit, command_kind, file)
