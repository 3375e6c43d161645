"""What moves with the camera: a robot's own foot, a hand, a bumper.

Such a thing keeps its place in the picture and its distance, while other frames look through every place where it was.
A place is looked through where another frame sees something clearly farther along the same ray; floor below a camera
that is pushed along keeps its distance too, but nobody looks through it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T, transform
from realsim.core.ordered import in_order
from realsim.core.types import F64, Bool, Frame
from realsim.feedforward.rgbd.features import View, match_descriptors, rigid_ransac

# Each of CLEAR, STEADY, RARELY, LEAST and COLUMNS halved or doubled, MOST halved or 0.7, and twice as many JUDGED find
# the same with true poses in 29 rendered captures: all of ten carried things and nothing else. Only a STEADY twice as
# wide takes somebody for carried who walks ahead of the camera.
FRAMES = 40
"""Frames that are looked at, evenly over the capture. Budget."""
COLUMNS = 64
"""Cells across the picture. Not tuned."""
CLEAR = 0.05
"""Metres, and share of the distance, by which another frame must look past a place: more than poses, sensors and 4 %
between the metres of the two are off."""
JUDGED, MOST = 5, 0.5
"""Frames at least that can tell of a cell, and the share of them in which it must be looked through. Set by hand before
it was tried: what is carried is then found in ten of ten rendered captures, and nothing in sixteen without it (five
of them with somebody who walks or stands there), nor in an iPhone's."""
STEADY = 0.1
"""Spread of a cell's distances over the frames (between quartiles, over their median). Not tuned."""
RARELY = 0.15
"""Share of the rest of the picture that may be looked through: beyond it poses are wrong, and nothing is known. Not
tuned."""
LEAST = 0.002
"""Share of the picture that is worth leaving out. Not tuned."""
STEP, PAIRS = 2, 16
"""Frames from one of a pair to the other, and pairs of which the features are asked."""
NEAR, FAR = 2.0, 8.0
"""Pixels within which a feature stays, and pixels by which the motion of the rest must carry it: what a matcher is off
by, and four times that. Not tuned."""
MATCHES, PAIRED, OFTEN = 3, 3, 0.25
"""Such features of a pair, and the pairs, and their share, that must have as many. Without anything carried no pair of
ten captures, three of them real, has more than one; something well marked has 10 to 120 in every pair, a plain foot up
to 3, which do no harm."""


def find_ego_mask(frames: Sequence[Frame], T_world_camera: F64) -> Bool | None:
    """Cells (h, w) of the picture that hold what moves with the camera, or None.

    Args:
        frames: N of one size, read once each (at most FRAMES of them).
        T_world_camera: (N, 4, 4) metres by the depth.
    """
    some = np.unique(np.linspace(0, len(frames) - 1, FRAMES).round().astype(int))
    sizes = {(frames[i].intrinsics.width, frames[i].intrinsics.height) for i in some}
    if len(some) < JUDGED or len(sizes) > 1:
        return None
    width, height = sizes.pop()
    rows = max(1, round(COLUMNS * height / width))
    cameras = [frames[i].intrinsics.resized(COLUMNS, rows) for i in some]
    depth = np.stack(list(in_order(lambda k: _coarse(frames[some[k]].depth(), rows), len(some))))
    near = np.stack([_nearest(z) for z in depth])
    through, judged = _looked_through(depth, near, cameras, T_world_camera[some])
    count = judged.sum(0)
    share = np.divide(through.sum(0), count, out=np.zeros(count.shape), where=count >= JUDGED)
    measured = (depth > 0).sum(0)
    z = np.sort(np.where(depth > 0, depth, np.inf), axis=0)
    quarter = (np.array([1, 2, 3])[:, None, None] * np.maximum(measured - 1, 0) / 4).round().astype(int)
    low, middle, high = np.take_along_axis(z, quarter, axis=0)
    steady = (high < low + STEADY * middle) & (measured > MOST * len(depth))
    found = steady & (share > MOST)
    found = _grown(found, steady & (count < JUDGED), middle)
    rest = share[~_wider(found) & (count >= JUDGED)]
    if found.mean() < LEAST or not len(rest) or rest.mean() > RARELY:
        return None
    return _wider(found)


def find_still_cells(views: Sequence[View], seed: int = 0) -> Bool | None:
    """Cells (h, w) of the picture in which features keep their place while the rest moves, or None; no poses are asked.

    Such features hold the camera where it is: in pairs in which they are more than what the place shows, they win.
    """
    rng = np.random.default_rng(seed)
    camera = views[0].camera
    size = round(COLUMNS * camera.height / camera.width), COLUMNS
    hits = np.zeros(size, int)
    tried = matched = 0
    for i in np.unique(np.linspace(0, len(views) - 1 - STEP, PAIRS).round().astype(int)) if len(views) > STEP else ():
        xy = _staying(views[i], views[i + STEP], rng)
        if xy is None:
            continue
        tried += 1
        matched += len(xy) >= MATCHES
        at = (xy * (camera.fx, camera.fy) + (camera.cx + 0.5, camera.cy + 0.5)) / (camera.width, camera.height)
        column, row = np.clip((at * size[::-1]).astype(int), 0, np.array(size[::-1]) - 1).T
        hits[row, column] += 1
    if matched < max(PAIRED, OFTEN * tried):
        return None
    return _wider(_wider(hits >= 2))


