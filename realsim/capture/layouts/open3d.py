"""Open3D dataset folder: color|image|rgb/, depth/, camera_intrinsic.json, trajectory.log.

Conventions: http://www.open3d.org/docs (reconstruction system, file formats): the camera matrix is written column by
column, depth is in millimetres, `trajectory.log` holds camera-to-world matrices under headers `i i i+1`.
"""

from collections.abc import Sequence
from os.path import lexists
from pathlib import Path

from realsim.capture.assemble import View, cameras, capture, depth_unit, frames_with, require_both
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import Camera, no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import (
    Pair,
    color_folder,
    depth_folder,
    first_file,
    image_files,
    lacking,
    last_number,
    pair_by_stem,
    pose_file,
)
from realsim.capture.poses import parse_matrix
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_text
from realsim.core.types import F64, FrameSet

INTRINSICS = ("camera_intrinsic.json", "camera_intrinsics.json", "intrinsic.json")
PLAIN = ("intrinsics.json", "intrinsics.yaml", "intrinsics.txt")
CAM_PARAMS = "*cam_params*.json"
TRAJECTORIES = ("trajectory.log", "scene/trajectory.log")
LEFT = (*TRAJECTORIES, "odometry.log", "rgbd.match")
"""What Open3D leaves in a folder: beside one of these, a camera that is not given is Open3D's default."""
PRIMESENSE = (525.0, 525.0, 319.5, 239.5, 640, 480)
"""fx fy cx cy width height of `PinholeCameraIntrinsicParameters.PrimeSenseDefault`."""


def intrinsics_file(folder: Path) -> Path | None:
    """Open3D's own name first, then what RealSense scripts leave (`cam_params_realsense.json`), then a plain folder's
    names, but only beside a trajectory: without one it is layout `plain`.
    """
    candidates = [folder / name for name in INTRINSICS] + sorted(folder.glob(CAM_PARAMS))
    if trajectory_file(folder) is not None:
        candidates += [folder / name for name in PLAIN]
    return next(filter(lexists, candidates), None)


def trajectory_file(folder: Path) -> Path | None:
    return first_file(folder, TRAJECTORIES)


def default_camera(folder: Path) -> Camera | None:
    """Open3D's own default, for a folder of Open3D's without a camera; None for other folders."""
    left = first_file(folder, LEFT)
    if left is None:
        return None
    text = (
        "no camera in the folder: Open3D's default was taken, a PrimeSense of 640x480 with fx = fy = 525; if that is "
        f"wrong, write {INTRINSICS[0]}"
    )
    return Camera(*PRIMESENSE, source=left, warnings=(text,))


def recognise(folder: Path) -> Recognition:
    camera, trajectory = intrinsics_file(folder), trajectory_file(folder)
    evidence = [p.name for p in (camera, trajectory) if p is not None]
    evidence = evidence or [name for name in LEFT if (folder / name).is_file()]
    if not evidence:
        return Recognition()
    color, depth = color_folder(folder), depth_folder(folder)
    evidence += [f"{p.name}/" for p in (color, depth) if p is not None]
    missing = lacking({"depth images (depth/)": depth, "colour images (color/, image/ or rgb/)": color})
    return Recognition(tuple(evidence), missing, score=10 + 10 * (trajectory is not None))


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    source = intrinsics_file(folder)
    camera = default_camera(folder) if source is None else read_camera(source)
    if camera is None:
        raise no_intrinsics(folder, (*INTRINSICS, CAM_PARAMS))
    color, depth = image_files(folder)
    require_both(color, depth, folder, "color/ and depth/ with images")
    pairs, rule = pair_by_stem(color, depth, config.max_time_difference)
    try:
        of_depth, of_color, assumed = cameras(camera, color, depth)
    except CaptureError as error:
        if source is None:  # images of another size than the default camera's
            raise no_intrinsics(folder, (*INTRINSICS, CAM_PARAMS)) from error
        raise
    unit = depth_unit(0.001, "Open3D's convention", config, camera)
    assumptions = [*camera.notes, *assumed, rule, unit.note, "depth is registered to colour"]

    trajectory = None if config.ignore_poses else pose_file(folder, TRAJECTORIES)
    poses: dict[str, F64] = {}
    if trajectory is not None:
        headers, matrices = read_trajectory(trajectory)
        poses, pose_rule = poses_by_name(pairs, headers, matrices, trajectory)
        assumptions += ["poses are camera to world in metres, OpenCV camera axes", pose_rule]
    frames, dropped = frames_with(pairs, unit, lambda pair: View(of_depth, of_color, poses.get(pair.name)))
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, camera.warnings)


def read_trajectory(path: Path) -> tuple[list[int], list[F64]]:
    """Frame numbers and camera-to-world matrices of a `.log` file: a header `i j k`, then four rows, repeated.

    Raises:
        PoseError: the lines do not come in fives, or hold something else.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    if len(lines) % 5:
        raise PoseError(
            "the trajectory is cut off or not of this format",
            file=path,
            expected="five lines per pose: a header of three integers and four rows of a matrix",
            found=f"{len(lines)} lines",
        )
    headers, matrices = [], []
    for at in range(0, len(lines), 5):
        header = lines[at].split()
        if len(header) != 3 or not all(word.lstrip("-").isdigit() for word in header):
            raise PoseError(
                f"no header where pose {at // 5} should start",
                file=path,
                expected="three integers",
                found=lines[at][:60],
            )
        headers.append(int(header[0]))
        matrices.append(parse_matrix(" ".join(lines[at + 1 : at + 5]), path))
    return headers, matrices


def poses_by_name(
    pairs: Sequence[Pair], headers: Sequence[int], matrices: Sequence[F64], path: Path
) -> tuple[dict[str, F64], str]:
    """Which pose belongs to which frame, and the rule that was used.

    As many poses as frames go by position. Otherwise the first number of each header has to name the frames, by the
    number in their file name; a trajectory that merely ended early or late could belong anywhere and is refused.
    """
    if len(matrices) == len(pairs):
        rule = "the n-th pose of trajectory.log belongs to the n-th frame"
        return {pair.name: T for pair, T in zip(pairs, matrices, strict=True)}, rule
    numbers = [last_number(pair.name) for pair in pairs]
    by_number = dict(zip(headers, matrices, strict=True))
    named = {n for n in numbers if n is not None}
    unique = len(by_number) == len(matrices)
    gaps = max(by_number, default=0) - min(by_number, default=0) + 1 != len(by_number)
    if unique and (named <= by_number.keys() or (gaps and by_number.keys() <= named)):
        poses = {p.name: by_number[n] for p, n in zip(pairs, numbers, strict=True) if n is not None and n in by_number}
        return poses, "the first number of a header in trajectory.log is the number in the frame's file name"
    raise PoseError(
        "the trajectory has another length than the capture",
        file=path,
        expected=f"{len(pairs)} poses, one per frame",
        found=f"{len(matrices)} poses",
        hint="fix the trajectory, or pass --ignore-poses to have the poses estimated",
    )


LAYOUT = Layout(
    "open3d",
    "color/ (or image/, rgb/) and depth/ with camera_intrinsic.json (or *cam_params*.json), trajectory.log for poses",
    recognise,
    read,
)
