"""Is colour registered to depth? The camera of the colour images, as matched features with depth have it.

A feature's ray comes from the colour camera and its depth from the depth image. Under a wrong focal length, centre or
place of the colour camera the points of two frames are not related by a rigid motion. So five figures are sought that
make them so, whatever the frames' poses, or under poses that are known without colour:

    ray seen from the depth camera = zoom * ray as read + centre + shift / depth

(The shift is the metres by which the colour camera stands right of and below the depth camera.) Without poses each pair
of frames keeps its own best rigid motion (variable projection, Golub and Pereyra 1973); the five are found by
Gauss-Newton steps on what remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T, nearest_rotation
from realsim.core.least_squares import cauchy, differences, least_squares
from realsim.core.types import F32, F64, Frame, Intrinsics
from realsim.feedforward.rgbd.features import Match, View

PRIOR = np.array([0.1, 0.03, 0.03, 0.03, 0.03])
"""Standard deviations of zoom, centre (2, on the plane z = 1) and shift (2, metres): colour and depth cameras of one
housing. Kinect: 0.11, 0.01, 0.025 m."""
LEAST = 16
"""Pairs of frames below which nothing is concluded: a quarter of them judge. Of ten rendered captures and a real one in
pieces of 4 to 58 frames (100, colour registered) 8 were corrected wrongly, with 4 to 12 pairs, and none with more."""
PAIRS, POINTS = 160, 80
"""Most pairs of frames, and most matches of a pair, that take part."""
STEPS = 8
DELTA = PRIOR / 5
"""Steps of the numerical derivatives: about a cell of the thinned depth, so that its noise is no slope."""
SCALE = 0.004
"""Relative distance of two points of one place beyond which a match loses its weight (Cauchy)."""


@dataclass(frozen=True)
class Registration:
    """The colour camera relative to how it was read."""

    zoom: float = 1.0
    """Factor on rays: true rays are wider than read ones where it is above 1 (the true focal length is shorter)."""
    centre: tuple[float, float] = (0.0, 0.0)
    """On the plane z = 1."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Metres that the colour camera stands right of and below the depth camera."""

    @classmethod
    def of(cls, row: F64) -> Registration:
        """From zoom - 1, centre and shift (5,)."""
        zoom, u, v, x, y = map(float, row)
        return cls(1 + zoom, (u, v), (x, y))

    @property
    def row(self) -> F64:
        """(5,) zoom - 1, centre, shift: all zero where colour is as it was read."""
        return np.array([self.zoom - 1, *self.centre, *self.shift])

    def applied(self, frame: Frame) -> Frame:
        """The frame with its colour camera put right."""
        k = frame.color_intrinsics or frame.intrinsics
        f = Intrinsics(
            k.width,
            k.height,
            k.fx / self.zoom,
            k.fy / self.zoom,
            k.cx - self.centre[0] * k.fx / self.zoom,
            k.cy - self.centre[1] * k.fy / self.zoom,
        )
        shift = (frame.color_shift[0] + self.shift[0], frame.color_shift[1] + self.shift[1])
        return replace(frame, color_intrinsics=f, color_shift=shift)


@dataclass(frozen=True)
class Found:
    """Result of the matches."""

    registration: Registration
    sigma: F64
    """(5,) standard errors of zoom, centre and shift; pairs of frames are what varies (sandwich estimator)."""
    before: float
    after: float
    """Median relative distance of matched points on pairs that took no part in the estimate."""
    points: int

    @property
    def clear(self) -> bool:
        """Whether colour is certainly not as it was read: pairs that took no part fit better by a tenth, and the camera
        differs by more than three standard errors and by more than a pixel in 500."""
        theta = self.registration.row
        matters = abs(theta[0]) > 0.002 or np.abs(theta[1:3]).max() > 0.002 or np.abs(theta[3:]).max() > 0.005
        return bool(self.after < 0.9 * self.before and matters and (np.abs(theta) > 3 * self.sigma).any())

    def summary(self) -> dict[str, Any]:
        """JSON-able."""
        r = self.registration
        return {
            "zoom": r.zoom,
            "centre": r.centre,
            "shift_m": r.shift,
            "sigma": self.sigma.tolist(),
            "held_out_before": self.before,
            "held_out_after": self.after,
            "points": self.points,
            "clear": self.clear,
        }


