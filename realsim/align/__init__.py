"""Ground, gravity, platforms: from a metric scene in its own world to the simulation frame."""

from __future__ import annotations

from realsim.registry import Registry

SEGMENTERS = Registry("segmenter", {"geometric": "realsim.align.geometric:segment"})
"""name -> `realsim.align.segment.Segmenter`. Installed packages add theirs as entry points `realsim.segmenters`."""

from realsim.align.scene import align  # noqa: E402  (it reads the registry above)

__all__ = ["SEGMENTERS", "align"]
