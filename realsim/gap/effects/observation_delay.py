"""Joint readings arrive late."""

from realsim.gap.effects.base import Distinction, Words
from realsim.gap.effects.delays import delay

EFFECT = delay(
    "observation_delay",
    "command_delay",
    Words(
        settings=(
            "delay_min_lag, delay_max_lag of the observations",
            "delayed observations (modifiers)",
            "the age of lowstate when it is read",
        ),
        description="Joint positions, velocities and torques are logged a fixed time after they were true; the IMU is "
        "not.",
        signature="The same lag at all joints and speeds, while IMU and base pose are on time.",
        excitation=("motion",),
        told_by=(Distinction("a delay of the command", "an IMU or base pose", ("imu_gyro", "imu_acc", "base_pos")),),
        changed_by="other software or another bus",
    ),
)
