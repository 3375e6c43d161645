"""Ground, gravity, platforms: from a metric scene in its own world to the simulation frame."""

from __future__ import annotations

from realsim.align.scene import align
from realsim.registry import Registry

SEGMENTERS = Registry("segmenter", {"geometric": "realsim.align.geometric:segment"})
"""name -> `realsim.align.segment.Segmenter`. Installed packages add theirs as entry points `realsim.segmenters`."""

__all__ = ["SEGMENTERS", "align"]
