"""Replica as NICE-SLAM rendered it: results/frame*.jpg and depth*.png, traj.txt, and cam_params.json one folder up.

Conventions (its reader of this set): sixteen numbers a line of `traj.txt`, camera to world with OpenCV camera axes, row
by row; `scale` in the camera's file is steps of depth a metre.
"""

from pathlib import Path

from realsim.capture.assemble import View, cameras, capture, depth_unit, frames_with, require_both
from realsim.capture.config import CaptureConfig
from realsim.capture.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from realsim.capture.intrinsics import no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, first_file, lacking, list_files, pair_by_stem
from realsim.capture.poses import parse_matrix
from realsim.core.errors import PoseError
from realsim.core.files import read_text
from realsim.core.types import FrameSet

IMAGES, TRAJECTORY, CAMERA = "results", "traj.txt", "cam_params.json"


def camera_file(folder: Path) -> Path | None:
    return first_file(folder, (CAMERA,)) or first_file(folder.parent, (CAMERA,))


def recognise(folder: Path) -> Recognition:
    depth = [p for p in list_files(folder / IMAGES, DEPTH_SUFFIXES) if p.stem.startswith("depth")]
    trajectory = first_file(folder, (TRAJECTORY,))
    if not depth or trajectory is None:
        return Recognition()
    camera = camera_file(folder)
    missing = lacking({f"intrinsics ({CAMERA}, here or one folder up)": camera})
    return Recognition((f"{IMAGES}/depth*", TRAJECTORY), missing, score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    color = [p for p in list_files(folder / IMAGES, COLOR_SUFFIXES) if p.stem.startswith("frame")]
    depth = [p for p in list_files(folder / IMAGES, DEPTH_SUFFIXES) if p.stem.startswith("depth")]
    require_both(color, depth, folder, f"frame* and depth* in {IMAGES}/")
    source = camera_file(folder)
    if source is None:
        raise no_intrinsics(folder, (CAMERA,))
    camera = read_camera(source)
    of_depth, of_color, assumed = cameras(camera, color, depth)
    unit = depth_unit(1 / 6553.5, "Replica's convention", config, camera)
    pairs, rule = pair_by_stem(color, depth)
    path = folder / TRAJECTORY
    lines = [] if config.ignore_poses else [line for line in read_text(path).splitlines() if line.strip()]
    if lines and len(lines) != len(pairs):
        raise PoseError("not one pose a frame", file=path, expected=f"{len(pairs)} lines", found=f"{len(lines)}")
    line_of = dict(zip((pair.name for pair in pairs), lines, strict=False))

    def view_of(pair: Pair) -> View:
        return View(of_depth, of_color, parse_matrix(line_of[pair.name], path) if line_of else None)

    frames, dropped = frames_with(pairs, unit, view_of)
    assumptions = [*camera.notes, *assumed, unit.note, rule]
    if lines:
        assumptions.append("poses are camera to world in metres, OpenCV camera axes, one line a frame")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, camera.warnings)


LAYOUT = Layout("replica", "results/frame*.jpg and depth*.png, traj.txt, cam_params.json", recognise, read)
