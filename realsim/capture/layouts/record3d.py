"""Record3D's `.r3d`: a zip archive with `metadata` (JSON) and rgbd/0.jpg, 0.depth, 0.conf, 1.jpg, ...

Depth is LZFSE-compressed float32 in metres on the grid `dh` x `dw`, confidence LZFSE-compressed uint8 in ARKit's
levels. In the metadata, `K` is the colour camera's matrix column by column, `perFrameIntrinsicCoeffs` fx fy cx cy of
each frame, and `poses` are qx qy qz qw tx ty tz with ARKit's camera axes.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture import lzfse
from realsim.capture.archive import Member, names
from realsim.capture.arkit import AXES_NOTE, BEST_CONFIDENCE, GRIDS_NOTE, OPENGL, UP, WORLD_NOTE, from_opengl, pose_xyzw
from realsim.capture.assemble import View, capture, collect, on_two_grids
from realsim.capture.config import CaptureConfig
from realsim.capture.images import MAX_IMAGE_BYTES, MAX_PIXELS, confidence, decode_color, metres
from realsim.capture.intrinsics import camera_from_mapping, check
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.listing import single_file
from realsim.capture.numbers import table_of
from realsim.core.errors import CaptureError, PoseError, RealsimError
from realsim.core.files import MAX_TEXT_BYTES, parse_json
from realsim.core.types import F32, F64, U8, Frame, FrameSet, Intrinsics

MEMBER = re.compile(r"rgbd/(\d{1,9})\.(jpg|depth)")
"""A frame's colour or depth in the archive."""
DEPTH_SIZES = ((256, 192), (640, 480), (320, 240))
"""(width, height) in landscape of LiDAR and TrueDepth maps, for files from before `dw` and `dh` were written."""


@dataclass(frozen=True)
class Metadata:
    """Content of `metadata`, checked for shape only."""

    source: Path
    color_size: tuple[int, int]
    depth_size: tuple[int, int] | None
    shared: Intrinsics
    """The camera of the colour images where a frame has none of its own."""
    cameras: F64 | None
    """(N, 4) fx fy cx cy, or None."""
    poses: F64 | None
    """(N, 7) qx qy qz qw tx ty tz, or None."""
    times: F64 | None
    """(N,) seconds, or None."""

    def camera(self, i: int) -> Intrinsics:
        """Camera of frame i's colour image."""
        if self.cameras is None or i >= len(self.cameras):
            return self.shared
        return check(Intrinsics(*self.color_size, *(float(v) for v in self.cameras[i])), self.source)

    def pose(self, i: int) -> F64 | None:
        """(4, 4) camera to world, OpenCV axes; None without any poses."""
        if self.poses is None:
            return None
        if i >= len(self.poses):
            raise PoseError("there is no pose for this frame")
        # Rotation first in the file, position first in `pose_xyzw`.
        return from_opengl(pose_xyzw(self.poses[i][[4, 5, 6, 0, 1, 2, 3]]))

    def time(self, i: int) -> float | None:
        return None if self.times is None or i >= len(self.times) else float(self.times[i])

    @property
    def relative(self) -> bool | None:
        """Whether the first pose is the identity: then the world is the first camera's, not ARKit's. None without any
        poses, and where the first cannot be read: that costs its frame, and what it would have told.
        """
        try:
            first = self.pose(0)
        except RealsimError:
            return None
        if first is None or not np.isfinite(first).all():
            return None
        return bool(np.abs(first @ OPENGL - np.eye(4)).max() < 1e-3)


@dataclass(frozen=True)
class ZippedDepth:
    """`()` -> (H, W) float32 metres, 0 where invalid."""

    member: Member
    size: tuple[int, int]

    def __call__(self) -> F32:
        width, height = self.size
        return metres(np.frombuffer(_unpack(self.member, 4 * width * height), "<f4").reshape(height, width))


@dataclass(frozen=True)
class ZippedConfidence:
    """`()` -> (H, W) float32, 0 to 1."""

    member: Member
    size: tuple[int, int]

    def __call__(self) -> F32:
        width, height = self.size
        raw = np.frombuffer(_unpack(self.member, width * height), np.uint8).reshape(height, width)
        return confidence(raw, BEST_CONFIDENCE, Path(self.member.name))


@dataclass(frozen=True)
class ZippedColor:
    """`()` -> (h, w, 3) uint8 RGB."""

    member: Member

    def __call__(self) -> U8:
        return decode_color(self.member.read(), Path(self.member.name))


def recognise(path: Path) -> Recognition:
    found = single_file(path, (".r3d",))
    return Recognition() if found is None else Recognition((found.name,), (), score=40)


def read(path: Path, config: CaptureConfig) -> FrameSet:
    source = single_file(path, (".r3d",))
    if source is None:
        raise CaptureError("no .r3d file", file=path, expected="one .r3d file, or a folder that holds one")
    lzfse.require()
    members = set(names(source))
    found = [match for n in members if (match := MEMBER.fullmatch(n))]
    numbers = sorted({int(match[1]) for match in found})
    if not any(match[2] == "depth" for match in found):
        raise CaptureError("colour without depth", file=source, expected="rgbd/0.depth and so on in the archive")
    data = parse_json(Member(source, "metadata", MAX_TEXT_BYTES).read(), source)
    meta = read_metadata(data, source, config)
    depth_size = meta.depth_size or _known_size(source, numbers, meta.color_size)
    if depth_size[0] * depth_size[1] > MAX_PIXELS:
        raise CaptureError("an impossible depth size", file=source, found=f"{depth_size[0]}x{depth_size[1]}")

    def pictures(number: int) -> Pictures:
        sure = Member(source, f"rgbd/{number}.conf", MAX_IMAGE_BYTES)
        if f"rgbd/{number}.jpg" not in members:
            raise CaptureError("depth without colour")
        if f"rgbd/{number}.depth" not in members:
            raise CaptureError("colour without depth")
        return Pictures(
            ZippedDepth(Member(source, f"rgbd/{number}.depth", MAX_IMAGE_BYTES), depth_size),
            ZippedColor(Member(source, f"rgbd/{number}.jpg", MAX_IMAGE_BYTES)),
            ZippedConfidence(sure, depth_size) if sure.name in members else None,
            (source,),
        )

    return frame_set(path, LAYOUT.name, numbers, meta, depth_size, pictures)


