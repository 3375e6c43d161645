"""Interface of robots driven by a policy: read the state, write joint targets, stop."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """Sensors at one moment. Joints in the order of the policy's layout."""

    ang_vel: F64
    """(3,) rad/s of the base, base axes (x forward, y left, z up): the gyroscope."""
    gravity: F64
    """(3,) unit vector down in base axes: from the inertial unit's orientation."""
    joint_pos: F64
    """(J,) rad."""
    joint_vel: F64
    """(J,) rad/s."""
    depth: F64 | None = None
    """(H, W) metres along the optical axis, cropped as the policy sees it (`trainer.tasks.parkour.depth.crop`); 0 or
    not finite where nothing was measured. None without a camera."""
    base_pos: F64 | None = None
    """(3,) m in the scene's frame, where somebody knows it (motion capture, an estimator); for the log only."""
    base_quat: F64 | None = None
    """(4,) w x y z, base to scene."""
    contact: F64 | None = None
    """(F,) 1 for a foot that bears load, in the order of the robot's feet."""
    joint_torque: F64 | None = None
    """(J,) N m."""
    time: float | None = None
    """s of this moment on the robot's own clock, from any zero; for the log, which has the loop's clock without it. A
    simulated robot needs one: it stands still while the loop is late."""
    base_lin_vel: F64 | None = None
    """(3,) m/s in the scene's frame, where it is known exactly, as in a simulator: a replay then begins in the very
    state, and not in one that is estimated from the first samples."""


class Robot(Protocol):
    """One robot. Its joint servos run by themselves: torque = kp (target - q) - kd dq."""

    def start(self, kp: F64, kd: F64) -> None:
        """Take over with these gains (J,) and hold the present pose."""

    def read(self) -> Reading:
        """The newest sensor values, without waiting for others."""

    def write(self, targets: F64) -> None:
        """Joint targets (J,) in rad, held until the next call."""

    def stop(self) -> None:
        """Give the robot back in a safe state (damping). Called at the end whatever happened."""