def _staying(A: View, B: View, rng: np.random.Generator) -> F64 | None:
    """(M, 2) on the plane z = 1: features of A that lie where they are in B, though the motion of the others would
    carry them FAR away. None where the others do not tell a motion."""
    a, b = match_descriptors(A, B)
    stays = (np.linalg.norm(A.xy[a] - B.xy[b], axis=1) * A.focal < NEAR) & (np.abs(A.z[a] / B.z[b] - 1) < STEADY)
    found = rigid_ransac(A.points[a[~stays]], B.points[b[~stays]], rng) if (~stays).sum() >= 12 else None
    if found is None:
        return None
    moved = transform(found[0], B.points[b[stays]])
    off = np.linalg.norm(moved[:, :2] / np.maximum(moved[:, 2:], 1e-6) - A.xy[a[stays]], axis=1) * A.focal
    return np.asarray(A.xy[a[stays]][off > FAR], np.float64)


def mask_out(frame: Frame, cells: NDArray[Any]) -> Frame:
    """The frame without depth in the cells (h, w) of the picture."""

    def read() -> NDArray[np.float32]:
        depth = frame.read_depth()
        row = np.arange(depth.shape[0]) * len(cells) // depth.shape[0]
        column = np.arange(depth.shape[1]) * cells.shape[1] // depth.shape[1]
        return np.where(cells[row[:, None], column], np.float32(0), depth)

    return replace(frame, read_depth=read)


def describe_ego_mask(cells: NDArray[Any]) -> str:
    """Which part of the picture the cells (h, w) are, in words."""
    (top, bottom), (left, right) = (
        (100 * np.flatnonzero(cells.any(axis))[[0, -1]] / cells.shape[1 - axis]).round() for axis in (1, 0)
    )
    step = 100 / np.array(cells.shape)
    return (
        f"{cells.mean():.0%} of every picture ({left:.0f} to {right + step[1]:.0f} % from the left, {top:.0f} to "
        f"{bottom + step[0]:.0f} % from the top), which moves with the camera: a foot, a hand, a part of the robot?"
    )


def _coarse(depth: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """(rows, COLUMNS) depth in the middle of each cell."""
    v, u = (((np.arange(n) + 0.5) * of / n).astype(int) for n, of in zip((rows, COLUMNS), depth.shape, strict=True))
    at = depth[v[:, None], u]
    return np.where(np.isfinite(at) & (at > 0), at, 0).astype(np.float32)


def _nearest(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The nearest depth of each cell and its neighbours; 0 where one of them is unknown."""
    from scipy import ndimage

    return np.asarray(ndimage.minimum_filter(depth, 3, mode="nearest"))


def _looked_through(depth: Any, near: Any, cameras: Any, T: F64) -> tuple[Any, Any]:
    """Whether each cell of each frame (n, h, w) was looked through, and whether any other frame could tell."""
    n, h, w = depth.shape
    through, measured = np.zeros((2, n, h * w), int)
    for i in range(n):
        points = transform(T[i], (cameras[i].rays() * depth[i][..., None]).reshape(-1, 3).astype(np.float64))
        for j in range(n):
            if i == j:
                continue
            P = transform(invert_T(T[j]), points)
            z = P[:, 2]
            v, u, inside = cameras[j].pixels(P, near=0.1)
            seen = np.flatnonzero(inside & (depth[i].ravel() > 0))
            there, limit = near[j][v[seen], u[seen]], CLEAR * np.maximum(z[seen], 1)
            known = there > 0
            through[i, seen] += known & (there > z[seen] + limit)
            measured[i, seen] += known & (np.abs(depth[j][v[seen], u[seen]] - z[seen]) <= limit)
    judged = through + measured >= 2
    flying = (through >= 2) & (2 * through > measured)
    return (flying & judged).reshape(depth.shape), judged.reshape(depth.shape)


def _grown(found: Bool, unknown: Bool, distance: F64) -> Bool:
    """With the cells beside it of which no frame can tell, as far as they are no farther than what they adjoin."""
    from scipy import ndimage

    while True:
        beside = ndimage.maximum_filter(np.where(found, distance, 0), 3)
        more = ~found & unknown & (beside > 0) & (distance < (1 + STEADY) * beside)
        if not more.any():
            return found
        found = found | more


def _wider(cells: Bool) -> Bool:
    from scipy import ndimage

    return np.asarray(ndimage.binary_dilation(cells, np.ones((3, 3))))
