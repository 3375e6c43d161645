"""Wavefront OBJ: all faces of all objects and groups, by absolute or relative indices."""

import codecs
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
STARTS = (b"v ", b"v\t", b"f ", b"f\t")


@dataclass(frozen=True)
class ObjMesh:
    """What an OBJ file draws, in its own unit and frame."""

    vertices: F64
    """(V, 3), those that no face uses too."""
    triangles: NDArray[np.int32]
    """(K, 3); polygons are divided."""
    colors: NDArray[np.uint8] | None
    """(V, 3) RGB where every vertex line carries one."""
    faces: int
    """Face lines of the file."""
    bad_faces: int
    """How many of them were left out: a corner is unreadable or names a vertex that is not there."""


def parse_obj(data: bytes) -> ObjMesh:
    """The geometry of an OBJ file; materials, normals, curves and lines are not read.

    A negative index counts back from the last vertex above its face line (-1), whatever object or group that belongs
    to (Wavefront, Advanced Visualizer, appendix B1: object files).

    Raises:
        ValueError: a vertex line holds no three numbers.
    """
    rows: list[list[bytes]] = []
    corners: list[int] = []
    sizes: list[int] = []
    bad = 0
    for line in _plain(data).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        line = line.lstrip()
        if line[:2] not in STARTS:
            continue
        kind, *words = line.split()
        if kind == b"v":
            rows.append(words)
        else:
            face = _face(words, len(rows))
            if face is None:
                bad += 1
            else:
                corners += face
                sizes.append(len(face))
    vertices, colors = _vertices(rows)
    index = np.array(corners, np.int64)
    faces = len(sizes) + bad
    starts = np.cumsum([0, *sizes[:-1]]) if sizes else np.zeros(0, np.int64)
    size = np.array(sizes, np.int64)
    if len(size):  # absolute indices may point ahead, to vertices that never come
        sound = np.logical_and.reduceat((index >= 0) & (index < len(vertices)), starts)
        bad += int((~sound).sum())
        starts, size = starts[sound], size[sound]
    return ObjMesh(vertices, _triangles(vertices, index, starts, size), colors, faces, bad)


def _plain(data: bytes) -> bytes:
    """Text without the mark that Windows programs put before it, which would hide the first vertex and so shift all."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def _face(words: list[bytes], above: int) -> list[int] | None:
    """Vertices of a face line from 0; None where it is no face."""
    try:
        given = [int(word.split(b"/", 1)[0]) for word in words]
    except ValueError:
        return None
    if len(given) < 3 or 0 in given:
        return None
    return [k - 1 if k > 0 else above + k for k in given]


def _vertices(rows: list[list[bytes]]) -> tuple[F64, NDArray[np.uint8] | None]:
    if not rows:
        return np.zeros((0, 3)), None
    widths = {len(row) for row in rows}
    if min(widths) < 3:
        raise ValueError("a vertex without three coordinates")
    width = 6 if widths == {6} else 3
    table = np.array([row[:width] for row in rows]).astype(np.float64)
    if width == 3:
        return table, None
    scale = 255.0 if table[:, 3:].max() <= 1.0 else 1.0
    return table[:, :3].copy(), np.clip(np.rint(table[:, 3:] * scale), 0, 255).astype(np.uint8)


def _triangles(
    vertices: F64, index: NDArray[np.int64], starts: NDArray[np.int64], size: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Convex faces as fans, others by their outline."""
    out = [np.zeros((0, 3), np.int64)]
    for n in np.unique(size):
        polygons = index[starts[size == n][:, None] + np.arange(n)]
        dented = _dented(vertices[polygons]) if n > 3 else np.zeros(len(polygons), bool)
        k = np.arange(1, n - 1)
        fans = np.stack([np.zeros_like(k), k, k + 1], 1)
        out.append(polygons[~dented][:, fans].reshape(-1, 3))
        out += [polygon[_cut(vertices[polygon])] for polygon in polygons[dented]]
    return np.concatenate(out).astype(np.int32)


def _dented(corners: F64) -> NDArray[np.bool_]:
    """(P,) which of the polygons (P, N, 3) are not convex."""
    after, before = np.roll(corners, -1, 1) - corners, corners - np.roll(corners, 1, 1)
    turns = np.cross(before, after)
    newell = np.cross(corners, np.roll(corners, -1, 1)).sum(1)
    turn = (turns * newell[:, None]).sum(2)
    return np.asarray((turn < -1e-9 * np.abs(turn).max(1, keepdims=True)).any(1))


def _cut(corners: F64) -> NDArray[np.int64]:
    """(N - 2, 3) triangles of a polygon that is not convex, in its own plane."""
    from manifold3d import triangulate

    centred = corners - corners.mean(0)
    normal = np.cross(centred, np.roll(centred, -1, 0)).sum(0)
    normal /= max(float(np.linalg.norm(normal)), 1e-30)
    u = np.linalg.svd(centred - np.outer(centred @ normal, normal), full_matrices=False)[2][0]
    flat = centred @ np.stack([u, np.cross(normal, u)], 1)
    return np.asarray(triangulate([np.ascontiguousarray(flat, np.float32)]), np.int64).reshape(-1, 3)
