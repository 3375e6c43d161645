"""TUM RGB-D: rgb.txt, depth.txt, groundtruth.txt with timestamps, depth in 1/5000 m.

Format: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats. Poses are `timestamp tx ty tz qx qy qz qw`,
camera to world. Colour, depth and poses each run on their own clock ticks and are associated by time.
"""

import re
from pathlib import Path

import numpy as np

from realsim.capture.assemble import View, cameras, capture, depth_unit, frames_with
from realsim.capture.association import associate, interpolate_poses
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import Camera, no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, first_file, pose_file, single_file
from realsim.capture.poses import no_common_time, read_rows
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import inside, read_text
from realsim.core.geometry import make_T, quat_to_R
from realsim.core.types import F64, Dropped, FrameSet

INTRINSICS = ("calibration.txt", "camera.txt", "intrinsics.txt", "intrinsics.json", "intrinsics.yaml")
POSES = "groundtruth.txt"


PUBLISHED = {
    "1": (517.3, 516.5, 318.6, 255.3),
    "2": (520.9, 521.0, 325.1, 249.7),
    "3": (535.4, 539.2, 320.1, 247.6),
}
"""fx fy cx cy of the three cameras of the dataset (freiburg1, 2 and 3) by its page; downloads come without them."""


def published_camera(folder: Path) -> Camera | None:
    """The dataset's own camera, by the folder's name (rgbd_dataset_freiburg1_desk, fr1_desk)."""
    found = re.search(r"(?:freiburg|fr)([123])(?![0-9])", folder.resolve().name)
    if found is None:
        return None
    note = (
        f"the camera is the one published for freiburg{found[1]}, by the folder's name; lens distortion is not undone"
    )
    return Camera(*PUBLISHED[found[1]], 640, 480, folder, (note,))


def recognise(folder: Path) -> Recognition:
    lists = [name for name in ("rgb.txt", "depth.txt") if (folder / name).is_file()]
    if not lists:
        return Recognition()
    missing = [f"{what} ({n})" for n, what in (("rgb.txt", "colour"), ("depth.txt", "depth")) if n not in lists]
    camera = intrinsics_file(folder)
    if camera is None and published_camera(folder) is None:
        missing.append(f"intrinsics ({', '.join(INTRINSICS)})")
    evidence = lists + [name for name in (camera.name if camera else "", POSES) if name and (folder / name).is_file()]
    return Recognition(tuple(evidence), tuple(missing), score=30)


def intrinsics_file(folder: Path) -> Path | None:
    """One of the usual names, or the only YAML file, as ORB-SLAM's settings (TUM3.yaml)."""
    return first_file(folder, INTRINSICS) or single_file(folder, (".yaml", ".yml"))


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    source = intrinsics_file(folder)
    camera = published_camera(folder) if source is None else read_camera(source)
    if camera is None:
        hint = (
            "write `fx fy cx cy width height` into calibration.txt, or keep the dataset's folder name (freiburg1 ...)"
        )
        raise no_intrinsics(folder, INTRINSICS, hint)
    for name, what in (("depth.txt", "colour without depth"), ("rgb.txt", "depth without colour")):
        if not (folder / name).is_file():
            raise CaptureError(what, file=folder, expected=name)
    color_times, color, warnings = read_list(folder, "rgb.txt")
    depth_times, depth, more = read_list(folder, "depth.txt")
    warnings += more
    of_depth, of_color, assumed = cameras(camera, color, depth)
    unit = depth_unit(1 / 5000, "TUM's convention", config, camera)

    # File names usually are the timestamps; where they do not tell frames apart, the timestamps themselves do.
    names = [path.stem for path in color]
    if len(set(names)) < len(names):
        names = [f"{t:.6f}" for t in color_times]
    matches = associate(color_times, depth_times, config.max_time_difference)
    if not matches:
        raise CaptureError(
            "the timestamps of colour and depth do not overlap",
            file=folder / "depth.txt",
            expected=f"times within {config.max_time_difference:g} s of colour, {_span(color_times)}",
            found=_span(depth_times),
            hint="fix the timestamps, or pass --max-time-difference",
        )
    times = {names[i]: float(color_times[i]) for i, _ in matches}
    pairs = [Pair(names[i], color[i], depth[j]) for i, j in matches]
    reason = f"no depth image within {config.max_time_difference:g} s"
    lonely = tuple(Dropped(name, reason) for name in names if name not in times)
    assumptions = [
        *camera.notes,
        *assumed,
        unit.note,
        f"colour and depth at most {config.max_time_difference:g} s apart are one frame; its time is that of colour",
        "depth is registered to colour",
    ]
    poses: dict[str, F64] = {}
    trajectory = None if config.ignore_poses else pose_file(folder, (POSES,))
    if trajectory is not None:
        poses, late, pose_notes, pose_warnings = poses_at(trajectory, times, config)
        pairs = [pair for pair in pairs if pair.name in poses]
        lonely += late
        assumptions += pose_notes
        warnings += pose_warnings
    frames, dropped = frames_with(
        pairs, unit, lambda pair: View(of_depth, of_color, poses.get(pair.name), times[pair.name])
    )
    return capture(folder, LAYOUT.name, frames, lonely + dropped, assumptions, warnings + list(camera.warnings))


