"""Is depth aligned to colour? Steps in depth have to lie on edges of the colour image.

Depth that a camera recorded as its own sensor saw it has another field of view than colour, and a shift that depends on
depth. Both are found by where steps in depth fall on edges of colour (Levinson and Thrun 2013), image by image, so that
no motion is needed. Small differences are left to `feedforward.rgbd.extrinsic_calibration`, which measures them better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.errors import CaptureError
from realsim.core.ordered import in_order
from realsim.core.types import F32, F64, U8, Frame, FrameSet, Intrinsics

LOOK_AT = 12
"""Frames, spread over the capture."""
STEP = 0.1
"""Relative difference of neighbouring depths that is a step and not a slope."""
NEAR_SIDE = 3.0
"""Metres within which steps count: farther depth of two eyes is noise, with steps of its own."""
EDGES = 3000
"""At most so many pixels of steps in a frame."""
ENOUGH = 200
WIDTH = 640
"""Pixels of the colour image that are enough. Budget."""
NEAR = 0.008
"""Of the image's width: distance from an edge of colour at which a step's credit falls to 1/e."""
ZOOMS = np.exp(np.arange(-9, 10) * 0.07)
SHIFTS = np.array([(x, y) for x in np.arange(-4, 5) * 0.015 for y in (-0.015, 0.0, 0.015)])
"""Metres from the depth camera to the colour camera, to the right and down. The widest housing has 0.06."""
ALIGNED = 0.1
"""Logarithm of the zoom up to which the registration by matches is left to find it."""
CLEAR, TIMES, CREDIT = 2.5, 2.0, 0.15
"""Standard errors, and times, by which another field of view has to fit better, and the least credit of one that fits.
A D435 without rs.align (9 frames): 4.6, 4.2 and 0.22; four aligned captures (RealSense, Kinect, iPhone, rendered) fit
best as they are. Right views of five captures, whole and cropped, have 0.21 to 0.42, of two rendered ones that it was
not set on 0.17 up. Over what has edges everywhere (gravel, grass, noise) the best of all has 0.04 to 0.11, and frames
that see the same places agree on it by chance."""
NARROWEST_DEG = 46.0
"""Field of view across, below which no depth camera's colour camera lies: D435 55, L515 56, Kinect 60, phones 60."""


@dataclass(frozen=True)
class Misalignment:
    """The colour camera against how it was read."""

    zoom: float
    """The depth camera's focal length over the colour camera's, in pixels of the same image size."""
    shift: tuple[float, float]
    """Metres that the colour camera stands right of and below the depth camera."""


def put_right(capture: FrameSet) -> FrameSet:
    """The capture with its colour camera put right where the depth is not aligned to it, and a warning that says so.

    Raises:
        CaptureError: it is the depth camera of which nothing is known.
    """
    found = misalignment(capture.frames)
    if found is None:
        return capture
    frames = []
    for f in capture.frames:
        c = f.color_intrinsics or f.intrinsics
        color = Intrinsics(c.width, c.height, c.fx / found.zoom, c.fy / found.zoom, c.cx, c.cy)
        frames.append(replace(f, color_intrinsics=color, color_shift=found.shift))
    depth, color = frames[0].intrinsics, frames[0].color_intrinsics or color
    ratio = max(found.zoom, 1 / found.zoom)
    what = f"the depth is not aligned to the colour: the two cameras' fields of view differ by {ratio:.1f}"
    narrow = min(_field_deg(color), _field_deg(depth))
    if narrow < NARROWEST_DEG:
        raise CaptureError(
            what,
            file=capture.source,
            expected="depth aligned to colour, or the intrinsics of the depth camera",
            found=f"a camera {narrow:.0f} degrees wide, were the intrinsics (focal length {depth.fx:.0f}) the depth's",
            hint=f"these are the colour camera's: give the depth camera's (a focal length of about "
            f"{depth.fx * found.zoom:.0f} pixels), or record again with depth aligned to colour (rs.align)",
        )
    warning = (
        f"{what}. The intrinsics are taken as the depth camera's, the colour camera's were estimated from the images "
        f"(focal length {color.fx:.0f} pixels, {1e3 * found.shift[0]:.0f} mm to the side): align depth to colour when "
        "recording (rs.align), or give both cameras"
    )
    return replace(capture, frames=tuple(frames), warnings=(*capture.warnings, warning))


