"""Interface of adapters, and their shared parts: axes, confidences, poses."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ModelError
from realsim.core.geometry import invert_T, nearest_rotation, quat_to_R
from realsim.core.types import F32, F64, Bool

ROTATION_TOLERANCE = 0.1
"""Largest entry by which what is called a rotation may differ from the nearest one (half floats give 0.001)."""


@dataclass(frozen=True)
class Call:
    """The circumstances of one run of a model."""

    n: int
    """Views that count."""
    ran: int
    """Views that went in: what was repeated to fill a frozen graph comes after those that count and is dropped."""
    height: int
    width: int
    pose: str
    conf: str
    intrinsics: F64
    """(n, 3, 3) the capture's cameras on the model's pixel grid."""


@dataclass(frozen=True)
class Prediction:
    """N views of one run, in one scale."""

    local_points: F32
    """(N, H, W, 3) OpenCV camera frame."""
    T_world_camera: F64
    """(N, 4, 4); NaN where the model gives none (`mono`)."""
    conf: F32
    """(N, H, W) 0..1."""
    mask: Bool
    """(N, H, W)."""
    metric_scale: float | None = None
    """Metres per unit as the model claims."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Consistency figures of one run, for the report."""


@dataclass(frozen=True)
class Adapter:
    """A kind of model."""

    needs: Mapping[str, tuple[str, ...]]
    """Role -> names of the output in published exports."""
    takes: Mapping[str, tuple[str, ...]]
    """The same for what may be absent."""
    unpack: Callable[[Mapping[str, NDArray], Call], Prediction]
    """Outputs by role -> a prediction."""

    def match(self, names: Iterable[str]) -> dict[str, str]:
        """Role -> output name, for the roles that are there."""
        there = set(names)
        roles = {**self.needs, **self.takes}
        return {role: next(n for n in known if n in there) for role, known in roles.items() if there & set(known)}

    def share(self, names: Iterable[str]) -> float:
        """Share of the needed outputs that are present, 0..1."""
        return sum(role in self.match(names) for role in self.needs) / len(self.needs)


POSE_NAMES = (
    "camera_poses",
    "T_world_camera",
    "cam_poses",
    "poses",
    "pose_enc",
    "extrinsics",
    "extrinsic",
    "raw_poses",
)
CONF_NAMES = ("conf", "confidence")
MASK = {"mask": ("mask", "masks"), "metric_scale": ("metric_scale", "metric_scaling_factor")}


def as_maps(name: str, array: NDArray, call: Call, channels: int) -> F32:
    """(n, H, W, channels) from any order of axes and any axes of length one; `channels` 1 drops the last axis.

    Declared axes are not asked: the shape that came out decides.
    """
    n, h, w, c = call.ran, call.height, call.width, channels
    dense = [k for k in array.shape if k != 1]
    for axes, back in (((n, h, w, c), None), ((n, c, h, w), (0, 2, 3, 1))):
        if dense == [k for k in axes if k != 1]:
            out = array.reshape(axes)
            out = np.asarray(out if back is None else out.transpose(back), np.float32)[: call.n]
            return out[..., 0] if channels == 1 else out
    raise ModelError(
        f"the output {name} has the wrong shape",
        expected=f"{n} views of {h} x {w} pixels" + (f" with {c} numbers each" if c > 1 else ""),
        found=str(array.shape),
        hint="axes that are declared dynamic can be fixed in the graph: set n_static or fixed_hw in its metadata",
    )


def as_rows(name: str, array: NDArray, call: Call, *shapes: tuple[int, ...]) -> F64:
    """(n, *shape) float64 for the first of `shapes` that fits an output with one entry per view."""
    for shape in shapes:
        size = int(np.prod(shape))
        if array.size == call.ran * size and tuple(array.shape[-len(shape) :]) == shape:
            return array.reshape(-1, *shape).astype(float)[: call.n]
    raise ModelError(
        f"the output {name} has the wrong shape",
        expected=" or ".join(str((call.ran, *s)) for s in shapes),
        found=str(array.shape),
    )


def read_poses(array: NDArray, call: Call) -> F64:
    """(n, 4, 4) camera to world of any way in which models write poses; see the contract in docs/models.md."""
    if call.pose == "pose_enc9":
        return invert_T(_from_encoding(as_rows("pose", array, call, (9,))))
    if call.pose == "raw9":
        rows = as_rows("pose", array, call, (12,))
        return _rigid(rows[:, :9].reshape(-1, 3, 3), rows[:, 9:], loose=True)
    M = as_rows("pose", array, call, (4, 4), (3, 4))
    T = _rigid(M[:, :3, :3], M[:, :3, 3])
    return invert_T(T) if call.pose == "w2c" else T


def _from_encoding(rows: F64) -> F64:
    """VGGT's nine numbers: translation, quaternion x y z w, two fields of view. World to camera."""
    with np.errstate(invalid="ignore"):
        R = np.stack([quat_to_R(q[[3, 0, 1, 2]]) for q in rows[:, 3:7]])
    return _rigid(R, rows[:, :3])