def read_list(folder: Path, name: str) -> tuple[F64, list[Path], list[str]]:
    """Timestamps, strictly increasing, and image paths of `rgb.txt` or `depth.txt`; what had to be mended, in words."""
    path = folder / name
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or line.startswith("#"):
            continue
        try:
            stamp, image = words
            rows.append((number, float(stamp), inside(folder, image)))
        except ValueError as error:
            raise CaptureError(f"line {number} is not `timestamp filename`", file=path, found=line[:80]) from error
    if not rows:
        raise CaptureError("the list of images is empty", file=path)
    stamps = np.array([t for _, t, _ in rows])
    timed = np.flatnonzero(np.isfinite(stamps))
    times, order, warnings = in_order(stamps[timed], path)
    # Half of the images is less than any recorder loses; so few times are no times.
    if 2 * len(times) < len(rows) or (len(times) == 1 < len(rows)):
        kept = {int(timed[i]) for i in order}
        bad = [f"line {number}: {stamp:g}" for i, (number, stamp, _) in enumerate(rows) if i not in kept]
        raise CaptureError(
            "the timestamps do not tell the images apart",
            file=path,
            expected="seconds, another for each image",
            found=f"{len(bad)} of {len(rows)} that are no times or repeat another ({', '.join(bad[:3])})",
            hint="write the times of recording; 1/30 s apart will do where colour and depth have the same numbers",
        )
    if len(timed) < len(rows):
        lines = ", ".join(str(rows[i][0]) for i in np.flatnonzero(~np.isfinite(stamps))[:5])
        warnings.append(f"{name}: {len(rows) - len(timed)} images without a time are left out (line {lines})")
    return times, [rows[timed[i]][2] for i in order], warnings


def in_order(times: F64, path: Path) -> tuple[F64, list[int], list[str]]:
    """Sorted times without repetitions, the rows they come from, and a warning where the file was neither."""
    order = np.argsort(times, kind="stable")
    keep = order[np.concatenate([[True], np.diff(times[order]) > 0])] if len(order) else order
    warnings = []
    backward = int((np.diff(times) < 0).sum())
    if backward:
        warnings.append(f"{path.name}: timestamps out of order in {backward} places; sorted by time")
    if len(keep) < len(times):
        warnings.append(f"{path.name}: {len(times) - len(keep)} repeated timestamps; the first of each is used")
    return times[keep], [int(i) for i in keep], warnings


def poses_at(
    path: Path, times: dict[str, float], config: CaptureConfig
) -> tuple[dict[str, F64], tuple[Dropped, ...], list[str], list[str]]:
    """Poses of the named frames at their times; frames without one; assumptions; warnings."""
    stamps, poses, warnings = read_trajectory(path)
    names = list(times)
    at = np.array([times[n] for n in names])
    # A pose an image: what its time is off by is how it was written down, as between colour and depth.
    sparse = len(stamps) > 1 and np.median(np.diff(stamps)) > config.max_pose_gap
    beside = config.max_time_difference if sparse else 0.0
    found = interpolate_poses(stamps, poses, at, config.max_pose_gap, beside)
    by_name = {n: T for n, T in zip(names, found, strict=True) if T is not None}
    reason = f"no pose in {path.name} within {beside or config.max_pose_gap:g} s"
    late = tuple(Dropped(n, reason) for n in names if n not in by_name)
    if not by_name:
        raise no_common_time(path, at, stamps)
    between = f"interpolated at the colour image's time between samples at most {config.max_pose_gap:g} s apart"
    notes = [
        "poses are camera to world in metres, OpenCV camera axes, written as tx ty tz qx qy qz qw",
        f"poses are {f'those at most {beside:g} s from the colour image' if sparse else between}",
    ]
    return by_name, late, notes, warnings


def read_trajectory(path: Path) -> tuple[F64, F64, list[str]]:
    """(N,) increasing seconds, (N, 4, 4) camera to world, and what was wrong with the rows that are left out.

    Raises:
        PoseError: a row of the wrong length, or no usable row.
    """
    rows, broken = [], 0
    for row in read_rows(path, "timestamp tx ty tz qx qy qz qw"):
        if np.isfinite(row).all() and abs(np.linalg.norm(row[4:]) - 1) < 0.05:
            rows.append(row)
        else:
            broken += 1
    if not rows:
        raise PoseError("no usable pose", file=path, found=f"{broken} rows with NaN or an invalid quaternion")
    table = np.array(rows)
    times, order, warnings = in_order(table[:, 0], path)
    if broken:
        warnings.append(f"{path.name}: {broken} rows with NaN or an invalid quaternion are left out")
    # The file has the quaternion's real part last, quat_to_R wants it first.
    poses = [make_T(quat_to_R(row[[7, 4, 5, 6]]), row[1:4]) for row in table[order]]
    return times, np.array(poses), warnings


def _span(times: F64) -> str:
    return f"between {times[0]:.3f} and {times[-1]:.3f} s"


LAYOUT = Layout(
    "tum", "rgb.txt and depth.txt (timestamp filename), calibration.txt; groundtruth.txt for poses", recognise, read
)
