"""Any mesh made fit for collision: read, checked and repaired, with a list of the repairs."""

import gc
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError
from realsim.core.files import read_bytes
from realsim.core.meshes import (
    AT_ONCE,
    across,
    areas,
    compact,
    edges_of,
    faces_by_place,
    local_origin,
    lonely_vertex,
    loose_vertices,
    lost_precision,
    origin_note,
    sound,
    used,
)
from realsim.core.meshfile import check_packing, plain_stl
from realsim.core.objfile import parse_obj
from realsim.core.types import F64, MeshQuality, TerrainMesh
from realsim.export.contact.columns import check_extent, crossings
from realsim.export.contact.probe import CEILING
from realsim.export.contact.shape import UPRIGHT
from realsim.export.pieces import convex_solids, without_twins
from realsim.export.unite import united
from realsim.export.up import Up, find_up, y_to_z
from realsim.export.winding import turn_closed, turn_stray

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
UP = ("auto", "z", "y")
FORMATS = (".ply", ".obj", ".stl", ".glb", ".off")
AGAIN = "export it again from the program that made it; realsim inspect FILE shows what is read"
MAX_TRIANGLES = 5_000_000
THIN = 0.1  # width of a sliver seen from above, in lengths; set by hand on made nets of points
RAYS = 96  # a side of the grid of rays that look at a mesh from above
VAST = 50.0  # metres: larger than what a robot is taken across, so that the unit has to be given
TALL = 8.0  # metres, set by hand: furniture in cm or inches; the benchmarks' meshes and rooms are at most 3 m high


@dataclass(frozen=True)
class Mended:
    """A mesh made fit for collision: z up, metres."""

    terrain: TerrainMesh
    notes: tuple[str, ...]
    """One sentence for everything that was assumed or changed, or that limits what can be known."""
    solids: tuple[F64, ...]
    """[(M, 3)] corners of those closed pieces of the mesh that are convex."""
    rest: TerrainMesh | None
    """What is not made of `solids`; None where nothing is left."""


@dataclass(frozen=True)
class MeshFile(Mended):
    """The same of a file, near the origin."""

    origin: F64
    """(3,) metres that were taken from the file's coordinates (z up)."""
    up: Up
    """Which axis of the file points up, and how that was found."""
    question: str | None
    """What to ask the user where the axis or the unit may be another."""


def read_mesh(path: Path, unit: str | None = None, up: str = "auto") -> MeshFile:
    """A mesh file as a terrain, z up, metres, moved to a local origin where it is far from its own.

    Args:
        path: one of FORMATS.
        unit: of the file's numbers, one of UNITS; None for metres that nobody has vouched for: a mesh that is VAST in
            them is refused, because it will be in millimetres.
        up: axis that points up, `z`, `y`, or `auto`: found from the mesh.

    Raises:
        ExportError: not such a file, nothing usable in it, or of a size that no terrain has.
    """
    if unit is not None and unit not in UNITS:
        raise ExportError(f"unknown unit {unit!r}", expected=f"one of {', '.join(UNITS)}")
    if up not in UP:
        raise ExportError(f"unknown axis {up!r}", expected=f"one of {', '.join(UP)}")
    if not path.exists():
        raise ExportError("the mesh is not there", file=path, expected=f"a file: one of {' '.join(FORMATS)}")
    if (suffix := path.suffix.lower()) not in FORMATS:
        hint = "export it as one of these from the program that made it" + "; a .gltf as .glb" * (suffix == ".gltf")
        raise ExportError(
            "not a mesh file", file=path, expected=f"one of {' '.join(FORMATS)}", found=path.suffix, hint=hint
        )
    vertices, triangles, notes = _read(path)
    if len(triangles) > MAX_TRIANGLES:  # before any look at them: that takes minutes
        raise ExportError(
            "too many triangles",
            file=path,
            expected=f"at most {MAX_TRIANGLES}",
            found=str(len(triangles)),
            hint="decimate the mesh, or cut out the part that the robot gets to",
        )
    notes += [note for note in (loose_vertices(len(vertices), triangles), lonely_vertex(vertices)) if note]
    scale = UNITS[unit or "m"]
    if lost := lost_precision(path, vertices, scale):
        hint = "subtract an offset where the mesh is exported"
        expected = "a local origin, or double precision"
        raise ExportError(
            "the coordinates have lost their precision", file=path, expected=expected, found=lost, hint=hint
        )
    try:
        named = used(vertices, triangles)
        named = named if len(named) else vertices
        origin = local_origin(named * scale)
        _check_unit(named, unit, surveyed=bool(origin.any()))
        vertices = vertices * scale
        # Before it is moved: what begins at zero then was made so by a person.
        found = find_up(vertices, triangles, path.suffix.lower()) if up == "auto" else Up(up)
        vertices = vertices - origin
        if found.axis == "y":
            vertices, origin = y_to_z(vertices), y_to_z(origin)
        if origin.any():
            notes.append(origin_note(origin))
        mended = mend(vertices, triangles)
    except ExportError as error:
        raise ExportError(
            error.message, file=path, expected=error.expected, found=error.found, hint=error.hint
        ) from error
    notes = [*found.notes, *notes, *mended.notes]
    questions = [found.question, None if unit or origin.any() else _ask_unit(mended.terrain.vertices)]
    question = " ".join(filter(None, questions)) or None
    return MeshFile(mended.terrain, tuple(notes), mended.solids, mended.rest, origin, found, question)


