"""Surfaces and clouds from files: PLY, PCD, LAS/LAZ, OBJ, STL, GLB to plain arrays in the file's own unit."""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.capture.pcdfile import read_columns, read_header, unpack_rgb
from realsim.core.errors import CaptureError, MissingExtraError, RealsimError
from realsim.core.files import check_size, read_bytes, read_head
from realsim.core.geometry import cross
from realsim.core.meshfile import check_packing, plain_stl
from realsim.core.objfile import parse_obj
from realsim.core.types import F64, U8

MAX_VERTICES = 20_000_000
"""More would not fit the pipeline's memory; nothing of a terrain is lost at a point a millimetre apart."""
MAX_SCAN_BYTES = 2 * 2**30


@dataclass(frozen=True)
class RawScan:
    """Content of a file, in its own unit and world."""

    points: F64
    """(M, 3)."""
    triangles: NDArray[np.int32] | None = None
    """(K, 3), None for a cloud."""
    normals: F64 | None = None
    """(M, 3), as written."""
    colors: U8 | None = None
    """(M, 3) RGB."""
    up: tuple[float, float, float] | None = None
    """Against gravity, where the format defines it."""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def read_scan(path: Path) -> RawScan:
    """The content of a scan file, by its suffix; points and triangles as written, unchecked.

    Raises:
        CaptureError: damaged, or more than MAX_VERTICES points.
        MissingExtraError: a package for the format is not installed.
    """
    check_size(path, MAX_SCAN_BYTES)
    try:
        raw = READERS[path.suffix.lower()](path)
    except RealsimError:
        raise
    except Exception as error:  # the parsers of other packages raise whatever damaged files lead them to
        found = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise CaptureError("corrupt or truncated scan", file=path, found=found) from error
    check_count(len(raw.points), path)
    return raw


def check_count(count: int, path: Path) -> None:
    """Refuse more points than can be handled, before reading them if the header gives their number."""
    if count > MAX_VERTICES:
        raise CaptureError(
            "the scan is too large",
            file=path,
            expected=f"at most {MAX_VERTICES} points",
            found=f"{count}",
            hint="crop it to the terrain or thin it out first; a point every few millimetres is enough",
        )


def read_pcd(path: Path) -> RawScan:
    """Points, normals and colours of a PCD file, organised or not; points without a return are left out."""
    header = read_header(path)
    check_count(header.points, path)
    columns = read_columns(path, header)
    points = np.stack([columns[axis] for axis in "xyz"], 1).astype(float)
    normals = _columns(columns, ("normal_x", "normal_y", "normal_z"))
    colors = None if header.color_field is None else unpack_rgb(columns[header.color_field])
    kept = ~np.isnan(points).any(1)
    viewpoint = " ".join(f"{v:g}" for v in header.viewpoint)
    return RawScan(
        points[kept],
        None,
        None if normals is None else normals[kept],
        None if colors is None else colors[kept],
        notes=(f"VIEWPOINT is {viewpoint} and was not applied",),
    )


def read_las(path: Path) -> RawScan:
    """Points and colours of a LAS or LAZ file; its z is up."""
    try:
        import laspy
    except ImportError as error:
        raise MissingExtraError("laspy", "lidar", f"reading {path.suffix} files") from error
    with laspy.open(path) as file:
        check_count(file.header.point_count, path)
        las = file.read()
    colors = None
    if {"red", "green", "blue"} <= set(las.point_format.dimension_names):
        deep = np.stack([np.asarray(las[name]) for name in ("red", "green", "blue")], 1)
        # The format has 16 bits for each colour; some writers use the lower eight only.
        colors = (deep >> 8 if deep.max(initial=0) > 255 else deep).astype(np.uint8)
    points = np.asarray(las.xyz, float)
    notes = ("z is up (LAS)", "coordinates are taken as they are, whatever reference system the file names")
    return RawScan(points, None, None, colors, (0.0, 0.0, 1.0), notes)


