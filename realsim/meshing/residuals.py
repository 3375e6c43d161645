"""Distance of the views' depth from the mesh."""

from __future__ import annotations

import numpy as np

from realsim.core.types import AlignedScene, ViewResidual
from realsim.meshing.surface import Surface


def residuals(aligned: AlignedScene, surface: Surface, count: int, step: int = 4) -> tuple[ViewResidual, ...]:
    """Of `count` evenly spread views, those that see the mesh, each on every `step`-th pixel: measured minus mesh
    along the ray, metres."""
    metric = aligned.metric
    if metric is None or count == 0 or len(surface.triangles) == 0:
        return ()
    rays = surface.rays()
    out = []
    for i in np.unique(np.linspace(0, len(metric) - 1, min(count, len(metric))).round().astype(int)):
        view = metric.load(int(i))
        T = aligned.T_sim_camera(int(i))
        P = view.points[step // 2 :: step, step // 2 :: step].astype(np.float64)
        mask = view.mask[step // 2 :: step, step // 2 :: step]
        length = np.linalg.norm(P, axis=-1)
        direction = np.divide(P, length[..., None], out=np.zeros_like(P), where=mask[..., None]) @ T[:3, :3].T
        hit, _ = rays.cast(np.broadcast_to(T[:3, 3], P.shape), direction)
        image = np.where(mask & np.isfinite(hit), length - hit, np.nan).astype(np.float32)
        known = np.abs(image[np.isfinite(image)])
        if known.size:
            out.append(ViewResidual(metric.frames[i].name, image, float(np.median(known))))
    return tuple(out)
