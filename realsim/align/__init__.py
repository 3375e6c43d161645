"""Ground, gravity, platforms: from a metric scene in its own world to the simulation frame."""

from realsim.align.scene import align
from realsim.align.segment import SEGMENTERS

__all__ = ["SEGMENTERS", "align"]
