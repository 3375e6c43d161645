"""BOP, the benchmark of object poses: rgb/, depth/ and scene_camera.json of one scene.

Format (docs/bop_datasets_format.md of thodan/bop_toolkit): of each image `cam_K` row by row, `depth_scale` (times the
image it is mm) and, in most scenes, the world in the camera, `cam_R_w2c` row by row and `cam_t_w2c` in mm.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture.assemble import View, capture, depth_unit, frames_with, require_both, size_of_depth
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import camera_from_mapping
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, color_folder, depth_folder, image_files, lacking, last_number, pair_by_stem
from realsim.capture.poses import matrix_of
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_json
from realsim.core.geometry import invert_T
from realsim.core.types import F64, FrameSet

CAMERAS = "scene_camera.json"


def recognise(folder: Path) -> Recognition:
    if not (folder / CAMERAS).is_file():
        return Recognition()
    missing = lacking({"depth images (depth/)": depth_folder(folder), "colour images (rgb/)": color_folder(folder)})
    return Recognition((CAMERAS,), missing, score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    source = folder / CAMERAS
    cameras = read_json(source)
    if not isinstance(cameras, Mapping) or not all(isinstance(c, Mapping) for c in cameras.values()):
        raise CaptureError("no cameras by image number", file=source, expected='{"0": {"cam_K": [...], ...}, ...}')
    color, depth = image_files(folder)
    require_both(color, depth, folder, "rgb/ and depth/ with images")
    pairs, rule = pair_by_stem(color, depth)
    size = size_of_depth(depth)
    scales = {
        c.get("depth_scale", 1.0) for c in cameras.values() if isinstance(c.get("depth_scale", 1.0), (int, float))
    }
    if len(scales) != 1 or not 0 < min(scales) < np.inf:
        raise CaptureError("not one depth scale", file=source, expected="depth_scale, the same of all images")
    unit = depth_unit(0.001 * min(scales), CAMERAS, config)

    def view_of(pair: Pair) -> View:
        camera = cameras.get(str(last_number(pair.name)))
        if camera is None:
            raise CaptureError(f"it is not in {CAMERAS}")
        lens = camera_from_mapping({"K": camera.get("cam_K")}, source).sized(size)
        return View(lens, None, None if config.ignore_poses else read_pose(camera, source))

    frames, dropped = frames_with(pairs, unit, view_of)
    assumptions = [unit.note, rule, "depth is registered to colour"]
    if any(f.T_world_camera is not None for f in frames):
        assumptions.append(f"{CAMERAS} has the world in the camera, mm: its inverse is the pose")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions)


def read_pose(camera: Mapping[str, Any], source: Path) -> F64 | None:
    """(4, 4) T_world_camera in metres, or None where the image has none."""
    if "cam_R_w2c" not in camera:
        return None
    R, t = camera["cam_R_w2c"], camera.get("cam_t_w2c")
    if not isinstance(R, list) or not isinstance(t, list) or (len(R), len(t)) != (9, 3):
        raise PoseError("no rotation of nine and translation of three numbers", file=source)
    T = matrix_of([[*R[k : k + 3], t[k // 3]] for k in (0, 3, 6)], "cam_R_w2c and cam_t_w2c", source)
    T[:3, 3] *= 0.001
    return invert_T(T)


LAYOUT = Layout(
    "bop", "rgb/, depth/ and scene_camera.json with cam_K, depth_scale, cam_R_w2c, cam_t_w2c", recognise, read
)
