"""One look at every frame: can it be decoded, what does its depth say, how sharp is it, is it a repetition.

Only a few figures and a thumbnail a frame are kept, so a thousand frames cost a few megabytes.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.capture.assemble import one_line
from realsim.capture.blur import SMEARED, edge_width
from realsim.capture.config import CaptureConfig
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.progress import track
from realsim.core.types import F32, U8, Dropped, Frame

THUMBNAIL = (32, 24)
THREADS = 2
"""Decoding releases the interpreter lock; more threads gain little and each holds a pair of images."""
NEIGHBOURS = 4
"""Frames before and after whose sharpness a frame is compared with."""
BLURRED = 0.25
"""A frame with less than this share of its neighbours' sharpness is blurred. Measured on three rendered and one real
capture: sharp frames have 0.6 or more, frames smeared over 7 pixels 0.19 or less."""
FEATURELESS = 1e-9
"""Sharpness of a picture without any detail."""
SECOND_DIFFERENCES = tuple(
    np.array(rows, np.float32)
    for rows in (
        [[0, 0, 0], [1, -2, 1], [0, 0, 0]],
        [[0, 1, 0], [0, -2, 0], [0, 1, 0]],
        [[1, 0, 0], [0, -2, 0], [0, 0, 1]],
        [[0, 0, 1], [0, -2, 0], [1, 0, 0]],
    )
)


@dataclass(frozen=True)
class Look:
    """Figures of one frame."""

    name: str
    median_depth: float
    """Metres over all pixels with a return, before range limits; NaN without any."""
    depth_range: tuple[float, float]
    """2nd and 98th percentile of the same, metres."""
    valid_share: float
    """Share of pixels with depth inside the range limits."""
    sharpness: float | None
    """Fine against coarse detail of the colour image (see `sharpness`); None without colour."""
    content: str
    """Digest of the decoded depth and colour: equal for repeated frames."""
    thumbnail: F32
    """(24, 32) brightness (depth where there is no colour), mean 0 and deviation 1: how the view looks."""
    sizes: tuple[tuple[int, int], tuple[int, int] | None]
    """(width, height) of depth and of colour."""
    edge_px: float | None = None
    """Width of the sharpest edges of the colour image, pixels (see `blur.edge_width`); None where there are none."""


def survey(frames: Sequence[Frame], config: CaptureConfig) -> tuple[list[Look], list[Dropped]]:
    """Look at all frames; those that cannot be decoded or do not fit their camera come back as dropped."""

    def attempt(frame: Frame) -> Look | Dropped:
        try:
            return look_at(frame, config)
        except RealsimError as error:
            return Dropped(frame.name, one_line(error))

    with ThreadPoolExecutor(THREADS) as pool:
        results = list(track(pool.map(attempt, frames), "looking at frames", len(frames)))
    looks = [r for r in results if isinstance(r, Look)]
    return looks, [r for r in results if isinstance(r, Dropped)]


def look_at(frame: Frame, config: CaptureConfig) -> Look:
    """Read a frame's images once and measure them.

    Raises:
        CaptureError: an image is damaged, or not of its camera's size.
    """
    import cv2

    depth, color = frame.depth(), frame.color()
    camera = frame.intrinsics
    _check_size("depth", depth, (camera.width, camera.height))
    if frame.read_confidence is not None:
        _check_size("confidence", frame.read_confidence(), (camera.width, camera.height))
    digest = hashlib.blake2b(np.ascontiguousarray(depth).data, digest_size=16)
    sharp = edge = None
    if color is not None:
        of_color = frame.color_intrinsics or camera
        _check_size("colour", color, (of_color.width, of_color.height))
        digest.update(np.ascontiguousarray(color).data)
        gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        sharp, edge = sharpness(gray), edge_width(gray)
        small = cv2.resize(gray.astype(np.float32), THUMBNAIL, interpolation=cv2.INTER_AREA)
    else:
        small = cv2.resize(depth, THUMBNAIL, interpolation=cv2.INTER_NEAREST)
    inside = (depth >= config.min_depth) & (depth <= config.max_depth)
    # A quarter of the pixels gives the same percentiles to a millimetre, in a quarter of the time.
    returns = depth[::2, ::2][depth[::2, ::2] > 0]
    low, middle, high = np.percentile(returns, [2, 50, 98]) if returns.size else (np.nan,) * 3
    return Look(
        frame.name,
        float(middle),
        (float(low), float(high)),
        float(inside.mean()),
        sharp,
        digest.hexdigest(),
        ((small - small.mean()) / (small.std() + 1e-6)).astype(np.float32),
        (_size(depth), None if color is None else _size(color)),
        edge,
    )


def sharpness(gray: NDArray) -> float:
    """Detail at the finest scale, along the direction that has least of it, against detail at an eighth of the size.

    The usual variance of the Laplacian (Pech-Pacheco et al. 2000) also falls when the view turns to a plain wall or
    the exposure drops; blur takes the fine scale only, so the ratio of two scales tells them apart. Motion blur takes
    it along one direction only, hence the minimum over four directions.
    """
    import cv2

    height, width = gray.shape
    coarse = cv2.resize(gray, (max(width // 8, 3), max(height // 8, 3)), interpolation=cv2.INTER_AREA)
    fine = min(float(cv2.filter2D(gray, cv2.CV_32F, kernel).var()) for kernel in SECOND_DIFFERENCES)
    return fine / (float(cv2.Laplacian(coarse, cv2.CV_32F).var()) + 1.0)


def duplicates(looks: Sequence[Look]) -> list[Dropped]:
    """Frames whose depth and colour are those of an earlier frame, value by value (a recorder that stalled)."""
    first: dict[str, str] = {}
    out = []
    for look in looks:
        if look.content in first:
            out.append(Dropped(look.name, f"the same images as {first[look.content]}", lost=False))
        else:
            first[look.content] = look.name
    return out


def blurred(looks: Sequence[Look]) -> list[Dropped]:
    """Frames that are much less sharp than the median of the frames around them, and have no sharp edges."""
    out = []
    values = [look.sharpness for look in looks]
    for i, look in enumerate(looks):
        around = values[max(0, i - NEIGHBOURS) : i] + values[i + 1 : i + 1 + NEIGHBOURS]
        known = [v for v in around if v is not None]
        if look.sharpness is None or len(known) < 2:
            continue
        if look.edge_px is not None and look.edge_px < SMEARED:
            continue  # other content, not blur
        usual = float(np.median(known))
        share = look.sharpness / max(usual, FEATURELESS)
        # Beside pictures of a plain wall nothing can be determined.
        if usual > FEATURELESS and share < BLURRED:
            edges = "" if look.edge_px is None else f", edges {look.edge_px:.0f} pixels wide"
            out.append(Dropped(look.name, f"blurred: {share:.0%} of its neighbours' sharpness{edges}"))
    return out


def smeared(looks: Sequence[Look]) -> str | None:
    """A warning where most pictures of a capture are blurred, which no comparison between them can tell."""
    widths = [look.edge_px for look in looks if look.edge_px is not None]
    if not widths or float(np.median(widths)) < SMEARED:
        return None
    count = sum(w >= SMEARED for w in widths)
    return (
        f"{count} of {len(looks)} pictures are blurred: their sharpest edges are {np.median(widths):.0f} pixels wide, "
        f"those of sharp pictures less than {SMEARED:.0f}. More light, or slower movement, gives better poses"
    )


def _check_size(what: str, image: F32 | U8, expected: tuple[int, int]) -> None:
    if _size(image) != expected:
        raise CaptureError(
            f"{what} of another size",
            expected=f"{expected[0]}x{expected[1]}",
            found=f"{image.shape[1]}x{image.shape[0]}",
        )


def _size(image: F32 | U8) -> tuple[int, int]:
    return image.shape[1], image.shape[0]
