"""Repairs that change no shape: weld, orient, order; and removal of what is no surface."""

from __future__ import annotations

import numpy as np

from realsim.meshing.quality import corner_fans, degenerate
from realsim.meshing.surface import Surface, edges_of


def weld(surface: Surface, tolerance: float) -> Surface:
    """Vertices closer than `tolerance` metres (on a grid of that size) become one; the first keeps its place."""
    if len(surface.vertices) == 0:
        return surface
    cells = np.round((surface.vertices - surface.vertices.min(0)) / tolerance).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    colors = None if surface.colors is None else surface.colors[first]
    return Surface(surface.vertices[first], inverse.ravel()[surface.triangles].astype(np.int32), colors)


def tidy(surface: Surface) -> Surface:
    """Manifold, without degenerate or doubled triangles, in canonical order (so that equal input gives equal bytes)."""
    for _ in range(3):
        surface = surface.where(~degenerate(surface))
        _, first = np.unique(np.sort(surface.triangles, axis=1), axis=0, return_index=True)
        keep = np.zeros(len(surface.triangles), bool)
        keep[first] = True
        surface = surface.where(keep)
        bad = _on_bad_edge(surface)
        if not bad.any():
            break
        surface = surface.where(~bad)
    return canonical(_split_fans(surface))


def _on_bad_edge(surface: Surface) -> np.ndarray:
    """(K,) triangles at an edge that more than two share, but for the two largest there."""
    _, count, of_half = edges_of(surface.triangles)
    bad = np.zeros(len(surface.triangles), bool)
    if len(count) == 0 or count.max() <= 2:
        return bad
    area = surface.areas()
    half = np.flatnonzero(count[of_half] > 2)
    # Keep the two largest triangles of an edge: veils and fins are small beside the sheets they stand on.
    order = half[np.lexsort((-area[half // 3], of_half[half]))]
    rank = np.arange(len(order)) - np.searchsorted(of_half[order], of_half[order])
    bad[order[rank >= 2] // 3] = True
    return bad


def _split_fans(surface: Surface) -> Surface:
    """A vertex where two sheets merely touch becomes one vertex a sheet."""
    if len(surface.triangles) == 0:
        return surface
    fan = corner_fans(surface.triangles)
    _, first, number = np.unique(fan, return_index=True, return_inverse=True)
    old = surface.triangles.ravel()[first]
    colors = None if surface.colors is None else surface.colors[old]
    return Surface(surface.vertices[old], number.reshape(-1, 3).astype(np.int32), colors)


def canonical(surface: Surface) -> Surface:
    """The same surface with vertices in order of x, y, z and triangles in order of their vertices."""
    if len(surface.triangles) == 0:
        return surface
    order = np.lexsort(surface.vertices.T[::-1])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    t = number[surface.triangles]
    t = np.take_along_axis(t, (np.argmin(t, 1)[:, None] + np.arange(3)) % 3, axis=1)
    t = t[np.lexsort(t.T[::-1])]
    colors = None if surface.colors is None else surface.colors[order]
    return Surface(surface.vertices[order], t.astype(np.int32), colors)
