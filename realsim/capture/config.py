"""Options of reading a capture."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from realsim.core.limits import check_limits

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Name of a unit of scans -> its length in metres."""
LAYOUTS = (
    "{auto,open3d,tum,sevenscenes,replica,scannet,pcd,nerfstudio,polycam,record3d,record3d_exr,stray,arkitscenes,"
    "scannerapp,rtabmap,bop,realsense,rosbag,scan,plain}"
)
"""What --help shows, besides those of installed packages; a test holds it to the registry."""


@dataclass(frozen=True)
class CaptureConfig:
    layout: Annotated[str, tyro.conf.arg(metavar=LAYOUTS)] = "auto"
    """Capture layout; `auto` recognises it."""
    max_frames: int = 300
    """At most this many frames are used, picked by sharpness and view change; 0 for all."""
    every: int = 1
    """Use every n-th frame."""
    depth_unit: float | None = None
    """Metres per unit of depth images; by default as the layout defines it."""
    min_depth: float = 0.15
    """Metres; nearer depth is invalid."""
    max_depth: float = 6.0
    """Metres; farther depth is invalid."""
    unit: Annotated[str, tyro.conf.arg(metavar="{m,cm,mm,inch}")] = "m"
    """Unit of scans whose files do not specify one."""
    ignore_poses: bool = False
    """Do not read the capture's poses (for captures whose poses are known to be wrong)."""
    metric_poses: bool = True
    """The capture's poses are in metres. If not (structure from motion, COLMAP), the depth gives their scale."""
    max_time_difference: float = 0.02
    """Seconds between a colour and a depth image that still count as one frame (layouts with timestamps)."""
    max_pose_gap: float = 0.1
    """Seconds between two poses across which a pose is still interpolated (layouts with timestamps)."""
    camera: str = ""
    """Topics of a bag that begin so, where it holds several cameras (/front)."""
    keep_blurred: bool = False
    """Keep frames that are much less sharp than their neighbours."""

    def __post_init__(self) -> None:
        sizes = dict.fromkeys(("max_frames", "max_time_difference", "max_pose_gap"), 0)
        check_limits(self, above={"depth_unit": 0}, least={**sizes, "every": 1})
        if not 0 <= self.min_depth < self.max_depth:
            raise ValueError(f"need 0 <= min_depth < max_depth, found {self.min_depth:g} and {self.max_depth:g}")
        if self.unit not in UNITS:
            raise ValueError(f"unit must be one of {', '.join(UNITS)}, found {self.unit}")