def read_ply(path: Path) -> RawScan:
    """A cloud or a mesh."""
    head = read_head(path, 4096)
    count = re.search(rb"element vertex (\d+)", head)
    if not head.startswith(b"ply") or count is None:
        raise CaptureError("not a PLY file", file=path, expected="a header with `element vertex`")
    check_count(int(count[1]), path)
    check_packing(head, path)
    raw = _load(path, read_bytes(path, MAX_SCAN_BYTES))
    declared = re.search(rb"element face (\d+)", head)
    # Readers of the text form take what is there; polygons make more triangles than the header has faces, never fewer.
    found = 0 if raw.triangles is None else len(raw.triangles)
    if len(raw.points) < int(count[1]) or (declared is not None and found < int(declared[1])):
        raise CaptureError(
            "corrupt or truncated scan",
            file=path,
            expected=f"{int(count[1])} vertices and {int(declared[1]) if declared else 0} faces",
            found=f"{len(raw.points)} and {found}",
        )
    return raw


def read_stl(path: Path) -> RawScan:
    """A mesh whose triangles share no vertices in the file: equal ones are joined."""
    data, after = plain_stl(read_bytes(path, MAX_SCAN_BYTES))
    declared = int.from_bytes(data[80:84], "little")
    warnings: tuple[str, ...] = ()
    # Text begins with `solid`, and so do some binary files: the size tells.
    if 84 + 50 * declared == len(data):
        check_count(3 * declared, path)
        warnings = _damaged_normals(np.frombuffer(data, STL_TRIANGLE, declared, 84))
    raw = _load(path, data)
    points, index = np.unique(raw.points, axis=0, return_inverse=True)
    triangles = None if raw.triangles is None else index.ravel()[raw.triangles].astype(np.int32)
    notes = raw.notes + after
    if triangles is not None and (flat := int((triangles == np.roll(triangles, 1, axis=1)).any(axis=1).sum())):
        notes = (*notes, f"{flat} of {len(triangles)} triangles have no area: the file may be damaged there")
    return replace(raw, points=points, triangles=triangles, normals=None, colors=None, notes=notes, warnings=warnings)


STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
NORMAL_OFF = 0.02
"""Of a unit vector: beyond what single precision and rounding explain in a triangle of usual shape. Not tuned."""


def _damaged_normals(table: NDArray) -> tuple[str, ...]:
    """A warning where few of a file's normals contradict their own triangle: a vertex that moved, bits that flipped.

    Files whose normals mean something else (smoothed, all zero) contradict in most triangles, which says nothing.
    """
    normals, V = table["normal"].astype(float), table["vertices"].astype(float)
    across = cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0])
    area = np.linalg.norm(across, axis=1)
    longest = np.linalg.norm(V - np.roll(V, 1, axis=1), axis=2).max(axis=1)
    with np.errstate(invalid="ignore"):
        shaped = area > 1e-3 * longest**2  # of slivers rounding turns the normal
        off = np.linalg.norm(across[shaped] / area[shaped, None] - normals[shaped], axis=1)
    wrong = int((~(off < NORMAL_OFF)).sum())
    if not 0 < wrong < 0.1 * len(off):
        return ()
    return (f"the normals of {wrong} of {len(table)} triangles contradict their vertices: is the file damaged?",)


def read_obj(path: Path) -> RawScan:
    """A mesh or a cloud as text; faces that cannot be read are left out."""
    mesh = parse_obj(read_bytes(path, MAX_SCAN_BYTES))
    if not len(mesh.vertices):
        raise CaptureError("the scan is empty", file=path, expected="points or triangles")
    if mesh.faces and not len(mesh.triangles):
        found = f"{mesh.faces} faces, none of which can be read"
        raise CaptureError(
            "corrupt or truncated scan", file=path, expected="faces of vertices in the file", found=found
        )
    damaged = f"{mesh.bad_faces} of {mesh.faces} faces could not be read: the file is damaged"
    triangles = mesh.triangles if len(mesh.triangles) else None
    return RawScan(mesh.vertices, triangles, None, mesh.colors, warnings=(damaged,) if mesh.bad_faces else ())


