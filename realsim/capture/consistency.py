"""Do poses and depth belong together? Depth of one frame, seen from another, has to be that frame's depth.

The same test run for other readings of the same files (another depth unit, inverted poses, OpenGL axes) names the
convention that was really used, where the one that was assumed does not fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from realsim.capture.arkit import OPENGL
from realsim.capture.units import step_of
from realsim.core.errors import CaptureError, PoseError
from realsim.core.geometry import invert_T
from realsim.core.types import F32, F64, Frame, FrameSet

TOLERANCE = 0.04
"""Relative difference of two depths that still agree: sensor noise and bias, interpolation, rounding."""
PIXELS = 2000
"""About this many pixels of a frame are compared."""
PLACES = 6
STRIDES = (2, 5)
ENOUGH = 400
"""Compared pixels below which nothing is concluded."""
CLEARLY = 1.5
"""Another reading has to agree this many times better to be named."""
GOOD = 0.6
"""Share of agreeing pixels from which a reading counts as right. Measured on three rendered captures: the right
reading has 0.96 or more, every wrong one 0.56 or less and mostly 0.2."""
NAMED = 0.85
"""Share from which another reading is named as the one that was used. Poses in feet agree at 0.74 with depth that is 5
times farther (a rendered capture): the poses' own check, which measures the ratio, is left to refuse them."""
DEPTH_FACTORS = {
    "depth 5 times nearer": 0.2,
    "depth 5 times farther": 5.0,
    "depth 4 times nearer": 0.25,
    "depth 4 times farther": 4.0,
    "depth 10 times nearer": 0.1,
    "depth 10 times farther": 10.0,
}
"""The units in use (1/1000, 1/4000, 1/5000, 1/10000 m) differ by these; other factors already fail `check_unit`."""
ALONG_RAY = "depth along the ray of each pixel"
"""As simulators give it. It errs little between near frames, so medians tell: read along the axis, they are 2.2 to 10
times as large; of depth along the axis they are 2.6 to 11 times as large, read so (seven captures, two real)."""


@dataclass(frozen=True)
class Agreement:
    """Share of compared pixels whose depth agrees, under the reading that was assumed and under others."""

    as_read: float
    others: Mapping[str, float]
    """Empty where none can agree clearly better."""
    compared: int
    """Pixels compared under the assumed reading."""

    @property
    def better(self) -> str | None:
        """The reading that fits clearly better than the assumed one, or None."""
        if not self.others:
            return None
        name = max(self.others, key=lambda n: self.others[n])
        surely = self.others[name] > max(CLEARLY * self.as_read, NAMED) or name == ALONG_RAY
        return name if surely else None


def check_agreement(capture: FrameSet) -> tuple[Agreement | None, str | None]:
    """The agreement of a capture's poses and depth (None without poses, or too little to compare), and a warning.

    Poses that are right up to scale only cannot be compared before their scale is known.

    Raises:
        CaptureError: the depth fits the poses in another unit.
        PoseError: the depth fits the poses in another convention.
    """
    if not capture.has_poses or not capture.poses_metric or len(capture) < 2:
        return None, None
    found = agreement(capture.frames)
    if found is None:
        return None, f"poses and depth could not be compared: {_why_apart(capture.frames)}"
    facts = f"depth agrees with the poses at {found.as_read:.0%} of the compared pixels"
    if found.better is None:
        doubtful = f"{facts}: poses or depth are doubtful, and no other convention explains it"
        return found, doubtful if found.as_read < GOOD else None
    facts += f", but at {found.others[found.better]:.0%} with {found.better}"
    if found.better in DEPTH_FACTORS:
        unit = step_of(capture.frames[0])
        right = f"pass --depth-unit {unit * DEPTH_FACTORS[found.better]:g}, " if unit else ""
        right += "or --no-metric-poses if it is the poses that are not in metres"
        raise CaptureError("depth in an implausible unit", file=capture.source, found=facts, hint=right)
    if found.better == ALONG_RAY:
        raise CaptureError(
            "depth is the distance from the camera",
            file=capture.source,
            expected="depth along the optical axis",
            found=facts,
            hint="export it along the axis, or divide each pixel's by sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2)",
        )
    raise PoseError(
        "the poses follow another convention than this layout's",
        file=capture.source,
        expected="camera to world, OpenCV camera axes",
        found=facts,
        hint="convert the poses, or pass --ignore-poses to have them estimated",
    )


