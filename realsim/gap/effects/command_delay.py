"""Commands reach the drive late."""

from realsim.gap.effects.delays import delay

EFFECT = delay(
    "command_delay",
    "command delay",
    twin="observation_delay",
    description="Every command acts a fixed time after it was logged (bus, queue, low-level control rate).",
    signature="The same lag at all joints and speeds; error in proportion to the speed of the command; IMU and base "
    "lag with the joints.",
    excitation="Commands that change; an IMU or base pose tells it from a delay of the joint readings.",
)