def _ask_unit(vertices: F64) -> str | None:
    """The question whether the unit of a mesh (V, 3) is metres, where it is too high to be sure."""
    size, (_, _, height) = float(np.ptp(vertices, 0).max()), np.ptp(vertices, 0)
    others = [f"{height * scale:.2g} m (--unit {name})" for name, scale in UNITS.items() if 0.02 < size * scale < size]
    return f"The mesh may be {height:.2g} m high (--unit m), or {' or '.join(others)}." if height > TALL else None


def _check_unit(vertices: F64, unit: str | None, *, surveyed: bool) -> None:
    """Refuse what is of no terrain's size in its unit, and say in which it would be; coordinates of a map (`surveyed`)
    are in metres."""
    finite = vertices[np.isfinite(vertices).all(1)]
    numbers = float(np.ptp(finite, 0).max()) if len(finite) else 0.0
    size, most = numbers * UNITS[unit or "m"], 200.0 if unit or surveyed else VAST
    if numbers == 0 or 0.02 <= size <= most:
        return
    others = {name: numbers * scale for name, scale in UNITS.items() if name != (unit or "m") and not surveyed}
    fits = [f"--unit {name} makes it {across:.3g} m" for name, across in others.items() if 0.02 <= across <= VAST]
    if unit is None and VAST < size <= 200:
        fits.append("--unit m if it is that large")
    raise ExportError(
        "the mesh is not of a terrain's size",
        expected=f"0.02 to {most:g} metres across",
        found=f"{size:.4g} metres, if its unit is {unit or 'm'}",
        hint="; ".join(fits) or "cut out the part that the robot gets to, or remove triangles far from the rest",
    )


def _read(path: Path) -> tuple[F64, NDArray[np.int64], list[str]]:
    """(vertices (V, 3), triangles (K, 3), what could not be read) of a file, in its own unit and frame."""
    import trimesh

    data, suffix = read_bytes(path), path.suffix.lower()
    check_packing(data, path)
    data, notes = plain_stl(data) if suffix == ".stl" else (data, ())
    try:
        if suffix == ".obj":
            mesh = parse_obj(data)
            left_out = [f"{mesh.bad_faces} of {mesh.faces} faces could not be read"] if mesh.bad_faces else []
            return mesh.vertices, mesh.triangles.astype(np.int64), left_out
        loaded: Any = trimesh.load(
            BytesIO(data), file_type=suffix[1:], force="mesh", process=False, skip_materials=True
        )
        vertices, triangles = np.array(loaded.vertices, float), np.array(loaded.faces, np.int64)
        del loaded
        if len(triangles) > AT_ONCE:  # what was read of the file is part of a cycle: half a gigabyte
            gc.collect()
    except Exception as error:  # readers of broken files raise whatever comes up
        found = f"a file that is cut off or damaged ({type(error).__name__}: {error})"
        raise ExportError("the mesh cannot be read", file=path, found=found, hint=AGAIN) from error
    if suffix == ".stl" and not len(triangles):
        raise ExportError("the mesh cannot be read", file=path, found="no triangle: cut off, or no STL", hint=AGAIN)
    return vertices, triangles, [*notes]


