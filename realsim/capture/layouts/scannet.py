"""ScanNet exports: color/, depth/, pose/*.txt, intrinsic/, as the dataset's own exporter writes them.

Colour (1296x968) and depth (640x480) have cameras of their own; depth is in millimetres; poses are camera to world
and full of -inf where tracking was lost. Also the `scannet_frames_25k` form with the camera files beside the folders.
"""

from pathlib import Path

import numpy as np

from realsim.capture.assemble import View, capture, depth_unit, frames_with, require_both, sizes_of
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import (
    color_folder,
    depth_folder,
    first_file,
    image_files,
    lacking,
    list_files,
    pair_by_stem,
)
from realsim.capture.poses import pose_in, read_matrix
from realsim.core.types import FrameSet

CAMERAS = {
    "depth": ("intrinsic/intrinsic_depth.txt", "intrinsics_depth.txt", "intrinsic_depth.txt"),
    "color": ("intrinsic/intrinsic_color.txt", "intrinsics_color.txt", "intrinsic_color.txt"),
}
POSES = "pose"


def camera_file(folder: Path, which: str) -> Path | None:
    return first_file(folder, CAMERAS[which])


def recognise(folder: Path) -> Recognition:
    found = {which: camera_file(folder, which) for which in CAMERAS}
    evidence = [str(p.relative_to(folder)) for p in found.values() if p is not None]
    if not evidence:
        return Recognition()
    parts: dict[str, Path | None] = {f"intrinsics of {k} ({CAMERAS[k][0]})": p for k, p in found.items()}
    parts |= {"depth images (depth/)": depth_folder(folder), "colour images (color/)": color_folder(folder)}
    evidence += [f"{POSES}/"] if list_files(folder / POSES, (".txt",)) else []
    return Recognition(tuple(evidence), lacking(parts), score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    color, depth = image_files(folder)
    require_both(color, depth, folder, "color/ and depth/ with images")
    depth_source, color_source = camera_file(folder, "depth"), camera_file(folder, "color")
    if depth_source is None or color_source is None:
        raise no_intrinsics(folder, (CAMERAS["depth"][0], CAMERAS["color"][0]), "export the scan with its intrinsics")
    color_size, depth_size = sizes_of(color, depth)
    depth_camera, color_camera = read_camera(depth_source), read_camera(color_source)
    unit = depth_unit(0.001, "ScanNet's convention", config)
    pairs, rule = pair_by_stem(color, depth)
    pose_files = {} if config.ignore_poses else {p.stem: p for p in list_files(folder / POSES, (".txt",))}
    of_depth, of_color = depth_camera.sized(depth_size), color_camera.sized(color_size)
    frames, dropped = frames_with(pairs, unit, lambda pair: View(of_depth, of_color, pose_in(pose_files, pair.name)))
    assumptions = [
        *depth_camera.notes,
        *color_camera.notes,
        f"colour is {color_size[0]}x{color_size[1]}, depth {depth_size[0]}x{depth_size[1]}, each with its own camera "
        "at the same place",
        unit.note,
        rule,
    ]
    if pose_files:
        assumptions.append("poses are camera to world in metres, OpenCV camera axes; -inf means that tracking was lost")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, _extrinsic_warnings(folder))


def _extrinsic_warnings(folder: Path) -> list[str]:
    """The exporter also writes where each camera sits; nearly always the identity, and not used here."""
    files = [p for p in list_files(folder / "intrinsic", (".txt",)) if p.stem.startswith("extrinsic")]
    odd = [p.name for p in files if not np.allclose(read_matrix(p), np.eye(4), atol=1e-4)]
    return [f"{name} is not the identity; it is not applied" for name in odd]


LAYOUT = Layout(
    "scannet", "color/, depth/, intrinsic/intrinsic_depth.txt and intrinsic_color.txt; pose/ for poses", recognise, read
)