def misalignment(frames: Sequence[Frame]) -> Misalignment | None:
    """What is clearly wrong with the colour camera; None where depth is aligned, or nothing can be determined."""
    chosen = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, LOOK_AT).astype(int))]
    scores = np.array([s for s in in_order(lambda k: _scores(chosen[k]), len(chosen)) if s is not None])
    if len(scores) < 3:
        return None
    credit, count = scores.sum(0)
    mean = credit / np.maximum(count, ENOUGH)
    usual = np.abs(np.log(ZOOMS)) <= ALIGNED
    best = np.unravel_index(int(mean.argmax()), mean.shape)
    if usual[best[0]]:
        return None
    read = np.unravel_index(int(np.where(usual[:, None], mean, -np.inf).argmax()), mean.shape)
    # The gain with each frame left out in turn (jackknife, Tukey 1958).
    left = scores.sum(0) - scores
    gains = [a[0][best] / max(a[1][best], 1) - a[0][read] / max(a[1][read], 1) for a in left]
    sigma = float(np.std(gains) * np.sqrt(len(gains) - 1))
    if mean[best] < max(CREDIT, TIMES * mean[read]) or mean[best] - mean[read] < CLEAR * sigma:
        return None
    z, k = best
    return Misalignment(float(ZOOMS[z]), (float(SHIFTS[k, 0]), float(SHIFTS[k, 1])))


def _scores(frame: Frame) -> F64 | None:
    """(2, zooms, shifts) how much nearer than chance steps in depth lie to edges of colour, summed over those that fall
    into the image, and their number; None without either."""
    import cv2

    color = frame.color()
    if color is None:
        return None
    rays, z = _steps(frame.depth(), frame.intrinsics)
    if len(z) < ENOUGH:
        return None
    camera = frame.color_intrinsics or frame.intrinsics
    if camera.width > WIDTH:
        camera = camera.resized(WIDTH, WIDTH * camera.height // camera.width)
    small = cv2.resize(color, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    near = _nearness(np.asarray(small, np.uint8))
    total: F64 = np.asarray(cv2.integral(near), float)
    out = np.zeros((2, len(ZOOMS), len(SHIFTS)))
    for i, zoom in enumerate(ZOOMS):
        # (S, M) columns and rows of the steps under each shift.
        x, y = (rays[:, axis] - SHIFTS[:, axis, None] / z for axis in (0, 1))
        u = np.rint(x / zoom * camera.fx + camera.cx).astype(int)
        v = np.rint(y / zoom * camera.fy + camera.cy).astype(int)
        on = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        left, right = np.where(on, u, camera.width).min(1), np.where(on, u, -1).max(1) + 1
        top, bottom = np.where(on, v, camera.height).min(1), np.where(on, v, -1).max(1) + 1
        area = np.maximum((right - left) * (bottom - top), 1)
        # Against the mean of the part of the image that is seen: a busy middle is no sign.
        part = (total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]) / area
        count = on.sum(1)
        out[:, i] = (near[v * on, u * on] * on).sum(1) - count * part, count
    return out


def _steps(depth: F32, camera: Intrinsics) -> tuple[F64, F64]:
    """Rays (K, 2) on the plane z = 1 and depths (K,) of the near side of steps in depth."""
    behind = _filled(depth)
    far = np.zeros_like(depth)
    for axis in (0, 1):
        for way in (1, -1):
            far = np.maximum(far, np.roll(behind, way, axis))
    step = (depth > 0) & (depth < NEAR_SIDE) & (far > (1 + STEP) * depth)
    step[[0, -1]] = False
    step[:, [0, -1]] = False
    v, u = np.nonzero(step)
    if len(v) > EDGES:
        keep = np.linspace(0, len(v) - 1, EDGES).astype(int)
        v, u = v[keep], u[keep]
    rays = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy])
    return rays, depth[v, u].astype(float)


def _filled(depth: F32) -> F32:
    """Depth with its holes at the farther of the depths at both of their ends in a row: the shadow beside a near thing,
    where one of two eyes sees nothing, belongs to what lies behind."""
    columns = np.arange(depth.shape[1])
    seen = depth > 0
    left = np.maximum.accumulate(np.where(seen, columns, 0), axis=1)
    right = np.minimum.accumulate(np.where(seen, columns, depth.shape[1] - 1)[:, ::-1], axis=1)[:, ::-1]
    return np.maximum(np.take_along_axis(depth, left, 1), np.take_along_axis(depth, right, 1))


def _nearness(color: U8) -> F32:
    """(h, w) 1 on edges of a colour image, falling off with the distance from them."""
    import cv2

    gray = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), (0, 0), color.shape[1] / 500)
    slope = np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))
    edges = cv2.Canny(gray, 0.5 * (high := float(np.percentile(slope, 94))), high, L2gradient=True)
    away = cv2.distanceTransform(255 - edges, cv2.DIST_L2, 3)
    return np.exp(-away / (NEAR * color.shape[1])).astype(np.float32)


def _field_deg(camera: Intrinsics) -> float:
    return float(np.degrees(2 * np.arctan(camera.width / (2 * camera.fx))))