def _why_apart(frames: Sequence[Frame]) -> str:
    """Why near frames see nothing of each other: too few images, or positions in another unit."""
    steps = np.diff([np.asarray(frame.T_world_camera)[:3, 3] for frame in frames], axis=0)
    step, depth = float(np.median(np.linalg.norm(steps, axis=1))), frames[len(frames) // 2].depth()
    far = float(np.median(depth[depth > 0]))
    if step < 10 * far:
        return "the frames hardly overlap"
    apart = f"neighbouring cameras are {step:.3g} m apart and see {far:.2g} m far"
    return f"{apart}: are the positions in metres? If not, pass --no-metric-poses"


def agreement(frames: Sequence[Frame]) -> Agreement | None:
    """How well poses and depth agree over a dozen pairs of frames; None where too little overlaps to tell.

    Args:
        frames: with poses in metres, in order, `read_depth` in metres.
    """
    pairs = _pairs(len(frames))
    depths = {k: frames[k].depth() for k in sorted({k for pair in pairs for k in pair})}
    poses = {k: np.asarray(frames[k].T_world_camera) for k in depths}

    def errors_of(reading: Mapping[int, F64], depths: Mapping[int, F32]) -> F64:
        found = []
        for i, j in pairs:
            step = max(int(np.sqrt(depths[i].size / PIXELS)), 1)
            z = depths[i][::step, ::step]
            points = (frames[i].intrinsics.rays()[::step, ::step] * z[..., None])[z > 0].astype(np.float64)
            found.append(_differences(points, depths[j], frames[j], invert_T(reading[j]) @ reading[i]))
        return np.concatenate(found)

    def share(errors: F64) -> float:
        return float((errors < TOLERANCE).mean()) if len(errors) >= ENOUGH else 0.0

    read = errors_of(poses, depths)
    as_read, compared = share(read), len(read)
    if compared < ENOUGH:
        return None
    rays = {k: np.linalg.norm(frames[k].intrinsics.rays(), axis=-1) for k in depths}
    along = errors_of(poses, {k: (z / rays[k]).astype(np.float32) for k, z in depths.items()})
    if share(along) > max(as_read, GOOD) and CLEARLY * np.median(along) < np.median(read):
        return Agreement(as_read, {ALONG_RAY: share(along)}, compared)
    if CLEARLY * as_read >= 1:  # nothing can be better by as much
        return Agreement(as_read, {}, compared)
    others = {
        "poses that are world to camera": share(errors_of({k: invert_T(T) for k, T in poses.items()}, depths)),
        "poses with OpenGL camera axes": share(errors_of({k: T @ OPENGL for k, T in poses.items()}, depths)),
    }
    for name, factor in DEPTH_FACTORS.items():
        others[name] = share(errors_of(poses, {k: z * np.float32(factor) for k, z in depths.items()}))
    return Agreement(as_read, others, compared)


def _pairs(count: int) -> list[tuple[int, int]]:
    """Evenly spread pairs of near frames; the wider ones have the parallax, the closer ones the overlap."""
    pairs = set()
    for stride in STRIDES:
        starts = np.linspace(0, max(count - 1 - stride, 0), PLACES).astype(int)
        pairs |= {(int(i), min(int(i) + stride, count - 1)) for i in starts}
    return sorted((i, j) for i, j in pairs if i < j)


def _differences(points: F64, depth_j: F32, frame_j: Frame, T_ji: F64) -> F64:
    """Relative differences of frame i's points, seen from j, to j's own depth where they land in its image.

    Points that land behind what j sees are hidden there, not wrong; they are left out.
    """
    seen = points @ T_ji[:3, :3].T + T_ji[:3, 3]
    v, u, inside = frame_j.intrinsics.pixels(seen, near=0.05)
    found = depth_j[v[inside], u[inside]].astype(np.float64)
    expected = seen[inside, 2][found > 0]
    found = found[found > 0]
    relative = (expected - found) / found
    return np.abs(relative[relative < 0.3])