def mend(vertices: F64, triangles: NDArray[Any]) -> Mended:
    """Take out what cannot be used, turn inside-out meshes round, and look at the rest.

    Args:
        vertices: (V, 3) metres, z up. triangles: (K, 3).

    Raises:
        ExportError: nothing usable is left.
    """
    notes: list[str] = []
    vertices, faces, flat = _usable(vertices, triangles, notes)
    faces, again = without_twins(vertices, faces)
    if again:
        vertices, faces = compact(vertices, faces)
        notes.append(f"{again} triangles that were there twice were removed")
    faces, turned = turn_stray(vertices, faces)
    if turned:
        notes.append(f"{turned} triangles that faced the other way than their neighbours were flipped")
    quality, open_ = _quality(vertices, faces, flat)

    def made(vertices: F64, faces: NDArray[np.int32]) -> TerrainMesh:
        return TerrainMesh(vertices, faces, None, np.zeros(len(faces), bool), quality, "file", 0.0)

    terrain = made(vertices, faces)
    check_extent(terrain)
    inside_out, crossing = _from_above(terrain)
    if inside_out:
        faces = np.ascontiguousarray(faces[:, ::-1])
        notes.append("the mesh was inside out and has been flipped")
    faces, slivers = _without_slivers(vertices, faces)
    if slivers:
        vertices, faces = compact(vertices, faces)
        quality, open_ = _quality(vertices, faces, flat)
        notes.append(f"{slivers} upright slivers, with which a triangulation of points closes its rim, were removed")
    faces, turned = turn_closed(vertices, faces)
    if inside_out or slivers or turned:
        crossing = _from_above(made(vertices, faces))[1]
    if turned:
        notes.append(f"{turned} closed pieces were inside out and have been flipped")
    solids, others = convex_solids(vertices, faces)
    rest = None
    if others.any():
        left, left_faces = compact(vertices, faces[others])
        rest = made(left, left_faces)
    terrain = made(vertices, faces)
    if crossing:
        vertices, faces, count = united(vertices, faces)
        vertices, faces = compact(vertices, faces)
        quality, open_ = _quality(vertices, faces, flat)
        terrain = made(vertices, faces)
        joined = f"{count} closed pieces were made one" if count else "whatever lies in any of them is solid"
        notes.append(f"solids of the mesh overlap or its surface crosses itself: {joined}")
    if not quality.manifold:
        notes.append("the mesh is not manifold: solids are taken from columns of rays, which need no manifold")
    if open_:
        notes.append("the mesh is open: a surface without an underside is taken to be solid down to the ground")
    return Mended(terrain, tuple(notes), solids, rest if solids else terrain)


def _usable(vertices: F64, triangles: NDArray[Any], notes: list[str]) -> tuple[F64, NDArray[np.int32], int]:
    """(vertices, triangles with corners and an area, how many had none)."""
    if not len(triangles):
        raise ExportError(
            "the mesh has no triangles", hint="mesh a point cloud first: realsim reconstruct CLOUD --out scene"
        )
    whole = sound(vertices, triangles)
    if not whole.all():
        notes.append(f"{(~whole).sum()} triangles with missing or non-finite corners were removed")
    triangles = triangles if whole.all() else triangles[whole]
    if not len(triangles):
        raise ExportError("the mesh has no usable triangles", found="missing or non-finite corners")
    size = float(np.ptp(used(vertices, triangles), 0).max())
    flat = 2 * areas(vertices, triangles) < 1e-12 * max(size, 1e-12) ** 2
    if flat.any():
        notes.append(f"{flat.sum()} triangles without area were removed")
    if flat.all():
        raise ExportError("the mesh has no usable triangles", found=f"{len(flat)} triangles, all without area")
    kept, faces = compact(vertices, triangles[~flat].astype(np.int32))
    if len(kept) == 3:  # MuJoCo draws no mesh of fewer than four vertices
        kept = np.vstack([kept, (kept[faces[0, 0]] + kept[faces[0, 1]]) / 2])
        a, b, c = faces[0]
        faces = np.array([[a, 3, c], [3, b, c]], np.int32)
    return kept, faces, int(flat.sum())


