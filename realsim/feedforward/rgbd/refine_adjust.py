"""Least squares over camera poses, one depth gain and the tracks' points: what all observations agree on best.

Four kinds of residuals, each divided by a standard deviation that is itself found from the residuals:

    image    (point seen from camera - feature) * focal          pixels
    depth    (point's depth / gain - sensor depth) / depth^2      1/m: stereo noise grows with the square of depth
    surface  n · (p_i - q_j), poses' shift / gain, / depth^2      1/m, in one frame
    prior    pose - given pose                                   m and rad

Depth and surface residuals are in the sensor's units on purpose: in corrected metres they would shrink together with
the gain, and with their own standard deviations free the best fit would be a world of no size.

Points are eliminated, so a step solves a sparse system in six unknowns a frame and one gain.
Robustness is a Student t distribution with 4 degrees of freedom by iterated weights; the standard deviations are
Helmert's variance components, sum of weighted squares over redundancy. Conventions of the update: R <- exp(w) R,
c <- c + t, both in world axes.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags_array, vstack
from scipy.spatial.transform import Rotation

from realsim.core.least_squares import Normal
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import Tracks
from realsim.feedforward.rgbd.pose_graph import hat
from realsim.feedforward.rgbd.refine_pairs import Surface

GAIN_PRIOR = 0.05
"""Depth cameras are off by a percent or two; this prior only fixes the gain if the data leave it free."""
SURFACE_CORRELATION = 12.0
"""Surface samples share sensor pattern, interpolation and, between pairs, themselves: twelve count as one. Less lets
surfaces overrule features: with 3, positions were 20 percent worse on one rendered capture of three, equal on two."""
FLOOR_T, FLOOR_R = 2e-4, 2e-4
"""Given poses are never believed better than 0.2 mm and 0.2 mrad."""


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of the five kinds of observation."""

    image: float = 0.7
    depth: float = 0.002
    surface: float = 0.002
    position: float = 0.01
    angle: float = 0.005