def choose_nearby(count: int) -> list[tuple[int, int]]:
    """Pairs i < j near in the sequence, at most about twice as many as take part."""
    every = max(1, 2 * count // PAIRS)
    return [(i, i + step) for step in (1, 3) for i in range(0, count - step, every)]


def calibrate(views: Sequence[View], matches: Sequence[Match], T: F64 | None = None, gain: float = 1.0) -> Found | None:
    """The registration that matched features have, or None if there are too few.

    Args:
        T: (N, 4, 4) poses of the depth camera, and the depth's gain under them, if they are known without the features.
            Without poses the shift is hardly seen: points that are all as far to the side move like a rigid thing too.
    """
    far = []
    for m in matches:
        keep = np.unique(np.linspace(0, len(m.a) - 1, POINTS).astype(int))
        far += [replace(m, a=m.a[keep], b=m.b[keep])] if len(m.a) >= 20 else []
    far = [far[k] for k in np.unique(np.linspace(0, len(far) - 1, PAIRS).astype(int))] if far else []
    if len(far) < LEAST:
        return None
    held_out, used = far[::4], [m for k, m in enumerate(far) if k % 4]
    fitted, apart = (_Pairs.of(views, some, T, gain) for some in (used, held_out))

    def residual(theta: F64) -> F64:
        return fitted.residual(theta).ravel() / SCALE

    # Noise in the slopes of depth makes steps too short: the best of some multiples is taken.
    fit = least_squares(
        differences(residual, DELTA),
        np.zeros(5),
        loss=cauchy(1.0),
        prior=(np.zeros(5), PRIOR),
        damping=0,
        lengths=(1, 3, 6, 10),
        iterations=STEPS,
        tolerance=0.01 * float(PRIOR.min()),
    )
    assert fit is not None  # no state of this model is impossible
    scores = np.zeros((len(used), 5))
    np.add.at(scores, np.repeat(fitted.pair, 3), fit.jacobian * (fit.weight * fit.residual)[:, None])
    inverse = np.linalg.inv(fit.information + np.diag(PRIOR**-2.0))
    sigma = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse))
    before, after = (float(np.nanmedian(np.linalg.norm(apart.residual(t), axis=1))) for t in (np.zeros(5), fit.state))
    return Found(Registration.of(fit.state), sigma, before, after, sum(len(m.a) for m in used))


