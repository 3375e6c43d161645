"""Options of a synthetic capture."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from realsim.core.limits import check_limits


@dataclass(frozen=True)
class SynthConfig:
    terrain: Annotated[
        str,
        tyro.conf.arg(metavar="{stakes,beams,wedges,boxes,trapezoids,boston,mixed,corridor,ring,stairwell,stake_row}"),
    ] = "stakes"
    """Terrain between the platforms; or, the last four, a place that repeats."""
    frames: int = 60
    """Number of views along the walk."""
    poses: Annotated[bool, tyro.conf.arg(name="with-poses")] = False
    """Write the true poses into the capture (trajectory.log)."""
    both_sides: bool = False
    """Walk along both sides of the terrain instead of one."""
    once: bool = False
    """Go through a place that repeats without coming back to where the camera was: there is no loop to close."""
    gap: int = 0
    """Frames that are missing in the middle, as where a person looked away while walking on."""
    sensor: Literal["d435i", "kinect"] = "d435i"
    """`d435i`: depth aligned to colour, written as an Open3D dataset. `kinect`: written in the layout of 7-Scenes, with
    colour that is not registered to depth: focal length, centre and position differ, undocumented as there."""
    width: int = 640
    """Width of the images, pixels; their height is three quarters of it."""
    pose_error: float = 0.0
    """Metres, RMS, by which the written poses drift smoothly from the truth (and 0.3 degrees per centimetre), as those
    of a tracker do."""
    depth_scale: float | None = None
    """Ratio of measured to true depth; by default drawn from 0.99 to 1.01."""
    noise: bool = True
    """Sensor noise, holes, flying pixels and exposure changes; without it depth is exact to the millimetre."""
    seed: int = 0
    """Seed of the terrain, the walk and the noise."""

    def __post_init__(self) -> None:
        check_limits(
            self,
            least={"frames": 1, "gap": 0, "pose_error": 0, "depth_scale": 0.5},
            most={"frames": 100_000, "gap": 100_000, "pose_error": 1, "depth_scale": 2},
        )
        if not (80 <= self.width <= 1920 and self.width % 4 == 0):
            raise ValueError(f"width must be a multiple of 4 from 80 to 1920, found {self.width}")
