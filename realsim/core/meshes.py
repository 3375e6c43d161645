"""Small operations on triangle meshes that several packages share."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from realsim.core.geometry import cross

AT_ONCE = 500_000
"""Triangles that are looked at at a time, for memory; the result does not depend on it."""


def across(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.float64]:
    """(K, 3) cross products of two sides of each triangle: along its normal, as long as twice its area."""
    out = np.empty((len(triangles), 3))
    for k in range(0, len(triangles), AT_ONCE):
        a, b, c = (vertices[corner] for corner in triangles[k : k + AT_ONCE].T)
        out[k : k + AT_ONCE] = cross(b - a, c - a)
    return out


def sound(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.bool_]:
    """(K,) triangles whose corners are vertices, and finite."""
    there = np.asarray(((triangles >= 0) & (triangles < len(vertices))).all(1), bool)
    there[there] &= np.isfinite(vertices).all(1)[triangles[there]].all(1)
    return there


def used(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[Any]:
    """(U, 3) those of the vertices (V, 3) that triangles name, in their order; names of none do not count."""
    named = np.zeros(len(vertices), bool)
    named[triangles[(triangles >= 0) & (triangles < len(vertices))]] = True
    return vertices[named]


def areas(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.float64]:
    """(K,) areas of triangles (K, 3)."""
    return np.asarray(np.linalg.norm(across(vertices, triangles), axis=1) / 2)


def vertex_normals(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.float64]:
    """(V, 3) unit normals, mean of the adjoining triangles weighted by area; +z where a vertex has none."""
    face, normals = across(vertices, triangles), np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-20, normals / np.maximum(length, 1e-20), [0.0, 0.0, 1.0])


def runs(first: NDArray[Any], count: NDArray[Any]) -> NDArray[np.int64]:
    """(sum of count,) indices of runs, one after the other: where each begins, and how many it has."""
    ends = np.cumsum(count, dtype=np.int64)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(first + count - ends, count)


def sampled(
    vertices: NDArray[Any], triangles: NDArray[Any], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(points (count, 3), their triangles (count,)): spread evenly over a surface, in the order of the triangles.

    Stratified along the cumulative area: each triangle gets its share to within one point.
    """
    area = areas(vertices, triangles)
    steps = (np.arange(count) + rng.random(count)) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), steps), len(area) - 1)
    u = rng.random((2, count, 1))
    u = np.where(u.sum(0) > 1, 1 - u, u)
    a, b, c = (vertices[triangles[face, k]] for k in range(3))
    return a + u[0] * (b - a) + u[1] * (c - a), face


