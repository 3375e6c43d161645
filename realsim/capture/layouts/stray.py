"""Stray Scanner: rgb.mp4, depth/, confidence/, odometry.csv, camera_matrix.csv.

Format: https://github.com/strayrobots/scanner, docs/format.md and its encoders. Depth is in millimetres (`.png`, in old
versions `.npy`), confidence in ARKit's levels. The odometry holds positions in ARKit's world and quaternions x y z w
that the app has already turned to OpenCV's camera axes. Its header tells the versions apart: `x, y, z, qx, ...` alone,
with `timestamp, frame` before, or also with `fx, fy, cx, cy` after.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from realsim.capture.arkit import BEST_CONFIDENCE, GRIDS_NOTE, UP, WORLD_NOTE, pose_xyzw
from realsim.capture.assemble import (
    View,
    capture,
    collect,
    depth_unit,
    on_two_grids,
    one_line,
    require_both,
    size_of_depth,
)
from realsim.capture.config import CaptureConfig
from realsim.capture.images import ConfidenceImage, DepthImage
from realsim.capture.intrinsics import Camera, no_intrinsics, read_camera
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.listing import lacking, last_number, list_files, pose_file
from realsim.capture.video import VideoFrame, open_video
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_text
from realsim.core.types import Dropped, Frame, FrameSet

VIDEO, ODOMETRY, CAMERA = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
OWN_CAMERA = ("fx", "fy", "cx", "cy")
HEADERS = {7: POSE, 9: ("timestamp", "frame", *POSE)}
"""Columns of files without a header, which the first version wrote, by their count."""


@dataclass(frozen=True)
class Row:
    """One row of the odometry."""

    frame: int
    values: Mapping[str, str]

    def has(self, names: tuple[str, ...]) -> bool:
        """Whether something stands in all of the named columns."""
        return all(self.values.get(name) for name in names)

    def numbers(self, names: tuple[str, ...]) -> list[float] | None:
        """The named columns, or None where one is absent or empty (the app leaves out what the phone does not say).

        Raises:
            PoseError: something else than a number.
        """
        if not self.has(names):
            return None
        try:
            return [float(self.values[name]) for name in names]
        except ValueError as error:
            raise PoseError("a row of the odometry holds something that is not a number", found=str(error)) from error


def recognise(folder: Path) -> Recognition:
    there = [name for name in (ODOMETRY, VIDEO, CAMERA) if (folder / name).is_file()]
    if ODOMETRY not in there and CAMERA not in there:
        return Recognition()
    parts = {"depth images (depth/)": list_files(folder / "depth", (".png", ".npy"))}
    named = {f"colour images ({VIDEO})": VIDEO in there, f"intrinsics ({CAMERA})": CAMERA in there}
    return Recognition(tuple(there), lacking({**parts, **named}), score=35)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    depth = {n: p for p in list_files(folder / "depth", (".png", ".npy")) if (n := last_number(p.stem)) is not None}
    require_both((folder / VIDEO).is_file(), depth, folder, f"{VIDEO}, and depth/000000.png and so on")
    if not (folder / CAMERA).is_file():
        raise no_intrinsics(folder, (CAMERA,))
    video = open_video(folder / VIDEO)
    depth_size = size_of_depth(depth.values())
    unit = depth_unit(0.001, "Stray Scanner's convention", config, arrays=True)
    warnings: list[str] = []
    table: dict[int, Row] = {}
    try:
        odometry = pose_file(folder, (ODOMETRY,))
        table = {} if odometry is None else read_odometry(odometry)
    except PoseError as error:
        # Its poses are not wanted, and the camera has a file of its own.
        if not config.ignore_poses:
            raise
        warnings.append(f"{ODOMETRY} cannot be read: {one_line(error)}")
    posed = bool(table) and not config.ignore_poses
    sure = {n: p for p in list_files(folder / "confidence", (".png",)) if (n := last_number(p.stem)) is not None}
    camera = read_camera(folder / CAMERA)

    def frame_of(number: int) -> Frame:
        row = table.get(number)
        if number >= video.count:
            raise CaptureError(f"the video ends before this frame: it has {video.count}")
        own = row.numbers(OWN_CAMERA) if row else None
        its = camera if own is None else Camera(own[0], own[1], own[2], own[3], None, None, camera.source)
        of_depth, of_color = on_two_grids(its.sized(video.size), depth_size)
        pose = row.numbers(POSE) if row and posed else None
        if posed and pose is None:
            raise PoseError("there is no pose for this frame")
        time = row.numbers(("timestamp",)) if row else None
        sure_of = ConfidenceImage(sure[number], BEST_CONFIDENCE) if number in sure else None
        view = View(of_depth, of_color, None if pose is None else pose_xyzw(pose), time[0] if time else None, sure_of)
        image = DepthImage(depth[number], unit.integer, unit.floating)
        return view.frame(f"{number:06d}", image, VideoFrame(video.path, number), (video.path, depth[number]))

    frames, dropped = collect({f"{number:06d}": number for number in sorted(depth)}, frame_of)
    dropped += tuple(Dropped(f"{n:06d}", "colour without depth") for n in sorted(table.keys() - depth.keys()))
    own = any(row.has(OWN_CAMERA) for row in table.values())
    assumptions = [
        unit.note,
        GRIDS_NOTE,
        f"every frame has intrinsics of its own, in {ODOMETRY}" if own else f"{CAMERA} is the camera of all frames",
        "the n-th image of the video belongs to depth image n",
    ]
    if posed:
        assumptions += [
            "poses are camera to world in metres, OpenCV camera axes (the app turns ARKit's itself), written as "
            "x y z qx qy qz qw",
            WORLD_NOTE,
        ]
    if table and video.count < len(table):
        warnings.append(f"{VIDEO} has {video.count} images for {len(table)} poses: the rest has no colour")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, warnings, UP if posed else None)


def read_odometry(path: Path) -> dict[int, Row]:
    """Frame number -> row.

    Raises:
        PoseError: no poses in it, or rows of different length.
    """
    lines = [[w.strip() for w in line.split(",")] for line in read_text(path).splitlines() if line.strip()]
    if not lines:
        raise PoseError("the odometry is empty", file=path)
    headed = any(word.isalpha() for word in lines[0] if word not in ("nan", "inf"))
    header = tuple(lines[0]) if headed else HEADERS.get(len(lines[0]), ())
    if not set(POSE) <= set(header):
        raise PoseError(
            "this header is not known",
            file=path,
            expected=f"columns {', '.join(POSE)}",
            found=", ".join(lines[0])[:120],
        )
    rows: dict[int, Row] = {}
    for place, words in enumerate(lines[headed:]):
        if len(words) != len(header):
            raise PoseError(
                f"row {place + 1} has the wrong length", file=path, expected=f"{len(header)}", found=f"{len(words)}"
            )
        values = dict(zip(header, words, strict=True))
        word = values.get("frame", str(place))
        if not word.isdigit():
            raise PoseError(f"row {place + 1} has no frame number", file=path, found=word)
        rows.setdefault(int(word), Row(int(word), values))
    return rows


LAYOUT = Layout("stray", "rgb.mp4, depth/, odometry.csv and camera_matrix.csv of Stray Scanner", recognise, read, PHONE)
