"""Repairs that change no shape: weld, orient, order; and removal of what is no surface."""

import numpy as np

from realsim.core.meshes import edges_of
from realsim.core.types import Bool
from realsim.meshing.quality import corner_fans, crossing, degenerate, passes
from realsim.meshing.surface import Surface, first_of_each


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
    for _ in range(5):
        surface = surface.where(~degenerate(surface))
        first = first_of_each(np.sort(surface.triangles, axis=1).astype(np.int64))
        keep = np.zeros(len(surface.triangles), bool)
        keep[first] = True
        surface = surface.where(keep)
        bad = _on_bad_edge(surface)
        if not bad.any():
            break
        surface = surface.where(~bad)
    return canonical(_split_fans(surface))


def _on_bad_edge(surface: Surface) -> Bool:
    """(K,) triangles to remove at bad edges.

    Where more than two share an edge, all but the two largest: fins are small beside the sheets they stand on. Where
    two pass it in the same direction, both: one of them is the wrong way round and neither says which.
    """
    edges = edges_of(surface.triangles)
    count, of_half = edges.uses, edges.of_side
    bad = np.zeros(len(surface.triangles), bool)
    if len(count) == 0:
        return bad
    half = np.flatnonzero(count[of_half] > 2)
    order = half[np.lexsort((-surface.areas()[half // 3], of_half[half]))]
    rank = np.arange(len(order)) - np.searchsorted(of_half[order], of_half[order])
    bad[order[rank >= 2] // 3] = True
    passed = passes(surface.triangles, of_half, len(count))
    clash = (count == 2) & (passed != 1)
    bad[np.flatnonzero(clash[of_half]) // 3] = True
    return bad


def uncrossed(surface: Surface, at_most: float = 0.001) -> Surface:
    """Without triangles that cut others, if they are few (a share of `at_most`); else as it is, for the report."""
    for _ in range(3):
        cut = crossing(surface)
        if not cut.any() or cut.mean() > at_most:
            break
        surface = tidy(surface.where(~cut))
    return surface


def _split_fans(surface: Surface) -> Surface:
    """A vertex where two sheets merely touch becomes one vertex per sheet."""
    if len(surface.triangles) == 0:
        return surface
    fan = corner_fans(surface.triangles)
    old = np.empty(fan.max() + 1, np.int64)
    old[fan] = surface.triangles.ravel()  # all corners of a fan are of one vertex
    colors = None if surface.colors is None else surface.colors[old]
    return Surface(surface.vertices[old], fan.reshape(-1, 3).astype(np.int32), colors)


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
