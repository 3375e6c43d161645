"""Commands reach the drive late."""

from realsim.gap.effects.base import Distinction, Words
from realsim.gap.effects.delays import delay

EFFECT = delay(
    "command_delay",
    "observation_delay",
    Words(
        settings=(
            "delay_min_lag, delay_max_lag of the actuator",
            "DelayedPDActuatorCfg: min_delay, max_delay",
            "the loop's period and the age of lowcmd",
        ),
        description="Every command acts a fixed time after it was logged (bus, queue, low-level control rate).",
        signature="The same lag at all joints and speeds; error in proportion to the speed of the command; IMU and "
        "base lag with the joints.",
        excitation=("commands that change",),
        told_by=(
            Distinction("a delay of the joint readings", "an IMU or base pose", ("imu_gyro", "imu_acc", "base_pos")),
        ),
        changed_by="other software or another bus",
    ),
)