def _without_slivers(vertices: F64, faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """(triangles (K, 3) without the upright ones that close the outline of a triangulation of points seen from above,
    how many those were).

    A triangulation in the plane (Delaunay's) ends in the convex hull of its points, and closes what is not convex with
    triangles that are long and thin seen from above: walls that nobody measured. They lie at the rim with their
    longest side, one behind the other. A step lies in the rim with its short side, and stays.
    """
    kept = faces
    if not (across(vertices, faces)[:, 2] > 0).all():
        return faces, 0
    while len(kept):
        edges = edges_of(faces_by_place(vertices, kept))
        face, corner = np.divmod(edges.order[edges.first[edges.uses == 1]], 3)
        cross = across(vertices, kept[face])
        plan = vertices[kept[face], :2]
        sides = np.linalg.norm(plan - np.roll(plan, -1, axis=1), axis=2)
        along = sides[np.arange(len(face)), corner]
        thin = (along >= sides.max(1)) & (np.abs(cross[:, 2]) < THIN * along**2)
        out = face[thin & (np.abs(cross[:, 2]) < UPRIGHT * np.linalg.norm(cross, axis=1))]
        if not len(out):
            break
        kept = np.delete(kept, out, axis=0)
    return (kept, len(faces) - len(kept)) if len(kept) else (faces, 0)


def _from_above(mesh: TerrainMesh) -> tuple[bool, bool]:
    """(whether most of what is seen from above faces down, whether solids overlap), by a grid of rays. A ceiling over
    a floor is looked through: a room is no solid inside out.

    Raises:
        ExportError: nothing is seen from above.
    """
    lower, upper = mesh.vertices.min(0), mesh.vertices.max(0)
    steps = (np.arange(RAYS) + 0.5) / RAYS
    x, y = np.meshgrid(*(lower[k] + steps * (upper[k] - lower[k]) for k in (0, 1)))
    if len(mesh.triangles) > AT_ONCE:  # few of so many are met, and a caster of all takes a gigabyte
        met = np.ones(len(mesh.triangles), bool)
        for k in (0, 1):
            at = ((mesh.vertices[:, k] - lower[k]) * (RAYS / max(upper[k] - lower[k], 1e-9)) - 0.5)[mesh.triangles]
            met &= np.ceil(at.min(1) - 1e-3) <= at.max(1) + 1e-3
        vertices, triangles = compact(mesh.vertices, mesh.triangles[met])
        mesh = replace(mesh, vertices=vertices, triangles=triangles, invented=mesh.invented[met])
    ray, z, up, _ = crossings(mesh, x.ravel(), y.ravel(), float(upper[2]) + 1)
    if not len(ray):
        raise ExportError("the mesh has no surface to stand on", found="no surface that is seen from above")
    first = np.r_[True, np.diff(ray) != 0]
    at = np.flatnonzero(first)
    below = np.minimum(at + 1, len(ray) - 1)
    room = ~up[at] & up[below] & (ray[below] == ray[at]) & (z[at] - z[below] > CEILING)
    inside_out = bool((up[at] | room).mean() < 0.5)
    # Two ways in, one after the other, and a while until the next crossing: the ray is in two solids at once. (Where a
    # box stands on a floor, one ends where the other begins.)
    into = up != inside_out
    twice = into[:-2] & into[1:-1] & (ray[:-2] == ray[1:-1]) & (ray[1:-1] == ray[2:]) & (z[1:-1] - z[2:] > 1e-3)
    return inside_out, bool(twice.sum() > 0.002 * first.sum())


def _quality(vertices: F64, triangles: NDArray[np.int32], degenerate: int) -> tuple[MeshQuality, bool]:
    """(quality, whether there is a rim). Counts of edges tell open and non-manifold; self-intersections are left
    uncounted (-1), rays do not mind them. Where solids touch, edges belong to four triangles, and none is missing."""
    uses = edges_of(faces_by_place(vertices, triangles)).uses
    closed, manifold = bool((uses == 2).all()), bool((uses <= 2).all())
    quality = MeshQuality(len(vertices), len(triangles), closed, manifold, -1, degenerate, 1, None)
    return quality, bool((uses % 2).any())
