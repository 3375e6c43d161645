"""nerfstudio's `transforms.json` (also instant-ngp's), with a depth image for every frame.

Conventions (https://docs.nerf.studio/quickstart/data_conventions.html and its data parser): camera to world with OpenGL
camera axes; figures at the top of the file hold for all frames, others stand in each frame; depth is in steps of
0.001 of the poses' unit, for arrays too; pixel centres are at half integers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture.arkit import AXES_NOTE, from_opengl
from realsim.capture.assemble import (
    View,
    capture,
    depth_unit,
    frames_with,
    on_two_grids,
    require_both,
    sizes_of,
)
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import Camera, camera_from_mapping, no_intrinsics
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, natural_key
from realsim.capture.poses import matrix_of
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.files import inside, read_json, read_text
from realsim.core.types import F64, FrameSet

TRANSFORMS = "transforms.json"
DEPTH_KEYS = ("depth_file_path", "depth_path")
"""nerfstudio's and instant-ngp's."""
UNIT_KEYS = ("depth_unit_scale_factor", "integer_depth_scale")
CAMERA_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")
PINHOLE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL")


def recognise(folder: Path) -> Recognition:
    path = folder / TRANSFORMS
    if not path.is_file():
        return Recognition()
    try:
        text = read_text(path)
    except RealsimError as error:
        return Recognition((TRANSFORMS,), (f"a readable {TRANSFORMS} ({error.message})",), score=30)
    if not any(f'"{key}"' in text for key in DEPTH_KEYS):
        return Recognition((TRANSFORMS,), (f"depth images (depth_file_path in {TRANSFORMS})",), score=30)
    return Recognition((f"{TRANSFORMS} with depth_file_path",), (), score=35)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    path = folder / TRANSFORMS
    data = read_json(path)
    entries = data.get("frames") if isinstance(data, Mapping) else None
    if not isinstance(entries, Sequence) or not entries or not all(isinstance(e, Mapping) for e in entries):
        raise CaptureError("no frames in this file", file=path, expected='a list of objects under "frames"')
    if not any("fl_x" in holder for holder in (data, *entries)):
        raise no_intrinsics(path, ("fl_x fl_y cx cy",), "write fl_x, fl_y, cx, cy, w and h at the top of the file")
    pairs, by_name = _pairs(folder, entries)
    color, depth = [p.color for p in pairs if p.color], [p.depth for p in pairs if p.depth]
    require_both(color, depth, path, "file_path and depth_file_path of images")
    color_size, depth_size = sizes_of(color, depth)
    key = next((key for key in UNIT_KEYS if key in data), None)
    step = 0.001 if key is None else _positive(data[key], key, path)
    unit = depth_unit(step, "nerfstudio's convention" if key is None else f"{key} in {path.name}", config, arrays=True)
    scale = _positive(data.get("applied_scale", 1.0), "applied_scale", path)
    warnings: list[str] = []

    def view_of(pair: Pair) -> View:
        camera = _camera(data, by_name[pair.name], path)
        warnings.extend(camera.warnings)
        of_depth, of_color = on_two_grids(camera.sized(color_size), depth_size)
        return View(of_depth, of_color, None if config.ignore_poses else _pose(by_name[pair.name], scale, path))

    frames, dropped = frames_with(pairs, unit, view_of)
    assumptions = [
        unit.note,
        "figures at the top of transforms.json hold for all frames"
        if "fl_x" in data
        else "every frame has intrinsics of its own",
        "pixel centres are at half integers in transforms.json: half a pixel is taken off the principal point",
    ]
    if depth_size != color_size:
        assumptions.append("colour and depth are the same view on two grids; the camera is that of the colour image")
    if not config.ignore_poses:
        assumptions += [AXES_NOTE, "poses are in the unit of the depth, as nerfstudio takes them"]
        if "applied_transform" in data:
            assumptions.append("applied_transform is not taken back: the world is that of transforms.json")
        if scale != 1.0:
            assumptions.append(f"applied_scale {scale:g} is taken back from the positions")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, warnings)


def _pairs(folder: Path, entries: Sequence[Mapping[str, Any]]) -> tuple[list[Pair], dict[str, Mapping[str, Any]]]:
    """Colour and depth of every entry in the order of the file names, and the entry of every frame name."""
    source = folder / TRANSFORMS
    named: dict[str, tuple[str, Mapping[str, Any]]] = {}
    for entry in entries:
        color = _text(entry.get("file_path"), source)
        if color in named:
            raise CaptureError("an image is listed twice", file=source, found=color)
        named[color] = (Path(color).stem, entry)
    unique = len({stem for stem, _ in named.values()}) == len(named)
    pairs, by_name = [], {}
    for color in sorted(named, key=natural_key):
        stem, entry = named[color]
        name = stem if unique else str(Path(color).with_suffix(""))
        depth = next((entry[key] for key in DEPTH_KEYS if entry.get(key)), None)
        depth_path = None if depth is None else inside(folder, _text(depth, source))
        file = color if Path(color).suffix else f"{color}.png"  # as instant-ngp reads it, and NeRFCapture writes it
        pairs.append(Pair(name, inside(folder, file), depth_path))
        by_name[name] = entry
    return pairs, by_name


def _camera(data: Mapping[str, Any], entry: Mapping[str, Any], path: Path) -> Camera:
    """The camera of one frame."""
    model = data.get("camera_model", entry.get("camera_model", "OPENCV"))
    if str(model).upper() not in PINHOLE:
        raise CaptureError(
            "not a pinhole camera", file=path, expected=f"camera_model {' or '.join(PINHOLE)}", found=str(model)
        )
    merged = {key: value for key, value in entry.items() if key in CAMERA_KEYS}
    merged |= {key: data[key] for key in CAMERA_KEYS if key in data}
    camera = camera_from_mapping(merged, path)
    # Here the centre of the first pixel is (0, 0), in nerfstudio it is (0.5, 0.5).
    return replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5)


def _pose(entry: Mapping[str, Any], scale: float, path: Path) -> F64:
    T = matrix_of(entry.get("transform_matrix"), "transform_matrix", path)
    T[:3, 3] /= scale
    return from_opengl(T)


def _positive(value: Any, what: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < np.inf:
        raise CaptureError(f"{what} is not a positive number", file=path, found=repr(value))
    return float(value)


def _text(value: Any, path: Path) -> str:
    if not isinstance(value, str) or not value or "\0" in value:
        raise CaptureError("a frame without a file name", file=path, expected="file_path", found=repr(value))
    return value


LAYOUT = Layout("nerfstudio", "transforms.json whose frames have file_path and depth_file_path", recognise, read)