def encoded_intrinsics(rows: F64, call: Call) -> F64:
    """(n, 3, 3) of the fields of view in VGGT's encoding; its principal point is the middle, at (W / 2, H / 2)."""
    K = np.zeros((len(rows), 3, 3))
    K[:, 0, 0] = call.width / 2 / np.tan(rows[:, 8] / 2)
    K[:, 1, 1] = call.height / 2 / np.tan(rows[:, 7] / 2)
    K[:, :, 2] = (call.width / 2, call.height / 2, 1.0)
    return K


def _rigid(R: F64, t: F64, loose: bool = False) -> F64:
    """(n, 4, 4) with the nearest rotations. A matrix far from one is not a pose (if it is declared to be one)."""
    T = np.tile(np.eye(4), (len(R), 1, 1))
    for k, M in enumerate(R):
        if not (np.isfinite(M).all() and np.isfinite(t[k]).all()):
            T[k] = np.nan
            continue
        T[k, :3, :3], T[k, :3, 3] = nearest_rotation(M), t[k]
        off = float(np.abs(T[k, :3, :3] - M).max())
        if not loose and off > ROTATION_TOLERANCE:
            raise ModelError(
                "the model's poses are not rigid motions",
                expected="rotations with determinant +1",
                found=f"an entry that is off by {off:.2g} from the nearest rotation (view {k})",
                hint="is pose right? One of c2w, w2c, pose_enc9, raw9 in the model's metadata",
            )
    return T


def read_conf(found: Mapping[str, NDArray], call: Call, role: str = "conf") -> F32:
    """(n, H, W) 0..1 from the model's own way of saying how sure it is; ones where it says nothing."""
    if role not in found or call.conf == "none":
        return np.ones((call.n, call.height, call.width), np.float32)
    raw = as_maps(role, found[role], call, 1)
    if call.conf == "exp1":
        if (low := float(np.nanmin(raw, initial=np.inf))) < 1 - 1e-3:
            raise ModelError(
                "the model's confidence is not what its metadata says",
                expected="conf exp1: numbers of 1 and more",
                found=f"a smallest value of {low:.3g}",
                hint="set conf to logit, log_error or none in the model's metadata",
            )
        return (1 - 1 / np.maximum(raw, 1)).astype(np.float32)
    sign = -1.0 if call.conf == "log_error" else 1.0
    return (1 / (1 + np.exp(np.clip(-sign * raw, -60, 60)))).astype(np.float32)


def read_mask(found: Mapping[str, NDArray], call: Call, points: F32) -> Bool:
    """(n, H, W) finite points in front of the camera, less what the model itself masks."""
    with np.errstate(invalid="ignore"):
        mask = np.isfinite(points).all(-1) & (points[..., 2] > 0)
    if "mask" in found:
        mask &= as_maps("mask", found["mask"].astype(np.float32), call, 1) > 0.5
    return mask


def read_claim(found: Mapping[str, NDArray]) -> float | None:
    """Metres per unit, as the model claims."""
    if "metric_scale" not in found:
        return None
    value = float(np.median(found["metric_scale"]))
    return value if np.isfinite(value) and value > 0 else None


def posed(points: F32, T: F64, found: Mapping[str, NDArray], call: Call) -> Prediction:
    """The prediction of a model of many views: points (n, H, W, 3) in their cameras, poses (n, 4, 4), and the rest."""
    mask = read_mask(found, call, points)
    figures = {"focal_ratio": focal_ratio(points, mask, call.intrinsics)}
    return Prediction(points, T, read_conf(found, call), mask, read_claim(found), figures)


def unproject(depth: F32, K: F64) -> F32:
    """(n, H, W, 3) points of depth along z (n, H, W) by cameras (n, 3, 3)."""
    h, w = depth.shape[1:]
    u, v = np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32)
    x = (u[None] - K[:, 0, 2, None]) / K[:, 0, 0, None]
    y = (v[None] - K[:, 1, 2, None]) / K[:, 1, 1, None]
    shape = depth.shape
    return np.stack(
        [depth * np.broadcast_to(x[:, None, :], shape), depth * np.broadcast_to(y[:, :, None], shape), depth], -1
    ).astype(np.float32)


def focal_ratio(points: F32, mask: Bool, K: F64) -> float:
    """The model's focal length over the capture's: how much wider than the points' own rays the known ones are."""
    with np.errstate(all="ignore"):
        own = points[..., :2] / points[..., 2:]
    known = unproject(np.ones(points.shape[:3], np.float32), K)[..., :2]
    far = mask & (np.abs(known).max(-1) > 0.5 * np.abs(known).max())
    if not far.any():
        return float("nan")
    a, b = np.linalg.norm(known[far], axis=1), np.linalg.norm(own[far], axis=1)
    return float(np.median(a / np.maximum(b, 1e-9)))
