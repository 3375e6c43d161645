"""Frames of a RealSense camera or of its recordings, depth registered to colour.

Interface: https://dev.intelrealsense.com/docs/python2 (pyrealsense2). Whatever offers it can stand in for the library.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import CaptureError, extra
from realsim.core.types import U8

TIMEOUT_MS = 5000
"""Longer than any camera needs for its first image."""
CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0)}
"""Colour formats that hold colours as they are -> the places of red, green and blue."""


@dataclass(frozen=True)
class Shot:
    """One pair of images of the same moment on the same grid."""

    number: int
    """The camera's own count of colour images: gaps are images that were lost."""
    time: float
    """Seconds, the camera's clock."""
    color: U8
    """(H, W, 3) RGB."""
    depth: NDArray[np.uint16]
    """(H, W) in steps of the stream's depth unit, 0 where invalid."""


@dataclass(frozen=True)
class Stream:
    """A camera or a recording that is running."""

    name: str
    """Product and serial number."""
    depth_unit: float
    """Metres a step."""
    intrinsics: dict[str, Any]
    """width, height, fx, fy, ppx, ppy, model, coeffs of the colour camera, to which depth is registered."""
    shots: Iterator[Shot]
    """In order. A recording ends; a camera goes on until it is unplugged."""


def library() -> Any:
    """pyrealsense2.

    Raises:
        MissingExtraError: it is not installed.
    """
    return extra("pyrealsense2", "realsense", "reading RealSense cameras and recordings")


@contextlib.contextmanager
def open_bag(path: Path, rs: Any) -> Iterator[Stream]:
    """All frames of a recording, as fast as they can be taken, none left out."""
    config = rs.config()
    with _started(rs, lambda: config.enable_device_from_file(str(path), repeat_playback=False), config, path) as (
        pipeline,
        profile,
    ):
        # In real time, frames would be dropped while others are written.
        profile.get_device().as_playback().set_real_time(False)
        yield _stream(rs, pipeline, profile, path)


@contextlib.contextmanager
def open_camera(rs: Any, serial: str | None, size: tuple[int, int], fps: int) -> Iterator[Stream]:
    """A camera that is plugged in: colour and depth of (width, height) at `fps` images a second."""
    config = rs.config()

    def ask() -> None:
        if serial is not None:
            config.enable_device(serial)
        config.enable_stream(rs.stream.depth, *size, rs.format.z16, fps)
        config.enable_stream(rs.stream.color, *size, rs.format.rgb8, fps)

    with _started(rs, ask, config, None) as (pipeline, profile):
        yield _stream(rs, pipeline, profile, None)


@contextlib.contextmanager
def _started(rs: Any, ask: Any, config: Any, path: Path | None) -> Iterator[tuple[Any, Any]]:
    """A pipeline that runs with this configuration, stopped whatever happens."""
    pipeline = rs.pipeline()
    try:
        ask()
        profile = pipeline.start(config)
    except RuntimeError as error:
        if path is not None:
            raise CaptureError(
                "not a recording of a RealSense camera, or damaged", file=path, found=str(error)
            ) from error
        hint = "plug the camera into a USB 3 port, close other programs that use it, or ask for another size or rate"
        raise CaptureError("the camera does not start", found=str(error), hint=hint) from error
    try:
        yield pipeline, profile
    finally:
        # A camera that was unplugged cannot be stopped; what led here is the error to tell.
        with contextlib.suppress(RuntimeError):
            pipeline.stop()


def _stream(rs: Any, pipeline: Any, profile: Any, path: Path | None) -> Stream:
    device = profile.get_device()
    try:
        unit = float(device.first_depth_sensor().get_depth_scale())
        camera = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        profile.get_stream(rs.stream.depth)
    except RuntimeError as error:
        raise CaptureError("no colour or no depth in this recording", file=path, found=str(error)) from error
    numbers = {k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "ppx", "ppy")}
    intrinsics = {**numbers, "model": str(camera.model), "coeffs": [float(v) for v in camera.coeffs]}
    name = " ".join(device.get_info(i) for i in (rs.camera_info.name, rs.camera_info.serial_number))
    return Stream(name, unit, intrinsics, _shots(rs, pipeline, path))


def _shots(rs: Any, pipeline: Any, path: Path | None) -> Iterator[Shot]:
    align = rs.align(rs.stream.color)
    first = True
    while True:
        try:
            good, frames = pipeline.try_wait_for_frames(TIMEOUT_MS)
        except RuntimeError as error:
            raise CaptureError("the camera or recording stopped early", file=path, found=str(error)) from error
        if not good:
            # A recording that has ended sends nothing more; so does a camera that hangs.
            if first or path is None:
                raise CaptureError("no images come", file=path, expected=f"one within {TIMEOUT_MS / 1000:g} s")
            return
        aligned = align.process(frames)
        depth, color = aligned.get_depth_frame(), aligned.get_color_frame()
        if not depth or not color:
            continue
        first = False
        yield Shot(
            int(color.get_frame_number()),
            float(color.get_timestamp()) / 1000,
            _rgb(color, path),
            # Copies: the library reuses its buffers.
            np.array(depth.get_data(), dtype=np.uint16),
        )


def _rgb(color: Any, path: Path | None) -> U8:
    data = np.asanyarray(color.get_data())
    kind = str(color.profile.format()).rpartition(".")[2].lower()
    if kind not in CHANNELS or data.ndim != 3:
        raise CaptureError("unknown colour format", file=path, expected=", ".join(CHANNELS), found=kind)
    return np.ascontiguousarray(data[..., CHANNELS[kind]], dtype=np.uint8)
