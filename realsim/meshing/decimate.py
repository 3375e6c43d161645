"""Fewer triangles within an error bound that is measured, not assumed."""

from dataclasses import dataclass

import numpy as np

from realsim.meshing.clean import tidy
from realsim.meshing.surface import Surface

MAX_SAMPLES = 100_000


@dataclass(frozen=True)
class Decimated:
    """A decimated surface and how far it lies from what it was made of."""

    surface: Surface
    error: float
    """Metres, the largest sampled distance, both ways."""
    within: bool
    """Whether the wanted number of triangles could be had within the bound."""


def decimate(surface: Surface, max_triangles: int, max_error: float, seed: int = 0) -> Decimated:
    """At most `max_triangles` by quadric edge collapse (Garland and Heckbert 1997), borders kept.

    The distance is sampled both ways. Where it exceeds `max_error` metres, fewer triangles are taken away: the bound
    goes before the count.
    """
    k = len(surface.triangles)
    if k <= max_triangles:
        return Decimated(surface, 0.0, True)
    target = max_triangles
    while target < 0.95 * k:
        smaller = tidy(_collapse(surface, target))
        error = hausdorff(surface, smaller, seed)
        if error <= max_error:
            return Decimated(smaller, error, target == max_triangles)
        target = 2 * target
    return Decimated(surface, 0.0, False)


def hausdorff(a: Surface, b: Surface, seed: int = 0) -> float:
    """Largest distance (metres) of sampled points and of all vertices of each surface from the other."""
    samples = min(MAX_SAMPLES, max(len(a.triangles), len(b.triangles)))
    one = b.distance(np.concatenate([a.vertices, a.sample(samples, seed)])).max()
    other = a.distance(np.concatenate([b.vertices, b.sample(samples, seed)])).max()
    return float(max(one, other))


def _collapse(surface: Surface, target: int) -> Surface:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.triangles))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=target,
        qualitythr=0.3,
        preserveboundary=True,
        boundaryweight=2.0,
        preservenormal=True,
        preservetopology=True,
        planarquadric=True,
        planarweight=0.001,
    )
    mesh = meshes.current_mesh()
    return Surface(mesh.vertex_matrix().copy(), mesh.face_matrix().astype(np.int32))
