"""ARKitScenes: lowres_depth/, lowres_wide/, lowres_wide_intrinsics/*.pincam, lowres_wide.traj, confidence/.

Format: https://github.com/apple/ARKitScenes, DATA.md and its own data loader. Files are named VIDEO_TIMESTAMP; depth is
in millimetres; a `.pincam` is `width height fx fy cx cy`; a line of the trajectory is a timestamp, a rotation vector
and a translation, world to camera with OpenCV's camera axes. The world has z up.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from realsim.capture.arkit import BEST_CONFIDENCE
from realsim.capture.assemble import View, capture, depth_unit, frames_with, on_two_grids, require_both, size_of_depth
from realsim.capture.association import associate, interpolate_poses, nearest
from realsim.capture.config import CaptureConfig
from realsim.capture.images import ConfidenceImage
from realsim.capture.intrinsics import Camera, no_intrinsics
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.listing import Pair, lacking, list_files, pose_file
from realsim.capture.poses import no_common_time, read_rows
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_text
from realsim.core.geometry import exp_so3, invert_T, make_T
from realsim.core.types import F64, Dropped, FrameSet, Intrinsics

DEPTH, COLOR, CAMERAS, CONFIDENCE = "lowres_depth", "lowres_wide", "lowres_wide_intrinsics", "confidence"
TRAJECTORY = "lowres_wide.traj"
SAME_TIME = 0.005
"""Seconds by which names and trajectory differ for one and the same frame, as the dataset's own loader allows."""


def root_of(folder: Path) -> Path:
    """The folder with lowres_depth/: the given one, or the only `*_frames` in it (the detection subset)."""
    inner = [p for p in sorted(folder.glob("*_frames")) if (p / DEPTH).is_dir()] if folder.is_dir() else []
    return inner[0] if len(inner) == 1 and not (folder / DEPTH).is_dir() else folder


def recognise(folder: Path) -> Recognition:
    root = root_of(folder)
    parts = {
        f"depth images ({DEPTH}/)": list_files(root / DEPTH, (".png",)),
        f"colour images ({COLOR}/)": list_files(root / COLOR, (".png",)),
        f"intrinsics ({CAMERAS}/*.pincam)": list_files(root / CAMERAS, (".pincam",)),
    }
    evidence = tuple(f"{files[0].parent.name}/" for files in parts.values() if files)
    return Recognition(evidence, lacking(parts), score=40) if evidence else Recognition()


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    root = root_of(folder)
    color_times, color = timed(root / COLOR, ".png")
    depth_times, depth = timed(root / DEPTH, ".png")
    camera_times, cameras = timed(root / CAMERAS, ".pincam")
    sure_times, sure = timed(root / CONFIDENCE, ".png")
    require_both(color, depth, root, f"{COLOR}/ and {DEPTH}/ with images")
    if not cameras:
        raise no_intrinsics(root, (f"{CAMERAS}/*.pincam",), f"download the asset {CAMERAS} of this video")
    depth_size = size_of_depth(depth)
    unit = depth_unit(0.001, "ARKitScenes' convention", config)
    matches = associate(color_times, depth_times, config.max_time_difference)
    times = {color[i].stem: float(color_times[i]) for i, _ in matches}
    pairs = [Pair(color[i].stem, color[i], depth[j]) for i, j in matches]
    reason = f"no depth image within {config.max_time_difference:g} s"
    lonely = tuple(Dropped(p.stem, reason) for p in color if p.stem not in times)
    trajectory = None if config.ignore_poses else pose_file(root, (TRAJECTORY,))
    posed = trajectory is not None
    poses = {} if trajectory is None else poses_at(trajectory, times, config)

    def view_of(pair: Pair) -> View:
        time = times[pair.name]
        at = _closest(camera_times, time)
        if at is None:
            raise CaptureError("there are no intrinsics for this frame")
        of_depth, of_color = on_two_grids(_read_pincam(cameras[at]), depth_size)
        if posed and poses[pair.name] is None:
            raise PoseError(f"no pose in {TRAJECTORY} within {config.max_pose_gap:g} s")
        known = _closest(sure_times, time)
        confidence = None if known is None else ConfidenceImage(sure[known], BEST_CONFIDENCE)
        return View(of_depth, of_color, poses.get(pair.name), time, confidence)

    frames, dropped = frames_with(pairs, unit, view_of)
    assumptions = [
        unit.note,
        "every frame has intrinsics of its own (.pincam)",
        "colour and depth of the same time show the same view",
    ]
    if posed:
        assumptions += [
            f"{TRAJECTORY} holds world to camera (rotation vector, translation in metres), OpenCV camera axes: "
            "inverted here",
            "the world has z up",
        ]
    up = np.array([0.0, 0.0, 1.0]) if posed else None
    return capture(folder, LAYOUT.name, frames, lonely + dropped, assumptions, up_world=up)


def timed(folder: Path, suffix: str) -> tuple[F64, list[Path]]:
    """Strictly increasing seconds after the last `_` of the names, and the files."""
    found: dict[float, Path] = {}
    for path in list_files(folder, (suffix,)):
        try:
            found.setdefault(float(path.stem.rpartition("_")[2]), path)
        except ValueError:
            continue
    order = sorted(t for t in found if np.isfinite(t))
    return np.array(order), [found[t] for t in order]


def poses_at(path: Path, times: Mapping[str, float], config: CaptureConfig) -> dict[str, F64 | None]:
    """Name -> (4, 4) camera to world at its time: the sample of that time, or between samples that are close enough."""
    stamps, poses = read_trajectory(path)
    at = np.array(list(times.values()))
    closest = nearest(stamps, at)
    between = interpolate_poses(stamps, poses, at, config.max_pose_gap)
    found = {
        name: poses[k] if abs(stamps[k] - t) <= SAME_TIME else T
        for (name, t), k, T in zip(times.items(), closest, between, strict=True)
    }
    if all(T is None for T in found.values()):
        raise no_common_time(path, at, stamps)
    return found


def read_trajectory(path: Path) -> tuple[F64, F64]:
    """(N,) increasing seconds and (N, 4, 4) camera to world; rows with NaN are left out.

    Raises:
        PoseError: a row of the wrong length or with something that is not a number, or no usable row.
    """
    samples: dict[float, F64] = {}
    for row in read_rows(path, "timestamp rx ry rz tx ty tz"):
        if np.isfinite(row).all() and np.abs(row[1:4]).max() < 100:
            samples.setdefault(float(row[0]), invert_T(make_T(exp_so3(row[1:4]), row[4:])))
    if not samples:
        raise PoseError("no usable pose", file=path)
    order = sorted(samples)
    return np.array(order), np.array([samples[t] for t in order])


def _closest(times: F64, at: float) -> int | None:
    if not len(times):
        return None
    k = int(nearest(times, np.array([at]))[0])
    return k if abs(times[k] - at) <= SAME_TIME else None


def _read_pincam(path: Path) -> Intrinsics:
    words = read_text(path, 2**16).split()
    try:
        width, height, fx, fy, cx, cy = (float(word) for word in words)
    except ValueError as error:
        raise CaptureError("not a .pincam file", file=path, expected="width height fx fy cx cy") from error
    if not (0 < width < 1e5 and 0 < height < 1e5):
        raise CaptureError("an impossible image size", file=path, found=f"{width:g}x{height:g}")
    return Camera(fx, fy, cx, cy, int(width), int(height), path).sized((int(width), int(height)))


LAYOUT = Layout(
    "arkitscenes", "lowres_depth/, lowres_wide/ and lowres_wide_intrinsics/ of ARKitScenes", recognise, read, PHONE
)
