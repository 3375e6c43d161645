"""Recording from a RealSense camera into a plain folder of frames, image by image, so that nothing is ever lost."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture.realsense import Shot, Stream, library, open_bag, open_camera
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.files import to_json, write_bytes, write_text
from realsim.core.limits import check_limits
from realsim.core.progress import track


@dataclass(frozen=True)
class RecordConfig:
    seconds: float | None = None
    """Stop after this many seconds of the camera's clock; without a limit, Ctrl-C stops."""
    frames: int | None = None
    """Stop after this many frames."""
    every: int = 1
    """Keep every n-th frame."""
    width: int = 640
    """Pixels, of colour and depth."""
    height: int = 480
    """Pixels, of colour and depth."""
    fps: int = 30
    """Images a second that are asked of the camera."""
    warm_up: int = 15
    """Images of a camera that are thrown away first, while its exposure settles."""
    serial: str | None = None
    """Serial number of the camera, where several are plugged in."""

    def __post_init__(self) -> None:
        counts = dict.fromkeys(("width", "height", "fps", "every", "frames"), 1)
        check_limits(self, above={"seconds": 0}, least={**counts, "warm_up": 0})


@dataclass(frozen=True)
class Recording:
    """Summary of a recording."""

    folder: Path
    frames: int
    seconds: float
    """Between the first and the last frame kept."""
    lost: int
    """Images that the camera took and that never arrived, by its own count."""
    interrupted: bool
    device: str


def record(
    out: Path, config: RecordConfig | None = None, *, bag: Path | None = None, device: Any | None = None
) -> Recording:
    """Write frames of a camera, or of a `.bag`, as a capture of layout `plain`: rgb/, depth/, intrinsics.json.

    Every image appears whole or not at all, depth after its colour; an interrupt (Ctrl-C) or an error keeps all frames
    up to there. The folder is a capture at every moment; a last colour image without depth is left out when read.

    Args:
        out: the folder; must not exist or be empty.
        bag: a recording instead of a camera.
        device: anything with the interface of pyrealsense2; that library if None.

    Raises:
        MissingExtraError: pyrealsense2 is not installed.
        CaptureError: no camera, it breaks off, or the folder is not empty.
    """
    config = config or RecordConfig()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError("the output folder exists and is not empty", file=out, hint="choose another folder")
    rs = library() if device is None else device
    opened = (
        open_camera(rs, config.serial, (config.width, config.height), config.fps) if bag is None else open_bag(bag, rs)
    )
    # Only times and numbers are remembered, not images.
    kept: list[Shot] = []
    interrupted = False
    with opened as stream:
        shots = _wanted(stream.shots, config, 0 if bag else config.warm_up)
        try:
            kept.extend(track(write_frames(out, stream, shots), "recording", config.frames))
        except KeyboardInterrupt:
            interrupted = True
        except RealsimError as error:
            if kept:
                error.hint = f"{len(kept)} frames up to there are kept in {out}"
            raise
    if not kept:
        raise CaptureError("nothing was recorded", file=out, found="interrupted" if interrupted else "no images")
    span = kept[-1].number - kept[0].number + 1
    lost = max(span - ((len(kept) - 1) * config.every + 1), 0)
    return Recording(out, len(kept), kept[-1].time - kept[0].time, lost, interrupted, stream.name)


def write_frames(folder: Path, stream: Stream, shots: Iterator[Shot]) -> Iterator[Shot]:
    """Write each shot to files and give it back without its images."""
    write_text(folder / "intrinsics.json", to_json({**stream.intrinsics, "depth_scale": stream.depth_unit}))
    for place, shot in enumerate(shots):
        write_bytes(folder / f"rgb/{place:06d}.png", _png(shot.color[..., ::-1]))
        write_bytes(folder / f"depth/{place:06d}.png", _png(shot.depth))
        yield Shot(shot.number, shot.time, np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.uint16))


def _wanted(shots: Iterator[Shot], config: RecordConfig, warm_up: int) -> Iterator[Shot]:
    """Every n-th shot after the warm-up, up to the limits of count and time."""
    start: float | None = None
    kept = 0
    for place, shot in enumerate(shots):
        if place < warm_up:
            continue
        start = shot.time if start is None else start
        if config.seconds is not None and shot.time - start > config.seconds:
            return
        if (place - warm_up) % config.every == 0:
            yield shot
            kept += 1
        if config.frames is not None and kept == config.frames:
            return


def _png(image: np.ndarray) -> bytes:
    import cv2

    # The lightest compression keeps up with a camera; a harder one would cost frames.
    good, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not good:
        raise CaptureError("an image cannot be encoded", found=f"{image.dtype} of shape {image.shape}")
    return data.tobytes()
