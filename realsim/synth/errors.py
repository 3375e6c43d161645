"""Errors of a reconstruction against the truth, by registration of surfaces.

Point-to-plane registration (Chen and Medioni 1992) of the delivered mesh to samples of the true surface, with and
without a scale. Only true surface that two cameras or more saw is requested.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.geometry import exp_so3, make_T, transform
from realsim.core.meshes import sampled
from realsim.core.rays import raycasting_scene
from realsim.core.types import F64
from realsim.synth.truth import Samples, read_truth

MARGIN = 0.3
"""Metres around the terrain that are measured."""


class Surface:
    """Triangles with closest-point and ray queries (Open3D, Embree), in metres."""

    def __init__(self, vertices: F64, triangles: NDArray[Any]) -> None:
        self.vertices, self.triangles = np.asarray(vertices, float), np.asarray(triangles, np.int64)
        self._scene = raycasting_scene(self.vertices, self.triangles)

    def closest(self, points: F64) -> F64:
        """(M, 3) nearest points on the surface to (M, 3) points."""
        found = self._scene.compute_closest_points(np.asarray(points, np.float32))
        return np.asarray(found["points"].numpy(), np.float64)

    def hit(self, origins: F64, directions: F64) -> F64:
        """(M,) distances along rays in lengths of the direction, infinite where nothing is hit."""
        rays = np.hstack([origins, directions]).astype(np.float32)
        return np.asarray(self._scene.cast_rays(rays)["t_hit"].numpy(), np.float64)

    def sample(self, count: int) -> F64:
        """(count, 3) points evenly spread over the surface."""
        return sampled(self.vertices, self.triangles, count, np.random.default_rng(0))[0]

    def moved(self, T: F64) -> Surface:
        """The surface under a similarity (4, 4)."""
        return Surface(transform(T, self.vertices), self.triangles)


@dataclass(frozen=True)
class Fit:
    """A similarity that takes the delivered mesh onto the truth."""

    T: F64
    """(4, 4), scale included."""
    scale: float
    rms: float
    """Metres, over the samples that take part."""


def read_surface(path: Path) -> Surface:
    """The triangles of a PLY file."""
    import trimesh

    if not path.is_file():
        raise RealsimError("the scene has no mesh", expected="mesh.ply of realsim reconstruct", file=path)
    mesh: Any = trimesh.load(path, process=False, force="mesh")
    if len(mesh.faces) == 0:
        raise RealsimError("the mesh has no triangles", expected="mesh.ply of realsim reconstruct", file=path)
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def compare(scene_folder: Path, truth_folder: Path) -> dict[str, Any]:
    """Measure `scene_folder/mesh.ply` (simulation frame) against the truth that `write_capture` wrote.

    Returns:
        `scale_error` |s - 1|, `tilt_deg`, `yaw_deg`, `origin_mm` of the delivered frame; and after rigid registration
        `tops_mm` (median over obstacles of the median height error of their tops), `tops_worst_mm`, `f_score_1cm`,
        `f_score_2cm`, `chamfer_mm`; and `delivered` with the same surface figures without registration.

    Raises:
        RealsimError: no mesh, no truth, or the mesh lies nowhere near the truth.
    """
    truth, samples = read_truth(truth_folder)
    surface = read_surface(truth_folder / "mesh.ply")
    mesh = read_surface(scene_folder / "mesh.ply")
    kept = samples.seen >= 2
    bounds = np.asarray(truth["bounds"]) + np.array([[-MARGIN], [MARGIN]])
    kept &= ((samples.points > bounds[0]) & (samples.points < bounds[1])).all(1)
    target = Samples(samples.points[kept], samples.normals[kept], samples.solid[kept], samples.seen[kept])
    similar, rigid = register(mesh, target, scale=True), register(mesh, target, scale=False)
    region = (target, bounds, float(truth["floor_z"]))
    # Errors of the delivered frame: where the true origin and axes lie in it.
    R = similar.T[:3, :3] / similar.scale
    return {
        "scale_error": abs(1 / similar.scale - 1),
        "tilt_deg": float(np.degrees(np.arctan2(np.hypot(R[0, 2], R[1, 2]), R[2, 2]))),
        "yaw_deg": float(np.degrees(np.arctan2(R[1, 0], R[0, 0]))),
        "origin_mm": 1e3 * float(np.linalg.norm(similar.T[:3, 3])),
        **surface_errors(mesh.moved(rigid.T), surface, *region),
        "delivered": surface_errors(mesh, surface, *region),
        "rms_mm": 1e3 * rigid.rms,
    }


def register(mesh: Surface, target: Samples, *, scale: bool) -> Fit:
    """The rigid motion (or similarity) that lays the mesh onto the samples; starts from the delivered pose and from
    a half turn, in case start and goal were taken for each other."""
    turned = make_T(exp_so3([0, 0, np.pi]), [float(target.points[:, 0].max()) - 0.45, 0, 0])
    starts = [_refine(mesh, target, T, scale, coarse=True) for T in (make_T(), turned)]
    best = _refine(mesh, target, min(starts, key=lambda f: f.rms).T, scale, coarse=False)
    if not np.isfinite(best.rms):
        raise RealsimError("the mesh cannot be registered to the truth", hint="is it a reconstruction of this capture?")
    return best


def _refine(mesh: Surface, target: Samples, T: F64, scale: bool, *, coarse: bool) -> Fit:
    rng = np.random.default_rng(0)
    weight = _balance(target)
    pick = rng.choice(len(weight), 4_000 if coarse else 20_000, p=weight / weight.sum())
    P, N = target.points[pick], target.normals[pick]
    factor, rms = float(np.cbrt(np.linalg.det(T[:3, :3]))), float("inf")
    for reach in [0.2] * 8 + [0.1] * 8 + [0.05] * 8 if coarse else [0.05] * 4 + [0.02] * 16:
        back = np.linalg.inv(T)
        q = transform(T, mesh.closest(transform(back, P)))
        r = ((q - P) * N).sum(1)
        near = np.linalg.norm(q - P, axis=1) < reach
        if near.sum() < 500:
            return Fit(T, factor, float("inf"))
        w = np.where(near, (1 - np.clip(r / reach, -1, 1) ** 2) ** 2, 0)
        centre = P[near].mean(0)
        J = np.hstack([np.cross(q - centre, N), N] + ([((q - centre) * N).sum(1)[:, None]] if scale else []))
        x = -np.linalg.solve((J * w[:, None]).T @ J + 1e-9 * np.eye(J.shape[1]), J.T @ (w * r))
        grow = 1 + (float(np.clip(x[6], -0.1, 0.1)) if scale else 0.0)
        D = make_T(grow * exp_so3(x[:3]), x[3:6])
        T = make_T(t=centre) @ D @ make_T(t=-centre) @ T
        factor *= grow
        rms = float(np.sqrt((w * r**2).sum() / w.sum())) + 0.05 * (1 - float(near.mean()))
    return Fit(T, factor, rms)


def _balance(target: Samples) -> F64:
    """Weights by which floor, tops and the sides of each direction count alike, whatever their area."""
    N = target.normals
    kind = np.where(np.abs(N[:, 2]) > 0.7, 1, 2 + (np.arctan2(N[:, 1], N[:, 0]) // (np.pi / 2) + 2).astype(int) % 4)
    kind[target.solid < 0] = 0
    counts = np.bincount(kind, minlength=6)
    return 1.0 / np.maximum(counts[kind], 0.05 * len(kind))


def surface_errors(mesh: Surface, truth: Surface, target: Samples, bounds: F64, floor_z: float) -> dict[str, float]:
    """Height errors of tops, and F-scores between the mesh inside `bounds` and the seen true surface.

    The skirt and bottom that close a mesh below the floor measure nothing and are left out.
    """
    low = np.maximum(bounds[0], [-np.inf, -np.inf, floor_z - 0.03])
    found = mesh.sample(400_000)
    found = found[((found > low) & (found < bounds[1])).all(1)]
    found = found[:: max(1, len(found) // 100_000)]
    missing = np.linalg.norm(mesh.closest(target.points) - target.points, axis=1)
    off = np.linalg.norm(truth.closest(found) - found, axis=1)
    tops = _top_errors(mesh, target)
    out = {
        "tops_mm": 1e3 * float(np.median(tops)) if len(tops) else float("nan"),
        "tops_worst_mm": 1e3 * float(np.max(tops)) if len(tops) else float("nan"),
        "chamfer_mm": 500 * float(missing.mean() + off.mean()),
    }
    for cm in (1, 2):
        precision, recall = float((off < cm / 100).mean()), float((missing < cm / 100).mean())
        out[f"f_score_{cm}cm"] = 2 * precision * recall / max(precision + recall, 1e-9)
    return out


def _top_errors(mesh: Surface, target: Samples) -> F64:
    """(obstacles,) median absolute height error over each solid's seen top, metres."""
    out = []
    for i in range(int(target.solid.max()) + 1):
        here = (target.solid == i) & (target.normals[:, 2] > 0.7)
        if here.sum() < 15:
            continue
        above = target.points[here] + [0, 0, 0.12]
        dz = 0.12 - mesh.hit(above, np.tile([0.0, 0.0, -1.0], (len(above), 1)))
        dz = dz[np.isfinite(dz) & (np.abs(dz) < 0.12)]
        if len(dz) >= 10:
            out.append(float(np.median(np.abs(dz))))
    return np.array(out)
