"""From file names and conventions to lazy frames: what every layout of image folders has in common."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from realsim.capture.config import CaptureConfig
from realsim.capture.images import ColorImage, DepthImage, common_size
from realsim.capture.intrinsics import Camera
from realsim.capture.listing import Pair
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.types import F32, F64, U8, Dropped, Frame, FrameSet, Intrinsics

Item = TypeVar("Item")


@dataclass(frozen=True)
class DepthUnit:
    """Meaning of the values of depth images."""

    integer: float
    """Metres a step of integer images."""
    floating: float
    """Metres per unit of floating-point images."""
    note: str
    """Its origin, one sentence."""


def depth_unit(
    default: float, why: str, config: CaptureConfig, camera: Camera | None = None, *, arrays: bool = False
) -> DepthUnit:
    """The requested unit, otherwise that of the camera's file, otherwise the layout's convention; `arrays`: which holds
    for floating-point images too."""
    if config.depth_unit is not None:
        note = f"depth is in steps of {config.depth_unit:g} m, as requested"
        return DepthUnit(config.depth_unit, config.depth_unit, note)
    if camera is not None and camera.depth_unit is not None:
        note = f"integer depth is in steps of {camera.depth_unit:g} m ({camera.source.name})"
        return DepthUnit(camera.depth_unit, 1.0, note)
    if arrays:
        return DepthUnit(default, default, f"depth is in steps of {default:g} m ({why}, for arrays too)")
    return DepthUnit(default, 1.0, f"integer depth is in steps of {default:g} m ({why})")


def require_both(color: object, depth: object, where: Path, expected: str, hint: str | None = None) -> None:
    """Refuse a capture that has no colour images, or no depth images: `color` and `depth` are what was found of each.

    Raises:
        CaptureError: one of them is empty.
    """
    if not color or not depth:
        what = "colour without depth" if not depth else "depth without colour"
        raise CaptureError(what, file=where, expected=expected, hint=hint)


def size_of_depth(depth: Iterable[Path]) -> tuple[int, int]:
    """(width, height) of most depth images.

    Raises:
        CaptureError: none can be read.
    """
    paths = list(depth)
    found = common_size(DepthImage(p, 1.0) for p in paths)
    if found is None:
        raise _no_depth(paths)
    return found


def sizes_of(color: Iterable[Path], depth: Iterable[Path]) -> tuple[tuple[int, int], tuple[int, int]]:
    """(width, height) of most colour images, and of most depth images.

    Raises:
        CaptureError: none of one kind can be read.
    """
    paths = list(color)
    found = common_size(ColorImage(p) for p in paths)
    if found is None:
        raise CaptureError("no colour image can be read", file=paths[0].parent if paths else None)
    return found, size_of_depth(depth)


def _no_depth(depth: Sequence[Path]) -> CaptureError:
    """The error of a capture none of whose depth images can be read: what is wrong with the first."""
    found, hint = "none", None
    if depth:
        try:
            DepthImage(depth[0], 1.0)()
        except RealsimError as error:
            found, hint = f"{depth[0].name}: {one_line(error)}", error.hint
    where = depth[0].parent if depth else None
    return CaptureError(
        "no depth image can be read", file=where, expected="16-bit or float images", found=found, hint=hint
    )


def cameras(
    camera: Camera, color: Sequence[Path], depth: Sequence[Path]
) -> tuple[Intrinsics, Intrinsics | None, tuple[str, ...]]:
    """(camera of the depth images, camera of the colour images or None if the same, what was assumed).

    One camera is given for both. Where colour and depth differ in size but not in shape, they are taken to be the same
    view on two grids; the camera belongs to the one whose size it names.

    Raises:
        CaptureError: no image can be read, or the camera fits neither.
    """
    depth_size = size_of_depth(depth)
    color_size = common_size(ColorImage(p) for p in color)
    if color_size in (None, depth_size):
        return camera.sized(depth_size), None, ()
    named = (camera.width, camera.height)
    if abs(color_size[0] / color_size[1] - depth_size[0] / depth_size[1]) > 0.02 * depth_size[0] / depth_size[1]:
        raise CaptureError(
            "colour and depth images are of different shape and there are intrinsics for only one of them",
            file=camera.source,
            found=f"colour {_text(color_size)}, depth {_text(depth_size)}",
            hint="register the colour to the depth, or give both cameras (layout scannet)",
        )
    if named == (None, None):
        # Without a size in the file the principal point tells: it is near the middle of the image it belongs to.
        named = min((color_size, depth_size), key=lambda s: abs(camera.cx / s[0] - 0.5) + abs(camera.cy / s[1] - 0.5))
    if named == depth_size:
        of_depth = camera.sized(depth_size)
        of_color = of_depth.resized(*color_size)
    else:
        of_color = camera.sized(color_size)
        of_depth = of_color.resized(*depth_size)
    assumption = (
        f"colour ({_text(color_size)}) and depth ({_text(depth_size)}) are the same view on two grids; "
        f"{camera.source.name} is the camera of the {'depth' if named == depth_size else 'colour'} images"
    )
    return of_depth, of_color, (assumption,)


@dataclass(frozen=True)
class View:
    """Data of one frame besides its images; the fields are those of `Frame`."""

    intrinsics: Intrinsics
    color_intrinsics: Intrinsics | None = None
    T_world_camera: F64 | None = None
    timestamp: float | None = None
    read_confidence: Callable[[], F32] | None = None

    def frame(
        self, name: str, depth: Callable[[], F32], color: Callable[[], U8] | None, files: tuple[Path, ...]
    ) -> Frame:
        """With its images."""
        return Frame(
            name, self.intrinsics, depth, color, self.color_intrinsics, self.read_confidence, self.T_world_camera,
            self.timestamp, files,
        )  # fmt: skip


def on_two_grids(of_color: Intrinsics, depth_size: tuple[int, int]) -> tuple[Intrinsics, Intrinsics | None]:
    """(camera of the depth, camera of the colour or None if the same) where both show the same view, as phones do."""
    if (of_color.width, of_color.height) == depth_size:
        return of_color, None
    return of_color.resized(*depth_size), of_color


def frames_with(
    pairs: Sequence[Pair], unit: DepthUnit, view_of: Callable[[Pair], View], *, with_color: bool = True
) -> tuple[tuple[Frame, ...], tuple[Dropped, ...]]:
    """One lazy frame a pair; incomplete pairs and frames whose camera or pose cannot be read are dropped and named.

    Args:
        view_of: may raise a RealsimError, which costs that frame only.
        with_color: whether this capture has colour, so that a frame without it is incomplete.
    """

    def frame_of(pair: Pair) -> Frame:
        if pair.depth is None:
            raise CaptureError("colour without depth")
        if pair.color is None and with_color:
            raise CaptureError("depth without colour")
        color = None if pair.color is None else ColorImage(pair.color)
        files = tuple(p for p in (pair.color, pair.depth) if p is not None)
        return view_of(pair).frame(pair.name, DepthImage(pair.depth, unit.integer, unit.floating), color, files)

    return collect({pair.name: pair for pair in pairs}, frame_of)


def collect(
    items: Mapping[str, Item], frame_of: Callable[[Item], Frame]
) -> tuple[tuple[Frame, ...], tuple[Dropped, ...]]:
    """The frame of each named item; `frame_of` may raise a RealsimError, which costs that frame only."""
    frames: list[Frame] = []
    dropped: list[Dropped] = []
    for name, item in items.items():
        try:
            frames.append(frame_of(item))
        except RealsimError as error:
            dropped.append(Dropped(name, one_line(error)))
    return tuple(frames), tuple(dropped)


def one_line(error: RealsimError) -> str:
    """An error as the reason why a frame is not used: without the path, which the frame's name stands for."""
    details = [f"{word} {value}" for word, value in (("expected", error.expected), ("found", error.found)) if value]
    return error.message + (f" ({', '.join(details)})" if details else "")


def capture(
    path: Path,
    layout: str,
    frames: tuple[Frame, ...],
    dropped: tuple[Dropped, ...],
    assumptions: Sequence[str],
    warnings: Sequence[str] = (),
    up_world: F64 | None = None,
) -> FrameSet:
    """The frame set of a layout, refused if it is empty. Warnings that repeat (one per frame) are kept once."""
    if not frames:
        reasons = "; ".join(f"{d.name}: {d.reason}" for d in dropped[:3]) or "no images"
        raise CaptureError("no frame of this capture can be used", file=path, found=reasons)
    return FrameSet(
        frames,
        path,
        layout,
        up_world=up_world,
        assumptions=tuple(dict.fromkeys(assumptions)),
        warnings=tuple(dict.fromkeys(warnings)),
        dropped=dropped,
    )


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
