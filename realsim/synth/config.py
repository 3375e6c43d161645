"""What can be set about a synthetic capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class SynthConfig:
    terrain: Annotated[str, tyro.conf.arg(metavar="{stakes,beams,wedges,boxes,trapezoids,boston,mixed}")] = "stakes"
    """Terrain between the platforms."""
    frames: int = 60
    """Number of views along the walk."""
    poses: Annotated[bool, tyro.conf.arg(name="with-poses")] = False
    """Write the true poses into the capture (trajectory.log)."""
    both_sides: bool = False
    """Walk along both sides of the terrain instead of one."""
    depth_scale: float | None = None
    """Measured over true depth; drawn from 0.99 to 1.01 if not given."""
    noise: bool = True
    """Sensor noise, holes, flying pixels and exposure changes; without it depth is exact to the millimetre."""
    seed: int = 0
    """Seed of the terrain, the walk and the noise."""

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= 100_000:
            raise ValueError("frames must lie between 1 and 100000")
        if self.depth_scale is not None and not 0.5 <= self.depth_scale <= 2:
            raise ValueError("depth_scale must lie between 0.5 and 2")
