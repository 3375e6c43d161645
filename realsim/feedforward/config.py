"""What can be set about poses and points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class PointsConfig:
    backend: str = "rgbd"
    """Where points and poses come from."""
    poses: Literal["auto", "given", "estimate"] = "auto"
    """`given` uses the capture's poses and fails without them, `estimate` ignores them, `auto` uses them if there."""
    refine: bool = True
    """Refine given poses against the depth."""
    correct_depth_bias: bool = True
    """With metric poses given, recover the depth sensor's scale bias from multi-view consistency and correct it."""
    seed: Annotated[int, tyro.conf.Suppress] = 0
    """Seed of everything random in this stage."""