@dataclass(frozen=True)
class State:
    """The unknowns."""

    R: F64
    """(N, 3, 3)."""
    c: F64
    """(N, 3)."""
    log_gain: float
    X: F64
    """(P, 3) world."""

    @property
    def T(self) -> F64:
        """(N, 4, 4) T_world_camera."""
        T = np.tile(np.eye(4), (len(self.R), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.R, self.c
        return T

    @property
    def gain(self) -> float:
        return float(np.exp(self.log_gain))


@dataclass(frozen=True)
class Step:
    """One linearisation at a state, solved."""

    state: State
    """After the step."""
    sigmas: Sigmas
    """After the step."""
    move: float
    """Largest change of a position, metres."""
    gain_sigma: float
    """Standard error of the log gain if the model holds."""
    influence: F64
    """(rows,) what each residual contributes to the log gain; they sum to the last step of it."""
    owner: np.ndarray
    """(rows,) frame to which each residual belongs."""
    track_residual: F64
    """(M, 3) x, y in pixels and depth in 1/m, unweighted."""
    surface_residual: F64
    """(K,) 1/m, unweighted."""


def initial_state(T_world_camera: F64, tracks: Tracks, gain: float = 1.0) -> State:
    """Points start at the mean of their sensor depths."""
    R, c = T_world_camera[:, :3, :3].copy(), T_world_camera[:, :3, 3].copy()
    rays = np.column_stack([tracks.xy, np.ones(len(tracks.z))]) * tracks.z[:, None] * gain
    world = np.einsum("mab,mb->ma", R[tracks.view], rays) + c[tracks.view]
    X = np.zeros((tracks.count, 3))
    np.add.at(X, tracks.point, world)
    X /= np.maximum(np.bincount(tracks.point, minlength=tracks.count), 1)[:, None]
    return State(R, c, float(np.log(gain)), X)


def student(residual: F64, sigma: float, nu: float = 4.0) -> F64:
    """Weights of the t distribution."""
    return (nu + 1) / (nu + (residual / sigma) ** 2)


def solve_step(
    state: State,
    given: State,
    tracks: Tracks,
    surface: Surface,
    sigmas: Sigmas,
    *,
    estimate_gain: bool,
    fit_prior: bool,
    seed: int,
    fit_sigmas: bool = True,
) -> Step:
    """One Gauss-Newton step, then the variance components at the linearised solution.

    Without `fit_sigmas` the standard deviations stay as they are, and features get Cauchy's weights instead: half at
    two deviations. Poses that were only estimated have more false matches than a t distribution forgives.
    """
    n, M = len(state.R), len(tracks.z)
    width = 6 * n + 1
    J_t, r_t = _track_rows(state, tracks, width)
    J_s, r_s = _surface_rows(state, surface, width, J_t.shape[1])
    # (6N,) position and rotation, world axes, current minus given.
    turn = Rotation.from_matrix(state.R @ np.swapaxes(given.R, 1, 2)).as_rotvec()
    r_p = np.column_stack([state.c - given.c, turn]).ravel()
    sigma_t = np.tile([sigmas.image, sigmas.image, sigmas.depth], M)
    # The two image coordinates and the depth of one observation are outliers separately: a feature may be right where
    # its depth is not.
    e2 = r_t.reshape(M, 3) / (sigmas.image, sigmas.image, sigmas.depth)
    square = e2[:, 0] ** 2 + e2[:, 1] ** 2
    image_w, depth_w = 5.0 / (4.0 + 0.5 * square), student(e2[:, 2], 1.0)
    if not fit_sigmas:
        image_w, depth_w = 4 / (4 + square), 4 / (4 + e2[:, 2] ** 2)
    w_t = np.column_stack([image_w, image_w, depth_w]).ravel()
    w_s = student(r_s, sigmas.surface)
    J, r = vstack([J_t, J_s], format="csr"), np.concatenate([r_t, r_s])
    weight = np.concatenate([w_t / sigma_t**2, w_s / sigmas.surface**2 / SURFACE_CORRELATION])
    prior, prior_r = np.zeros((2, J.shape[1]))
    prior[: width - 1] = np.tile([sigmas.position] * 3 + [sigmas.angle] * 3, n) ** -2.0
    prior[width - 1] = GAIN_PRIOR**-2.0 if estimate_gain else 1e14
    prior_r[:width] = np.append(r_p, state.log_gain if estimate_gain else 0.0)
    JW = J.multiply(weight[:, None]).tocsr()
    ridge = np.where(np.arange(len(prior)) < width, 1e-9, 0)
    normal = Normal(J.T @ JW + diags_array(prior + ridge), 3 * tracks.count)
    x = normal.solve(-(JW.T @ r + prior * prior_r))

    # What a residual does to the gain: row of the inverse that belongs to the gain.
    u = normal.solve(np.eye(1, len(x), width - 1)[0])
    influence = np.concatenate([-(J @ u) * weight * r, -(u * prior * prior_r)[: width - 1]])

    after = r + J @ x
    r_t1, r_s1 = after[: 3 * M].reshape(M, 3), after[3 * M :]
    blocks = J_t[:, width:].tobsr((3, 3)).data if M else np.zeros((0, 3, 3))
    inverse = normal.inner_inverse[tracks.point]
    leverage = np.einsum("mka,mab,mkb->mk", blocks, inverse, blocks) * weight[: 3 * M].reshape(M, 3)
    new = _components(sigmas, r_t1, w_t.reshape(M, 3), leverage, r_s1, w_s) if fit_sigmas else sigmas
    if fit_prior:
        new = _prior_components(new, sigmas, r_p + x[: width - 1], normal, seed)
    return Step(
        _apply(state, x),
        new,
        float(np.abs(x[: width - 1].reshape(n, 6)[:, :3]).max(initial=0)),
        float(np.sqrt(max(u[width - 1], 0))),
        influence,
        np.concatenate([np.repeat(tracks.view, 3), surface.i, np.repeat(np.arange(n), 6)]),
        r_t1,
        r_s1,
    )


def _apply(state: State, x: F64) -> State:
    width = 6 * len(state.R) + 1
    step = x[: width - 1].reshape(-1, 6)
    R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ state.R
    X = state.X + x[width:].reshape(-1, 3)
    return replace(state, R=R, c=state.c + step[:, :3], log_gain=state.log_gain + x[width - 1], X=X)


def _track_rows(state: State, t: Tracks, width: int) -> tuple[csr_matrix, F64]:
    """Jacobian (3M, width + 3P) and residuals (3M,)."""
    M = len(t.z)
    Rt = np.swapaxes(state.R[t.view], 1, 2)
    arm = state.X[t.point] - state.c[t.view]
    y = np.einsum("mab,mb->ma", Rt, arm)
    z = np.maximum(y[:, 2], 0.05)
    r = np.column_stack(
        [
            (y[:, 0] / z - t.xy[:, 0]) * t.focal,
            (y[:, 1] / z - t.xy[:, 1]) * t.focal,
            (y[:, 2] / state.gain - t.z) / t.z**2,
        ]
    )
    D = np.zeros((M, 3, 3))
    D[:, 0, 0] = D[:, 1, 1] = t.focal / z
    D[:, 0, 2], D[:, 1, 2] = -y[:, 0] / z**2 * t.focal, -y[:, 1] / z**2 * t.focal
    D[:, 2, 2] = 1 / t.z**2 / state.gain
    A = D @ Rt
    gain = np.zeros((M, 3, 1))
    gain[:, 2, 0] = -y[:, 2] / state.gain / t.z**2
    data = np.concatenate([-A, A @ hat(arm), gain, A], 2)
    poses, points = 6 * t.view[:, None] + np.arange(6), width + 3 * t.point[:, None] + np.arange(3)
    cols = np.repeat(np.concatenate([poses, np.full((M, 1), width - 1), points], 1), 3, axis=0)
    shape = (3 * M, width + 3 * t.count)
    return csr_matrix((data.ravel(), cols.ravel(), np.arange(0, 30 * M + 1, 10)), shape), r.ravel()


def _surface_rows(state: State, s: Surface, width: int, unknowns: int) -> tuple[csr_matrix, F64]:
    """Jacobian (K, unknowns) and residuals (K,), 1/m."""
    K = len(s.i)
    n = np.einsum("kab,kb->ka", state.R[s.j], s.n)
    a = np.einsum("kab,kb->ka", state.R[s.i], s.p)
    b = np.einsum("kab,kb->ka", state.R[s.j], s.q)
    shift = (state.c[s.i] - state.c[s.j]) / state.gain
    scale = 1 / s.z**2
    r = np.einsum("ka,ka->k", n, a + shift - b) * scale
    # n·(w × a) = w·(a × n)
    along = n / state.gain
    data = np.column_stack([along, np.cross(a, n), -along, -np.cross(a + shift, n), -np.einsum("ka,ka->k", n, shift)])
    cols = np.column_stack([s.i[:, None] * 6 + np.arange(6), s.j[:, None] * 6 + np.arange(6), np.full(K, width - 1)])
    data = data * scale[:, None]
    return csr_matrix((data.ravel(), cols.ravel(), np.arange(0, 13 * K + 1, 13)), shape=(K, unknowns)), r


def _components(sigmas: Sigmas, r_t: F64, w_t: F64, leverage: F64, r_s: F64, w_s: F64) -> Sigmas:
    """Variance components of image, depth and surface: weighted squares over redundancy (1 - leverage)."""
    image, depth, surface = sigmas.image, sigmas.depth, sigmas.surface
    if len(r_t) > 30:
        free = np.maximum(1 - leverage, 0)
        image = np.sqrt((w_t[:, :2] * r_t[:, :2] ** 2).sum() / max(free[:, :2].sum(), 1))
        depth = np.sqrt((w_t[:, 2] * r_t[:, 2] ** 2).sum() / max(free[:, 2].sum(), 1))
    if len(r_s) > 30:
        surface = np.sqrt((w_s * r_s**2).mean())
    return replace(
        sigmas,
        image=float(np.clip(image, 0.05, 5)),
        depth=float(np.clip(depth, 1e-4, 0.05)),
        surface=float(np.clip(surface, 1e-4, 0.05)),
    )


def _prior_components(new: Sigmas, old: Sigmas, r_p: F64, normal: Normal, seed: int) -> Sigmas:
    """How far the given poses are off, from how far the data moves them against how far it could.

    sigma^2 = sum of squares / (count - trace(C) / sigma_old^2), with C the posterior covariance (MacKay 1992,
    eq. 4.9); the trace by Hutchinson's random signs, so that the cost stays linear in the frames.
    """
    n = len(r_p) // 6
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (n, 3, 24))
    values = []
    for part, sigma, floor in ((0, old.position, FLOOR_T), (1, old.angle, FLOOR_R)):
        probe = np.zeros((n, 2, 3, 24))
        probe[:, part] = signs
        probe = np.vstack([probe.reshape(6 * n, 24), np.zeros((1, 24))])
        trace = float((probe * normal.solve_kept(probe)).sum() / 24)
        determined = np.clip(3 * n - trace / sigma**2, 0.02 * n, 3 * n)
        square = float((r_p.reshape(n, 2, 3)[:, part] ** 2).sum())
        values.append(max(np.sqrt(square / determined), floor))
    return replace(new, position=float(min(values[0], 0.5)), angle=float(min(values[1], 0.2)))
