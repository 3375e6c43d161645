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

from realsim.core.geometry import invert_T, nearest_rotation
from realsim.core.least_squares import cauchy, differences, least_squares
from realsim.core.types import F64, Frame, Intrinsics
from realsim.feedforward.rgbd.features import Match, View

PRIOR = np.array([0.1, 0.03, 0.03, 0.03, 0.03])
"""Standard deviations of zoom, centre (2, on the plane z = 1) and shift (2, metres): colour and depth cameras of one
housing. Kinect: 0.11, 0.01, 0.025 m."""
LEAST = 2000
"""Matched points below which nothing is concluded."""
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
    held_out, used = far[::4], [m for k, m in enumerate(far) if k % 4]
    if sum(len(m.a) for m in used) < LEAST or not held_out:
        return None
    known = None if T is None else (T, gain)

    def residual(theta: F64) -> F64:
        return np.concatenate([_residual(views, m, theta, known).ravel() for m in used]) / SCALE

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
    pair = np.repeat(np.arange(len(used)), [3 * len(m.a) for m in used])
    np.add.at(scores, pair, fit.jacobian * (fit.weight * fit.residual)[:, None])
    inverse = np.linalg.inv(fit.information + np.diag(PRIOR**-2.0))
    sigma = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse))
    before, after = (
        float(np.nanmedian(np.concatenate([np.linalg.norm(_residual(views, m, t, known), axis=1) for m in held_out])))
        for t in (np.zeros(5), fit.state)
    )
    return Found(Registration.of(fit.state), sigma, before, after, sum(len(m.a) for m in used))


Known = tuple[F64, float] | None
"""Poses and gain, as `calibrate` has them."""


def _residual(views: Sequence[View], m: Match, theta: F64, known: Known) -> F64:
    """(M, 3) what is left between the points of a pair under its motion (where it is not known, the rigid one that fits
    best), over depth; NaN where unknown."""
    P, Q = _points(views[m.i], m.a, theta), _points(views[m.j], m.b, theta)
    on = np.isfinite(P).all(1) & np.isfinite(Q).all(1)
    out = np.full((len(P), 3), np.nan)
    p, q = P[on], Q[on]
    if len(p) < 6:
        return out
    z = np.minimum(p[:, 2], q[:, 2])
    if known is not None:
        D = invert_T(known[0][m.i]) @ known[0][m.j]
        r = (p - q @ D[:3, :3].T - D[:3, 3] / known[1]) / z[:, None]
    w = 1 / z**2
    for _ in range(3 if known is None else 0):
        pc, qc = (w[:, None] * p).sum(0) / w.sum(), (w[:, None] * q).sum(0) / w.sum()
        R = nearest_rotation((w[:, None] * (p - pc)).T @ (q - qc))
        r = (p - pc - (q - qc) @ R.T) / z[:, None]
        w = 1 / z**2 / (1 + (r**2).sum(1) / SCALE**2)
    # Rays that are wider by the zoom have wider errors too; without this the best fit would be a world of no width.
    r[:, :2] /= 1 + theta[0]
    out[on] = r
    return out


def _points(view: View, index: np.ndarray, theta: F64) -> F64:
    """(M, 3) points of features in the depth camera under a registration; NaN where the depth there is unknown."""
    rays, z = view.xy[index], view.z[index]
    for _ in range(3):
        xy = (1 + theta[0]) * rays + theta[1:3] + theta[3:] / z[:, None]
        found = look_up_inverse_depth(view, xy)
        z = np.where(np.isfinite(found), 1 / found, z)
    z = 1 / found
    return np.column_stack([xy, np.ones(len(xy))]) * z[:, None]


CORNERS = np.array([[0, 0, 1, 1], [0, 1, 0, 1]])[..., None]
"""Rows and columns of the pixels about a place."""


def look_up_inverse_depth(view: View, xy: F64) -> F64:
    """(M,) bilinear inverse depth of the thinned grid, NaN at borders and holes."""
    c = view.camera
    u, v = xy[:, 0] * c.fx + c.cx, xy[:, 1] * c.fy + c.cy
    u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
    ok = (u0 >= 0) & (v0 >= 0) & (u0 < c.width - 1) & (v0 < c.height - 1)
    u0, v0 = np.where(ok, u0, 0), np.where(ok, v0, 0)
    du, dv = u - u0, v - v0
    d = view.depth[v0 + CORNERS[0], u0 + CORNERS[1]].astype(float)
    weight = np.abs(1 - CORNERS[0] - dv) * np.abs(1 - CORNERS[1] - du)
    low, high = d.min(0), d.max(0)
    ok &= (low > 0) & (high < 1.05 * low)
    total = (weight / np.maximum(d, 1e-6)).sum(0)
    return np.where(ok, total, np.nan)
