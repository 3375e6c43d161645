"""Images are older than the log says."""

from realsim.gap.effects.base import Parameter
from realsim.gap.effects.unseen import unseen

EFFECT = unseen(
    "camera_delay",
    "Images are older than the log says.",
    "The depth image belongs to an earlier moment. Joints, base and IMU are right.",
    Parameter("delay", "s", (0.0, 0.3), 0.02),
)
