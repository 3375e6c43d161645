"""Whether an experiment stays within the robot's limits, by simulation under every rival."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.case import Case
from realsim.gap.case.model.context import Context

SPEED_RATIO = 1.5
"""Times the highest speed of the log, up to which an experiment may go where no limit is given."""
TORQUE_SHARE = 0.95
"""Of the drive's limit in the model, up to which an experiment may go; beyond, a servo no longer holds its motion."""
BEYOND = 0.3
"""Share of the logged travel by which a joint without stops in the model may go beyond it on either side."""
TILT = 0.5
"""rad by which a floating base may tilt from where it began."""
SINK = 0.7
"""Share of its first height that a floating base must keep."""


@dataclass(frozen=True)
class Limits:
    """Per joint of the log, (J,): positions in rad or m, speeds a second, drive torques in N m or N."""

    low: F64
    high: F64
    speed: F64
    torque: F64
    names: tuple[str, ...]

    def broken(self, track: Mapping[str, F64]) -> str:
        """Which limit a simulated run leaves, in words; empty if none.

        Args:
            track: pos, vel, torque (N, J) and, of floating bases, base_pos (N, 3), base_quat (N, 4) on any grid; what
                comes before the first sample (`settle`: seconds, and the grid's step) does not count.
        """
        settle = track.get("settle")
        first = 0 if settle is None else round(float(settle[0] / settle[1]))
        track = {name: values[first:] for name, values in track.items() if name != "settle"}
        for values in track.values():
            if not np.isfinite(values).all():
                return "the simulation fails"
        pairs = (
            ("position", track["pos"], self.low, self.high),
            ("speed", track["vel"], -self.speed, self.speed),
            ("torque", track["torque"], -self.torque, self.torque),
        )
        for what, values, low, high in pairs:
            outside = (values < low) | (values > high)
            if outside.any():
                j = int(np.argmax(np.max(np.maximum(values - high, low - values), axis=0)))
                at = values[:, j][np.argmax(np.abs(values[:, j]))]
                return f"{self.names[j]}: {what} {at:.3g} leaves [{low[j]:.3g}, {high[j]:.3g}]"
        return _balance(track)


def limits_of(context: Context, max_speed: float | None = None, max_torque: float | None = None) -> Limits:
    """From the model's ranges and from what the log has shown.

    Args:
        max_speed: rad/s (m/s) of every joint; by default 1.5 times the highest of the log.
        max_torque: N m (N) of every drive; by default 95 % of the drive's limit in the model, or where there is none
            1.5 times the highest of the nominal simulator in the log's runs.
    """
    case: Case = context.case
    low, high, speed, torque = [], [], [], []
    for j, joint in enumerate(case.joint_names):
        i = case.model.joint(joint).id
        if case.model.jnt_limited[i]:
            ends = case.model.jnt_range[i]
        else:
            values = np.concatenate([run.signals["joint_pos"][:, j] for run in case.runs])
            ends = np.array([np.nanmin(values), np.nanmax(values)]) + np.array([-BEYOND, BEYOND]) * context.travel(
                joint
            )
        low.append(ends[0])
        high.append(ends[1])
        driven = joint in context.actuator
        most = SPEED_RATIO * context.speed[joint] if driven else np.inf
        speed.append(most if max_speed is None else max_speed)
        if not driven:
            torque.append(np.inf)
        elif max_torque is not None:
            torque.append(max_torque)
        elif context.limited(joint):
            torque.append(max(TORQUE_SHARE * context.torque_range[joint], context.peak_torque[joint]))
        else:
            torque.append(SPEED_RATIO * context.peak_torque[joint])
    return Limits(np.array(low), np.array(high), np.array(speed), np.array(torque), case.joint_names)


def _balance(track: Mapping[str, F64]) -> str:
    """Whether a floating base falls over or sinks."""
    if "base_pos" not in track:
        return ""
    w, x, y, z = track["base_quat"].T
    up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    tilt = float(np.arccos(np.clip(up @ up[0], -1, 1)).max())
    if tilt > TILT:
        return f"balance: the base tilts by {tilt:.2f} rad, {TILT:g} at most"
    height = track["base_pos"][:, 2]
    if height.min() < SINK * height[0]:
        return f"balance: the base sinks to {height.min():.2f} m from {height[0]:.2f} m"
    return ""
