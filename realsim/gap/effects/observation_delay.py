"""Joint readings arrive late."""

from realsim.gap.effects.delays import delay

EFFECT = delay(
    "observation_delay",
    "observation delay",
    twin="command_delay",
    description="Joint positions, velocities and torques are logged a fixed time after they were true; the IMU is not.",
    signature="The same lag at all joints and speeds, while IMU and base pose are on time.",
    excitation="Motion; an IMU or base pose tells it from a delay of the command.",
)