@dataclass(frozen=True)
class Grids:
    """The thinned depths of several views, to be looked up together."""

    depth: F32
    """(V, h, w) metres, 0 where a view has none."""
    camera: F64
    """(V, 6) fx, fy, cx, cy, width, height."""

    @classmethod
    def of(cls, views: Sequence[View]) -> Grids:
        """Views of whatever sizes."""
        cameras = np.array([(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in (v.camera for v in views)])
        depth = np.zeros((len(views), *(int(n) for n in cameras[:, :3:-1].max(0))), np.float32)
        for grid, view in zip(depth, views, strict=True):
            grid[: view.depth.shape[0], : view.depth.shape[1]] = view.depth
        return cls(depth, cameras)

    def inverse_depth(self, view: Any, xy: F64) -> F64:
        """(M,) bilinear inverse depth of views (M,), or of one, at (M, 2) on the plane z = 1; NaN at borders, holes."""
        fx, fy, cx, cy, width, height = self.camera[view].T
        u, v = xy[:, 0] * fx + cx, xy[:, 1] * fy + cy
        u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
        ok = (u0 >= 0) & (v0 >= 0) & (u0 < width - 1) & (v0 < height - 1)
        u0, v0 = np.where(ok, u0, 0), np.where(ok, v0, 0)
        du, dv = u - u0, v - v0
        d = self.depth[view, v0 + CORNERS[0], u0 + CORNERS[1]].astype(float)
        weight = np.abs(1 - CORNERS[0] - dv) * np.abs(1 - CORNERS[1] - du)
        low, high = d.min(0), d.max(0)
        ok &= (low > 0) & (high < 1.05 * low)
        total = (weight / np.maximum(d, 1e-6)).sum(0)
        return np.where(ok, total, np.nan)


CORNERS = np.array([[0, 0, 1, 1], [0, 1, 0, 1]])[..., None]
"""Rows and columns of the pixels about a place."""


@dataclass(frozen=True)
class _Pairs:
    """Matched features of all pairs in one row."""

    grids: Grids
    pair: NDArray[np.int64]
    """(M,) ascending."""
    view: NDArray[np.int64]
    """(2, M) the views of the pair."""
    rays: F64
    """(2, M, 2) as read."""
    z: F64
    """(2, M) sensor depth, metres."""
    motion: tuple[F64, F64] | None
    """Rotation and translation (M, 3, 3), (M, 3) of the second view's points into the first, if it is known."""

    @classmethod
    def of(cls, views: Sequence[View], matches: Sequence[Match], T: F64 | None, gain: float) -> _Pairs:
        pair = np.repeat(np.arange(len(matches)), [len(m.a) for m in matches])
        view = np.array([(m.i, m.j) for m in matches])[pair].T
        sides = [[(views[m.i], m.a) for m in matches], [(views[m.j], m.b) for m in matches]]
        rays = np.stack([np.concatenate([v.xy[index] for v, index in side]) for side in sides])
        z = np.stack([np.concatenate([v.z[index] for v, index in side]) for side in sides])
        motion = None
        if T is not None:
            D = (invert_T(T[[m.i for m in matches]]) @ T[[m.j for m in matches]])[pair]
            motion = D[:, :3, :3], D[:, :3, 3] / gain
        return cls(Grids.of(views), pair, view, rays, z, motion)

    def residual(self, theta: F64) -> F64:
        """(M, 3) what is left between the points of a pair under its motion (where it is not known, the rigid one that
        fits best), over depth; NaN where unknown."""
        P, Q = (self._points(side, theta) for side in (0, 1))
        on = np.isfinite(P).all(1) & np.isfinite(Q).all(1)
        on &= np.bincount(self.pair, on)[self.pair] >= 6
        p, q, pair = P[on], Q[on], np.unique(self.pair[on], return_inverse=True)[1]
        z = np.minimum(p[:, 2], q[:, 2])[:, None]
        if self.motion is not None:
            R, t = (part[on] for part in self.motion)
            r = (p - (R @ q[..., None])[..., 0] - t) / z
        w = 1 / z**2
        first = np.flatnonzero(np.diff(pair, prepend=-1))
        for _ in range(3 if self.motion is None and len(p) else 0):
            total = np.add.reduceat(w, first)
            pc, qc = (x - (np.add.reduceat(w * x, first) / total)[pair] for x in (p, q))
            R = nearest_rotation(np.add.reduceat((w * pc)[:, :, None] * qc[:, None], first))[pair]
            r = (pc - (R @ qc[..., None])[..., 0]) / z
            w = 1 / z**2 / (1 + (r**2).sum(1, keepdims=True) / SCALE**2)
        out = np.full((len(P), 3), np.nan)
        # Rays that are wider by the zoom have wider errors too; without this the best fit would be of no width.
        out[on] = r / (1 + theta[0], 1 + theta[0], 1) if len(p) else 0
        return out

    def _points(self, side: int, theta: F64) -> F64:
        """(M, 3) points of features in the depth camera under a registration; NaN where the depth there is unknown."""
        rays, z = self.rays[side], self.z[side]
        for _ in range(3):
            xy = (1 + theta[0]) * rays + theta[1:3] + theta[3:] / z[:, None]
            found = self.grids.inverse_depth(self.view[side], xy)
            z = np.where(np.isfinite(found), 1 / found, z)
        return np.column_stack([xy, np.ones(len(xy))]) / found[:, None]
