"""Poses as people write them down, to rigid transforms, or a reason why not."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from realsim.capture.numbers import table_of
from realsim.core.errors import PoseError
from realsim.core.files import read_text
from realsim.core.geometry import nearest_rotation
from realsim.core.types import F64, Dropped, Frame, FrameSet

ROUNDING = 1e-5
"""Deviation of R R^T from the identity that a few printed digits explain; corrected without a word."""
FAR = 100.0
"""Times the usual distance of a capture's cameras from their middle beyond which a camera was never there; 67 m of a
corridor have 2. Poses in metres may besides be as far off as two cameras that see one place."""
LEAP, LEAST_LEAP = 20.0, 0.1
"""Times the usual step, and of that distance, by which a camera cannot be off between two frames that are together."""
MENDABLE = 0.05
"""Deviation up to which a rotation is replaced by the nearest one, with a note; beyond it the pose is refused."""


@dataclass(frozen=True)
class PoseReport:
    """The checked poses of a capture, with notes."""

    mended: int
    """Rotations that were off by more than rounding and were replaced by the nearest rotation."""
    worst_deviation: float
    """Largest |R R^T - 1| among the poses that are used."""


def parse_matrix(text: str, path: Path) -> F64:
    """(4, 4) from sixteen (or twelve: 3x4) numbers in text, row by row. NaN and infinity are left in.

    Raises:
        PoseError: another count, or something that is not a number.
    """
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError as error:
        raise PoseError("a pose is not a matrix of numbers", file=path, found=str(error)) from error
    if len(values) == 12:
        values = np.append(values, [0.0, 0, 0, 1])
    if len(values) != 16:
        raise PoseError(
            "a pose of the wrong length", file=path, expected="16 numbers (4x4)", found=f"{len(values)} numbers"
        )
    return values.reshape(4, 4)


def matrix_of(value: Any, what: str, path: Path) -> F64:
    """(4, 4) from nested lists of numbers (3x4 or 4x4) or sixteen of them row by row, under the key `what` of a file.

    Raises:
        PoseError: anything else.
    """
    try:
        T = table_of(value)
    except (TypeError, ValueError) as error:
        raise PoseError(f"{what} is not a matrix of numbers", file=path) from error
    if T.shape == (3, 4):
        T = np.vstack([T, [0.0, 0, 0, 1]])
    if T.shape not in ((4, 4), (16,)):
        raise PoseError(
            "a pose of the wrong length", file=path, expected=f"4x4 numbers in {what}", found=f"shape {T.shape}"
        )
    return T.reshape(4, 4)


def pose_in(files: Mapping[str, Path], name: str) -> F64 | None:
    """The matrix in a frame's own file; None where no frame has any.

    Raises:
        PoseError: others have one, or it is no matrix.
    """
    if not files:
        return None
    if name not in files:
        raise PoseError("there is no pose for this frame")
    return read_matrix(files[name])


def read_matrix(path: Path) -> F64:
    """`parse_matrix` of a file."""
    return parse_matrix(read_text(path, 2**20), path)


def read_rows(path: Path, columns: str) -> Iterator[F64]:
    """The numbers of every line that is no comment; `columns` names them, separated by spaces. NaN is left in.

    Raises:
        PoseError: a line of another length, or something that is not a number.
    """
    count = len(columns.split())
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or line.startswith("#"):
            continue
        if len(words) != count:
            expected = f"{count} numbers: {columns}"
            raise PoseError(f"line {number} has the wrong length", file=path, expected=expected, found=f"{len(words)}")
        try:
            yield np.array([float(word) for word in words])
        except ValueError as error:
            raise PoseError(
                f"line {number} holds something that is not a number", file=path, found=line[:80]
            ) from error


def no_common_time(path: Path, images: F64, poses: F64) -> PoseError:
    """The error of a trajectory none of whose times (N,) is near one of the images' (M,), seconds."""
    span = [f"poses between {t.min():.3f} and {t.max():.3f} s" for t in (images, poses)]
    hint = "fix the timestamps, or pass --ignore-poses to have the poses estimated"
    apart = images.max() < poses.min() or poses.max() < images.min()
    what = f"the timestamps of poses and images {'do not overlap' if apart else 'are too far apart'}"
    return PoseError(what, file=path, expected=span[0], found=span[1], hint=hint)


