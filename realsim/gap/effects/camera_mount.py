"""The camera is mounted elsewhere than in the model."""

from realsim.gap.effects.base import Parameter
from realsim.gap.effects.unseen import unseen

EFFECT = unseen(
    "camera_mount",
    "The camera is mounted elsewhere than in the model.",
    "Depth is seen from another pose: all distances shift with the view direction. Joints, base and IMU are right.",
    Parameter("rotation", "rad", (0.0, 0.3), 0.02),
)