def merged(
    parts: Sequence[tuple[NDArray[Any], NDArray[Any]]],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Several meshes, each (V, 3) and (K, 3), as one."""
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    offsets = np.cumsum([0, *(len(V) for V, _ in parts)])
    return np.vstack([V for V, _ in parts]), np.vstack([F + o for (_, F), o in zip(parts, offsets[:-1], strict=True)])


def mesh_of(model: Any, mesh: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """(V, 3) and (K, 3) of a mesh of a `MjModel`, in its own frame."""
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    first, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    points = model.mesh_vert[start : start + count].astype(float)
    return points, model.mesh_face[first : first + faces].astype(np.int32)


def height_field(model: Any, field: int, apart: int = 1) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """(V, 3) and (K, 3) of a height field of a `MjModel` about its geom's place: every cell is cut, as MuJoCo does it,
    from its lower left to its upper right corner.

    Args:
        apart: nodes from one that is taken to the next; the last of a row or column is one.
    """
    shape = model.hfield_nrow[field], model.hfield_ncol[field]
    start, (rx, ry, elevation, _) = model.hfield_adr[field], model.hfield_size[field]
    z = model.hfield_data[start : start + shape[0] * shape[1]].reshape(shape).astype(float) * elevation
    row, column = (np.unique([*range(0, n, apart), n - 1]) for n in shape)
    x, y = np.meshgrid(np.linspace(-rx, rx, shape[1])[column], np.linspace(-ry, ry, shape[0])[row])
    a = (np.arange(len(row) - 1)[:, None] * len(column) + np.arange(len(column) - 1)).ravel()
    b, c, d = a + 1, a + len(column), a + len(column) + 1
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    return np.column_stack([x.ravel(), y.ravel(), z[np.ix_(row, column)].ravel()]), faces.astype(np.int32)


def faces_by_place(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.int32]:
    """(K, 3) triangles over vertices of which there is one a place (0.1 micrometres): files that list the corners of
    every triangle (STL) have one a corner."""
    places = np.round(vertices, 7)
    order = np.lexsort(places.T[::-1])  # many times faster than `np.unique` over rows
    merged = np.zeros(len(places), np.int32)
    merged[order[1:]] = np.cumsum((np.diff(places[order], axis=0) != 0).any(1))
    return merged[triangles]


def connected(faces: NDArray[Any]) -> NDArray[np.int64]:
    """(K,) number of the piece that each triangle (K, 3) belongs to, by shared corners."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    return linked(ends[:, 0], ends[:, 1], int(faces.max(initial=-1)) + 1)[faces[:, 0]]


def linked(one: ArrayLike, other: ArrayLike, count: int) -> NDArray[np.int64]:
    """(count,) number of the component of each node of a graph with edges from `one` to `other`, (E,) each."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.asarray(one, np.int32), np.asarray(other, np.int32)
    graph = coo_matrix((np.ones(len(ends[0]), bool), ends), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def near_pieces(points: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
    """(M,) number of the piece of each point (M, D): those within `reach` of each other are one."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    return linked(pairs[:, 0], pairs[:, 1], len(points))


def groups(label: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Indices at which each number stands, in the order of the numbers."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(label) else []


def members(label: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Nodes of each component, the largest first; of equally large ones the one with the lowest node."""
    return sorted(groups(label), key=lambda p: (-len(p), p[0]))


CACHED = 2048
"""Sums that are made at once: with their rows they fit a processor's cache; the result does not depend on it."""


def sum_by_key(keys: NDArray[np.int64], rows: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Keys (M,) in order, each once, and the sums of their rows (M, C), in a fixed order of summation."""
    if not len(keys):
        return keys, rows
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    ends, sums = np.append(first, len(keys)), np.empty((len(first), rows.shape[1]))
    for k in range(0, len(first), CACHED):  # all of the sorted rows at once would go through memory twice
        part = ends[k : k + CACHED + 1]
        np.add.reduceat(rows[order[part[0] : part[-1]]], part[:-1] - part[0], axis=0, out=sums[k : k + CACHED])
    return keys[first], sums


@dataclass(frozen=True)
class Edges:
    """Sides of triangles, by the edge that they lie on."""

    runs: NDArray[Any]
    """(3K, 2) from and to of every side; side s belongs to triangle s // 3."""
    order: NDArray[np.int64]
    """(3K,) sides in order of their edge."""
    first: NDArray[np.int64]
    """(E,) place in `order` of the first side of each edge."""
    uses: NDArray[np.int64]
    """(E,) how many sides each edge has."""

    @property
    def of_side(self) -> NDArray[np.int64]:
        """(3K,) the edge of each side."""
        return np.repeat(np.arange(len(self.uses)), self.uses)[np.argsort(self.order)]


def edges_of(triangles: NDArray[Any]) -> Edges:
    """The edges of triangles (K, 3), in the order of their lower and then their higher vertex; side s leads from the
    corner s % 3 of its triangle to the next."""
    runs = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    one, other = runs.T
    key = np.minimum(one, other).astype(np.int64) * (int(runs.max(initial=0)) + 1) + np.maximum(one, other)
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    return Edges(runs, order, first, np.diff(np.r_[first, len(order)]))


LOOSE = 0.05
"""Share of vertices without a triangle from which a warning is due. Sound meshes have next to none; a text file lists
all of its vertices before the triangles, so that one that lost its last tenth has more."""


def compact(
    vertices: ArrayLike, triangles: ArrayLike, *per_vertex: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.int32], *tuple[Any, ...]]:
    """Only the vertices that triangles use: (vertices, triangles, *per_vertex) with new indices, order kept."""
    V, F = np.asarray(vertices), np.asarray(triangles)
    used = np.zeros(len(V), bool)
    used[F] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return (V[used], number[F], *(None if a is None else np.asarray(a)[used] for a in per_vertex))


def loose_vertices(count: int, triangles: NDArray[Any]) -> str | None:
    """A sentence where many vertices belong to no triangle; None where few do.

    Only those at the end of the list tell of a file that ends early: faces are written in about the order of their
    vertices, and programs that leave a part of their vertices unused leave them anywhere.

    Args:
        count: vertices that were read. triangles: (K, 3).
    """
    unused = 1 - len(np.unique(triangles)) / max(count, 1)
    if unused <= LOOSE:
        return None
    text = f"{unused:.0%} of the vertices belong to no triangle"
    missing_end = int(np.max(triangles, initial=-1)) < (1 - LOOSE) * count
    return f"{text}: is the file cut off?" if missing_end else f"{text} and are not used"


FAR = 1000.0
"""Metres from the origin (maps are millions): single precision is coarser than a twentieth of a millimetre there."""


def local_origin(points: NDArray[Any]) -> NDArray[np.float64]:
    """(3,) whole metres to take from points (M, 3) that lie FAR from the origin; zeros where none do.

    MuJoCo, Open3D and glTF keep coordinates in single precision, which is half a metre at five million metres.
    """
    finite = points[np.isfinite(points).all(1)]
    if not len(finite) or np.abs(finite).max() <= FAR:
        return np.zeros(3)
    # A few points far from the rest are stray, and no reason to move it; nor are large numbers about the origin, which
    # are of another unit.
    low, high = np.percentile(finite, [0.5, 99.5], axis=0)
    away = float(np.maximum(low, -high).max())
    return np.floor(low) if away > max(FAR, float((high - low).max())) else np.zeros(3)


def origin_note(origin: NDArray[Any]) -> str:
    """The sentence for what was moved by `local_origin`."""
    x, y, z = origin
    return f"moved to a local origin: add ({x:.0f}, {y:.0f}, {z:.0f}) m for the file's own coordinates"


COARSE = 0.002
"""Metres between neighbouring coordinates from which edges are lost."""
BINARY = (".stl", ".ply", ".glb", ".pcd")
"""Formats that may hold numbers in single precision; in the others they are written as text or as integers."""


def lost_precision(path: Path, points: NDArray[Any], scale: float = 1.0) -> str | None:
    """A sentence where points (M, 3) were stored in single precision so far from the origin that edges are lost; None
    where they were not. `scale` metres are one unit of them."""
    finite = points[np.isfinite(points).all(1)]
    if path.suffix.lower() not in BINARY or not len(finite):
        return None
    single = finite.astype(np.float32)
    largest = np.abs(np.percentile(single, [0.5, 99.5], axis=0)).max()
    step = float(np.spacing(np.float32(largest))) * scale
    if step <= COARSE or not (single == finite).all():
        return None
    return f"coordinates in steps of {step:.2g} m: single precision, far from the origin"


def lonely_vertex(points: NDArray[Any]) -> str | None:
    """A sentence where one vertex of (V, 3), of a mesh or a cloud, makes it more than twice as long as without it."""
    if len(points) < 8:
        return None
    low, high = (np.sort(np.partition(points, ends, axis=0)[ends], axis=0) for ends in ([0, 1], [-2, -1]))
    first, last = points.argmin(axis=0), points.argmax(axis=0)
    size = float((high[1] - low[0]).max())
    for k in {*first.tolist(), *last.tolist()}:
        without = np.where(last == k, high[0], high[1]) - np.where(first == k, low[1], low[0])
        if size > 2 * float(without.max()):
            place = ", ".join(f"{v:.4g}" for v in points[k])
            return f"a single vertex at {place} makes it {size / float(without.max()):.1f} times as long: damaged?"
    return None


def simplify(
    vertices: ArrayLike, triangles: ArrayLike, colors: ArrayLike | None, limit: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8] | None]:
    """A mesh of at most about `limit` triangles to look at (quadric decimation; Garland and Heckbert 1997).

    Its error has no bound: never for collisions or for what is measured.

    Args:
        vertices: (V, 3); triangles: (K, 3); colors: (V, 3) uint8 or None.
    """
    V, F = np.asarray(vertices, float), np.asarray(triangles, np.int32)
    if len(F) <= limit:
        return V, F, None if colors is None else np.asarray(colors, np.uint8)
    import fast_simplification
    from scipy.spatial import cKDTree

    # Open3D's decimation takes minutes where many triangles lie in one plane (a floor); this one does not.
    points, faces = fast_simplification.simplify(V.astype(np.float32), F, target_count=limit)
    points = np.asarray(points, float)
    rgb = None if colors is None else np.asarray(colors, np.uint8)[cKDTree(V).query(points, workers=-1)[1]]
    return points, np.asarray(faces, np.int32), rgb


def ply_bytes(vertices: NDArray[np.float64], triangles: NDArray[Any], colors: NDArray[np.uint8] | None = None) -> bytes:
    """A triangle mesh as PLY: (V, 3) metres as float32, (K, 3) indices, (V, 3) RGB; simulation frame, z up."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    fields: list[tuple[str, str, tuple[int, ...]]] = [("xyz", "<f4", (3,))]
    if colors is not None:
        header += [f"property uchar {c}" for c in ("red", "green", "blue")]
        fields.append(("rgb", "u1", (3,)))
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.zeros(len(vertices), fields)
    rows["xyz"] = vertices
    if colors is not None:
        rows["rgb"] = colors
    faces = np.zeros(len(triangles), [("n", "u1"), ("v", "<i4", (3,))])
    faces["n"], faces["v"] = 3, triangles
    return "\n".join(header).encode("ascii") + rows.tobytes() + faces.tobytes()
