"""Depth is noisier than the model says."""

from realsim.gap.effects.base import Parameter
from realsim.gap.effects.unseen import unseen

EFFECT = unseen(
    "depth_noise",
    "Depth is noisier than the model says.",
    "Depth scatters, with holes and edges, more than the model's. Joints, base and IMU are right.",
    Parameter("sigma", "m", (0.0, 0.3), 0.02),
)