def read_glb(path: Path) -> RawScan:
    """All meshes of a glTF file in its world, which has y up and metres."""
    data = read_bytes(path, MAX_SCAN_BYTES)
    check_packing(data, path)
    raw = _load(path, data)
    return replace(raw, up=(0.0, 1.0, 0.0), notes=("y is up (glTF)", *raw.notes))


def _load(path: Path, data: bytes) -> RawScan:
    """Any mesh or cloud through trimesh: from memory, so that it cannot follow names of other files."""
    import trimesh

    suffix = path.suffix.lower()
    # Of a PLY that names a picture, trimesh would look for it and log a traceback.
    scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=suffix == ".ply")
    parts = []
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        part = _part(scene.geometry[name], np.asarray(T, float))
        if part is not None:
            parts.append(part)
    if not parts:
        raise CaptureError("the scan is empty", file=path, expected="points or triangles")
    return _joined(parts)


def _part(geometry: Any, T: F64) -> RawScan | None:
    """One geometry of a scene at its place; None for lines and empty ones."""
    points = np.asarray(getattr(geometry, "vertices", np.zeros((0, 3))), float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        return None
    A = T[:3, :3]
    placed = points @ A.T + T[:3, 3]
    if getattr(geometry, "faces", None) is None:
        return _cloud_part(geometry, placed, A)
    triangles = np.asarray(geometry.faces, np.int32).reshape(-1, 3)
    # A mirroring transform turns the triangles inside out.
    if np.linalg.det(A) < 0:
        triangles = triangles[:, ::-1].copy()
    textured = geometry.visual.kind == "texture"
    colors = None
    if geometry.visual.kind in ("vertex", "face"):
        colors = np.asarray(geometry.visual.vertex_colors, np.uint8)[:, :3]
    notes = ("textures are not read",) if textured else ()
    return RawScan(placed, triangles, None, colors, notes=notes)


def _cloud_part(geometry: Any, points: F64, A: F64) -> RawScan:
    raw = geometry.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    normals = None if raw is None else _columns(raw, ("nx", "ny", "nz"))
    colors = getattr(geometry, "colors", None)
    good = colors is not None and np.ndim(colors) == 2 and len(colors) == len(points)
    return RawScan(
        points,
        None,
        None if normals is None or len(normals) != len(points) else normals @ A.T,
        np.asarray(colors, np.uint8)[:, :3] if good else None,
    )


def _joined(parts: list[RawScan]) -> RawScan:
    """Several parts as one. Clouds beside meshes are left out; colours are kept where all parts have them."""
    notes: dict[str, None] = {}
    meshes = [p for p in parts if p.triangles is not None and len(p.triangles)]
    if meshes and len(meshes) < len(parts):
        notes["only the triangles are used: loose points beside them are left out"] = None
    parts = meshes or parts
    notes |= {note: None for p in parts for note in p.notes}
    if len(parts) == 1:
        return replace(parts[0], triangles=parts[0].triangles if meshes else None, notes=tuple(notes))
    offsets = np.cumsum([0, *(len(p.points) for p in parts[:-1])])
    colored = all(p.colors is not None for p in parts)
    triangles = [p.triangles + o for p, o in zip(parts, offsets, strict=True) if p.triangles is not None]
    return RawScan(
        np.concatenate([p.points for p in parts]),
        np.concatenate(triangles).astype(np.int32) if meshes else None,
        None,
        np.concatenate([p.colors for p in parts if p.colors is not None]) if colored else None,
        notes=(*notes, f"{len(parts)} meshes in the file are taken as one"),
    )


def _columns(table: Any, names: tuple[str, ...]) -> F64 | None:
    """(M, len(names)) of named columns, or None where one is absent."""
    present = getattr(getattr(table, "dtype", None), "names", None) or (table if isinstance(table, dict) else ())
    if not all(name in present for name in names):
        return None
    return np.stack([np.asarray(table[name], float).ravel() for name in names], 1)


READERS: dict[str, Callable[[Path], RawScan]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".las": read_las,
    ".laz": read_las,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
}