@dataclass(frozen=True)
class Pictures:
    """Loaders of a frame, and the files that it comes from."""

    depth: Callable[[], F32]
    color: Callable[[], U8]
    confidence: Callable[[], F32] | None
    files: tuple[Path, ...]


def frame_set(
    path: Path,
    layout: str,
    numbers: Sequence[int],
    meta: Metadata,
    depth_size: tuple[int, int],
    pictures: Callable[[int], Pictures],
) -> FrameSet:
    """The recording's frames; `pictures` of a number may raise a RealsimError, which costs that frame."""

    def frame_of(place: tuple[int, int]) -> Frame:
        number, at = place
        found = pictures(number)
        of_depth, of_color = on_two_grids(meta.camera(at), depth_size)
        view = View(of_depth, of_color, meta.pose(at), meta.time(at), found.confidence)
        return view.frame(f"{number:06d}", found.depth, found.color, found.files)

    places = zip(numbers, rows(numbers, meta), strict=True)
    frames, dropped = collect({f"{place[0]:06d}": place for place in places}, frame_of)
    assumptions = ["depth is in metres (Record3D's convention)", GRIDS_NOTE, *pose_notes(meta)]
    up = UP if meta.relative is False else None
    return capture(path, layout, frames, dropped, assumptions, up_world=up)


def read_metadata(data: Any, source: Path, config: CaptureConfig) -> Metadata:
    """The metadata of a recording.

    Raises:
        CaptureError: no camera, or a table of another shape.
        PoseError: the poses are no table of seven columns.
    """
    if not isinstance(data, Mapping):
        raise CaptureError("the metadata are not an object", file=source)
    camera = camera_from_mapping({"K": data.get("K"), "w": data.get("w"), "h": data.get("h")}, source)
    if not camera.width or not camera.height:
        raise CaptureError("the metadata lack the image size", file=source, expected="w and h")
    size = (camera.width, camera.height)
    poses = None if config.ignore_poses else _table(data, "poses", 7, source)
    times = _table(data, "frameTimestamps", 1, source)
    depth_size = None
    match data.get("dw"), data.get("dh"):
        case (int(width), int(height)) if width > 0 and height > 0:
            depth_size = (width, height)
    return Metadata(
        source,
        size,
        depth_size,
        camera.sized(size),
        _table(data, "perFrameIntrinsicCoeffs", 4, source),
        poses,
        None if times is None else times[:, 0],
    )


def rows(numbers: Sequence[int], meta: Metadata) -> list[int]:
    """Row of the metadata's tables for each file number: the number itself, or, where the files were numbered anew
    (as many as rows, but not counted from 0), the place in the order.
    """
    count = next((len(t) for t in (meta.poses, meta.cameras, meta.times) if t is not None), 0)
    renumbered = max(numbers) >= count == len(numbers)
    return list(range(len(numbers))) if renumbered else list(numbers)


def pose_notes(meta: Metadata) -> list[str]:
    """Assumptions about cameras and poses."""
    own = ["every frame has intrinsics of its own"] if meta.cameras is not None else ["one camera for all frames"]
    if meta.poses is None:
        return [*own, "no poses are used"]
    if meta.relative is None:
        return [*own, AXES_NOTE, "the first pose cannot be read: up is not known"]
    if meta.relative:
        return [*own, AXES_NOTE, "the first pose is the identity: the world is the first camera's, up is not known"]
    return [*own, AXES_NOTE, WORLD_NOTE]


def _table(data: Mapping[str, Any], key: str, columns: int, source: Path) -> F64 | None:
    """(N, columns) numbers under a key, None if absent or empty."""
    value = data.get(key)
    if not value:
        return None
    try:
        table = table_of(value)
        table = table.reshape(len(table), -1)
    except (TypeError, ValueError) as error:
        raise CaptureError(f"{key} is not a table of numbers", file=source, found=str(error)) from error
    if table.shape[1] != columns:
        kind = PoseError if key == "poses" else CaptureError
        raise kind(f"{key} of the wrong length", file=source, expected=f"{columns} a frame", found=f"{table.shape[1]}")
    return table


def _known_size(source: Path, numbers: Sequence[int], color_size: tuple[int, int]) -> tuple[int, int]:
    """The size of depth maps where the metadata do not say it: that of a known sensor with as many pixels."""
    for number in numbers[:5]:
        try:
            size = lzfse.unpacked_size(Member(source, f"rgbd/{number}.depth", MAX_IMAGE_BYTES).read())
        except (RealsimError, ValueError):
            continue
        for long, short in DEPTH_SIZES:
            if size == 4 * long * short:
                return (long, short) if color_size[0] > color_size[1] else (short, long)
    raise CaptureError("the size of the depth maps is not known", file=source, expected="dw and dh in the metadata")


def _unpack(member: Member, size: int) -> bytes:
    try:
        return lzfse.decompress(member.read(), size)
    except ValueError as error:
        raise CaptureError("corrupt or truncated depth", file=member.name, found=str(error)) from error


LAYOUT = Layout("record3d", "a .r3d file of Record3D, or a folder that holds one", recognise, read, PHONE)
