"""A folder of frames, or a finished scan, as the rest of the pipeline wants it.

frames = read(Path("my_capture"), CaptureConfig())
print(inspect(Path("my_capture"), CaptureConfig()).render())
"""

from dataclasses import replace
from pathlib import Path

from realsim.capture.config import CaptureConfig
from realsim.capture.finishing import finish
from realsim.capture.inspection import Inspection, inspect_frames, inspect_scan
from realsim.capture.layout import Layout
from realsim.capture.listing import named_for_poses
from realsim.capture.recognition import recognise
from realsim.core.registry import Registry
from realsim.core.types import FrameSet, Scan

LAYOUTS = Registry(
    "capture layout",
    {
        "open3d": "realsim.capture.layouts.open3d:LAYOUT",
        "tum": "realsim.capture.layouts.tum:LAYOUT",
        "sevenscenes": "realsim.capture.layouts.sevenscenes:LAYOUT",
        "replica": "realsim.capture.layouts.replica:LAYOUT",
        "scannet": "realsim.capture.layouts.scannet:LAYOUT",
        "bop": "realsim.capture.layouts.bop:LAYOUT",
        "rtabmap": "realsim.capture.layouts.rtabmap:LAYOUT",
        "pcd": "realsim.capture.layouts.pcd:LAYOUT",
        "nerfstudio": "realsim.capture.layouts.nerfstudio:LAYOUT",
        "polycam": "realsim.capture.layouts.polycam:LAYOUT",
        "record3d": "realsim.capture.layouts.record3d:LAYOUT",
        "record3d_exr": "realsim.capture.layouts.record3d_exr:LAYOUT",
        "stray": "realsim.capture.layouts.stray:LAYOUT",
        "arkitscenes": "realsim.capture.layouts.arkitscenes:LAYOUT",
        "scannerapp": "realsim.capture.layouts.scannerapp:LAYOUT",
        "realsense": "realsim.capture.layouts.realsense:LAYOUT",
        "rosbag": "realsim.capture.layouts.rosbag:LAYOUT",
        "scan": "realsim.capture.layouts.scan:LAYOUT",
        "plain": "realsim.capture.layouts.plain:LAYOUT",
    },
    group="realsim.layouts",
    of="realsim.capture.layout:Layout",
)


def read(path: Path, config: CaptureConfig) -> FrameSet | Scan:
    """Recognise a capture and read it: frames that can be used, in order, images still on disk.

    Every frame of the result has depth of its camera's size within the range limits; all have poses (rigid, camera to
    world, OpenCV axes) or none has. What was left out, assumed and doubtful is in `dropped`, `assumptions`, `warnings`.

    Raises:
        CaptureError: not recognised, ambiguous, or nothing in it can be used.
        PoseError: poses are given and none of them can be used.
    """
    path = Path(path)
    layout, _ = recognise(path, config.layout, LAYOUTS)
    raw = _read(layout, path, config)
    return raw if isinstance(raw, Scan) else finish(raw, config).capture


def _read(layout: Layout, path: Path, config: CaptureConfig) -> FrameSet | Scan:
    raw = layout.read(path, config)
    if isinstance(raw, Scan):
        return raw
    warnings = raw.warnings
    if not (raw.has_poses or config.ignore_poses) and (names := named_for_poses(path)):
        where = f"layout {layout.name} does not read them; docs/captures.md says where each layout has poses"
        warnings += (f"{', '.join(names)}: are these the poses? {where}",)
    return replace(raw, sensor_sigma=layout.sensor_sigma, warnings=warnings)


def inspect(path: Path, config: CaptureConfig) -> Inspection:
    """How `read` interprets a capture and why, with figures (`realsim inspect`). Raises the same errors as `read`."""
    path = Path(path)
    layout, recognition = recognise(path, config.layout, LAYOUTS)
    raw = _read(layout, path, config)
    if isinstance(raw, Scan):
        return inspect_scan(raw, recognition)
    return inspect_frames(finish(raw, config), recognition)


__all__ = ["LAYOUTS", "CaptureConfig", "Inspection", "inspect", "read"]