def rigid(T: ArrayLike) -> tuple[F64, float] | str:
    """A pose as written -> (the rigid 4x4 transform, how far it was off), or the reason why it is none.

    `How far` is the largest entry of |R R^T - 1|.
    """
    M = np.asarray(T, float)
    if M.shape != (4, 4):
        return f"the pose has shape {M.shape} instead of (4, 4)"
    if not np.isfinite(M).all():
        return "the pose holds NaN, infinity or something that is no number"
    if np.abs(M[3] - [0, 0, 0, 1]).max() > ROUNDING:
        return f"the last row of the pose is {M[3].tolist()} instead of 0 0 0 1"
    R = M[:3, :3]
    deviation = float(np.abs(R @ R.T - np.eye(3)).max())
    if np.linalg.det(R) < 0:
        return "the pose is a reflection (its determinant is negative: a left-handed convention?)"
    if deviation > MENDABLE:
        scale = float(np.cbrt(np.linalg.det(R)))
        if np.abs(R @ R.T - scale**2 * np.eye(3)).max() < MENDABLE * scale**2:
            return f"the rotation of the pose is scaled by {scale:.3g}"
        return f"the pose is not rigid (R R^T is off the identity by {deviation:.2g})"
    out = np.eye(4)
    out[:3, :3] = nearest_rotation(R)
    out[:3, 3] = M[:3, 3]
    return out, deviation


def settle_poses(capture: FrameSet, reach: float) -> tuple[FrameSet, PoseReport]:
    """Every pose rigid and near the others or its frame dropped; where some frames have a pose, so are those without.

    Args:
        reach: metres from a camera to the farthest depth that is used.

    Raises:
        PoseError: poses are given and none can be used (then they are of a kind that this toolkit does not know, and
            going on without them has to be requested).
    """
    if all(f.T_world_camera is None for f in capture.frames):
        return capture, PoseReport(0, 0.0)
    kept: list[Frame] = []
    dropped: list[Dropped] = []
    deviations: list[float] = []
    for frame in capture.frames:
        result = "there is no pose for this frame" if frame.T_world_camera is None else rigid(frame.T_world_camera)
        if isinstance(result, str):
            dropped.append(Dropped(frame.name, result))
        else:
            kept.append(frame.with_pose(result[0]))
            deviations.append(result[1])
    astray = _astray(kept, 2 * reach if capture.poses_metric else 0.0, " m" if capture.poses_metric else "")
    dropped += [Dropped(kept[i].name, reason) for i, reason in astray.items()]
    kept = [frame for i, frame in enumerate(kept) if i not in astray]
    deviations = [deviation for i, deviation in enumerate(deviations) if i not in astray]
    if not kept:
        reason, count = Counter(d.reason for d in dropped).most_common(1)[0]
        raise PoseError(
            "no pose of this capture can be used",
            file=capture.source,
            expected="camera-to-world matrices with a proper rotation",
            found=f"{count} of {len(dropped)} times: {reason}",
            hint="fix the poses, or pass --ignore-poses to have them estimated",
        )
    mended = sum(d > ROUNDING for d in deviations)
    report = PoseReport(mended, max(deviations))
    assumptions = capture.assumptions
    if mended:
        assumptions += (
            f"{mended} of {len(kept)} rotations are slightly off SO(3) (R R^T off the identity by up to "
            f"{report.worst_deviation:.1e}): the nearest rotation is used",
        )
    settled = replace(capture, frames=tuple(kept), dropped=capture.dropped + tuple(dropped), assumptions=assumptions)
    return settled, report


def _astray(frames: Sequence[Frame], reach: float, unit: str) -> dict[int, str]:
    """Index -> reason, of frames whose camera is so far from the middle of all that it sees nothing of theirs, or leaps
    away from both of its neighbours, which stayed together. `unit` follows the numbers of a reason."""
    if len(frames) < 3:
        return {}
    at = np.array([np.asarray(f.T_world_camera)[:3, 3] for f in frames])
    with np.errstate(over="ignore", invalid="ignore"):
        away = np.linalg.norm(at - np.median(at, axis=0), axis=1)
        steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
        over = np.linalg.norm(at[2:] - at[:-2], axis=1)
    typical = float(np.median(away))
    out = {
        int(i): f"its pose is {away[i]:.3g}{unit} away from the others' middle, theirs usually {typical:.3g}{unit}"
        for i in np.flatnonzero(~(away <= FAR * typical + reach))
    }
    step = float(np.median(steps))
    leap = np.minimum(steps[:-1], steps[1:])
    for k in np.flatnonzero((leap > LEAP * step + LEAST_LEAP * reach) & (leap > 5 * over)):
        i = int(k) + 1
        out.setdefault(i, f"its pose leaps {leap[k]:.3g}{unit} away and back, where steps are usually {step:.3g}{unit}")
    return out
