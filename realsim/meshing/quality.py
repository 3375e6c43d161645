"""Is a mesh sound, and how far is it from what the views measured?"""

import numpy as np

from realsim.core.meshes import edges_of, linked
from realsim.core.types import AlignedScene, Bool, MeshQuality, ViewResidual
from realsim.meshing.surface import Surface, components, first_of_each


def degenerate(surface: Surface, min_height: float = 1e-7) -> Bool:
    """(K,) triangles with a repeated corner or lower than `min_height` metres over their longest side."""
    t = surface.triangles
    repeated = (t[:, 0] == t[:, 1]) | (t[:, 1] == t[:, 2]) | (t[:, 2] == t[:, 0])
    corners = surface.vertices[t]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(1)
    return repeated | (2 * surface.areas() < min_height * np.maximum(longest, 1e-12))


def corner_fans(triangles: np.ndarray) -> np.ndarray:
    """(3K,) the fan that each triangle corner belongs to: corners of one vertex whose triangles share an edge at it.

    A vertex with more than one fan is one where sheets merely touch.
    """
    t = triangles.astype(np.int64)
    after = np.roll(np.arange(t.size).reshape(-1, 3), -1, axis=1).ravel()
    of_half = edges_of(triangles).of_side
    # Edges of three and more triangles link all of them, pair by pair in the order of the half-edges.
    order = np.argsort(of_half, kind="stable")
    pair = np.flatnonzero(of_half[order][1:] == of_half[order][:-1])
    h, g = order[pair], order[pair + 1]
    ends_h, ends_g = np.stack([h, after[h]], -1), np.stack([g, after[g]], -1)
    same = t.ravel()[ends_h[:, 0]] == t.ravel()[ends_g[:, 0]]
    ends_g = np.where(same[:, None], ends_g, ends_g[:, ::-1])
    return linked(ends_h.ravel(), ends_g.ravel(), t.size)


def passes(triangles: np.ndarray, of_half: np.ndarray, edges: int) -> np.ndarray:
    """(E,) how often each edge is passed from its lower to its higher vertex."""
    forward = (triangles < np.roll(triangles, -1, axis=1)).ravel()
    return np.bincount(of_half[forward], minlength=edges)


def non_manifold(surface: Surface) -> tuple[int, int]:
    """Edges shared by more than two triangles or passed twice in one direction; vertices where fans merely touch."""
    t = surface.triangles.astype(np.int64)
    if len(t) == 0:
        return 0, 0
    edges = edges_of(surface.triangles)
    count, forward = edges.uses, passes(surface.triangles, edges.of_side, len(edges.uses))
    bad_edges = int(((count > 2) | (np.maximum(forward, count - forward) > 1)).sum())
    corner = t.ravel()
    fans = corner[first_of_each(np.stack([corner, corner_fans(surface.triangles)], -1))]
    return bad_edges, int((np.bincount(fans) > 1).sum())


def crossing(surface: Surface) -> Bool:
    """(K,) triangles that cut another one (exact test of all pairs that share no corner, over a bounding volume)."""
    import pymeshlab

    if len(surface.triangles) == 0:
        return np.zeros(0, bool)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.triangles))
    meshes.compute_selection_by_self_intersections_per_face()
    return np.asarray(meshes.current_mesh().face_selection_array(), bool)


def check(surface: Surface) -> MeshQuality:
    """All checks of a surface."""
    count = edges_of(surface.triangles).uses
    bad_edges, bad_vertices = non_manifold(surface)
    manifold = bad_edges == 0 and bad_vertices == 0
    watertight = len(count) > 0 and bool((count == 2).all()) and bad_edges == 0
    volume = None
    if watertight:
        a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
        volume = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
    return MeshQuality(
        vertices=len(surface.vertices),
        triangles=len(surface.triangles),
        watertight=watertight,
        manifold=manifold,
        self_intersections=int(crossing(surface).sum()),
        degenerate=int(degenerate(surface).sum()),
        components=components(surface.triangles)[0],
        volume_m3=volume,
    )


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
