"""From file names and conventions to lazy frames: what every layout of image folders has in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from realsim.capture.config import CaptureConfig
from realsim.capture.images import ColorImage, DepthImage, common_size
from realsim.capture.intrinsics import Camera
from realsim.capture.listing import Pair
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.types import F32, F64, Dropped, Frame, FrameSet, Intrinsics


@dataclass(frozen=True)
class DepthUnit:
    """Meaning of the values of depth images."""

    integer: float
    """Metres a step of integer images."""
    floating: float
    """Metres per unit of floating-point images."""
    note: str
    """Its origin, one sentence."""


def depth_unit(default: float, why: str, config: CaptureConfig, camera: Camera | None = None) -> DepthUnit:
    """The requested unit, otherwise that of the camera's file, otherwise the layout's convention."""
    if config.depth_unit is not None:
        note = f"depth is in steps of {config.depth_unit:g} m, as asked for"
        return DepthUnit(config.depth_unit, config.depth_unit, note)
    if camera is not None and camera.depth_unit is not None:
        note = f"integer depth is in steps of {camera.depth_unit:g} m ({camera.source.name})"
        return DepthUnit(camera.depth_unit, 1.0, note)
    return DepthUnit(default, 1.0, f"integer depth is in steps of {default:g} m ({why})")


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
    depth_size = common_size(DepthImage(p, 1.0) for p in depth)
    color_size = common_size(ColorImage(p) for p in color)
    if depth_size is None:
        raise _no_depth(depth)
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


def on_two_grids(of_color: Intrinsics, depth_size: tuple[int, int]) -> tuple[Intrinsics, Intrinsics | None]:
    """(camera of the depth, camera of the colour or None if the same) where both show the same view, as phones do."""
    if (of_color.width, of_color.height) == depth_size:
        return of_color, None
    return of_color.resized(*depth_size), of_color


def frames_of(
    pairs: Sequence[Pair],
    intrinsics: Intrinsics,
    unit: DepthUnit,
    *,
    color_intrinsics: Intrinsics | None = None,
    with_color: bool = True,
    pose_of: Callable[[Pair], F64 | None] = lambda pair: None,
    time_of: Callable[[Pair], float | None] = lambda pair: None,
) -> tuple[tuple[Frame, ...], tuple[Dropped, ...]]:
    """`frames_with` for a capture with one camera; `pose_of` may raise a RealsimError, which costs that frame only."""

    def view_of(pair: Pair) -> View:
        return View(intrinsics, color_intrinsics, pose_of(pair), time_of(pair))

    return frames_with(pairs, unit, view_of, with_color=with_color)


def frames_with(
    pairs: Sequence[Pair], unit: DepthUnit, view_of: Callable[[Pair], View], *, with_color: bool = True
) -> tuple[tuple[Frame, ...], tuple[Dropped, ...]]:
    """One lazy frame a pair; incomplete pairs and frames whose camera or pose cannot be read are dropped and named.

    Args:
        view_of: may raise a RealsimError, which costs that frame only.
        with_color: whether this capture has colour, so that a frame without it is incomplete.
    """
    frames: list[Frame] = []
    dropped: list[Dropped] = []
    for pair in pairs:
        if pair.depth is None:
            dropped.append(Dropped(pair.name, "colour without depth"))
            continue
        if pair.color is None and with_color:
            dropped.append(Dropped(pair.name, "depth without colour"))
            continue
        try:
            view = view_of(pair)
        except RealsimError as error:
            dropped.append(Dropped(pair.name, one_line(error)))
            continue
        frames.append(
            Frame(
                pair.name,
                view.intrinsics,
                DepthImage(pair.depth, unit.integer, unit.floating),
                None if pair.color is None else ColorImage(pair.color),
                view.color_intrinsics,
                view.read_confidence,
                view.T_world_camera,
                view.timestamp,
                files=tuple(p for p in (pair.color, pair.depth) if p is not None),
            )
        )
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
