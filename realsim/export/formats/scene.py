"""A scene read back from its folder, as plain geometry."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError
from realsim.core.files import check_size
from realsim.core.meshes import across, height_field, merged, mesh_of, used
from realsim.core.mjcf import check_mjcf
from realsim.core.types import F64
from realsim.export.contact.polytope import SIGNS

T = TypeVar("T")

DRAWN_OFF = 0.05  # of the scene's length: simplifying to 80,000 triangles moves the ends by millimetres
FLOOR_REACH = 10.0  # metres of floor around a scene in formats that know no infinite plane


@dataclass(frozen=True)
class Box:
    """An oriented box, simulation frame."""

    name: str
    position: F64
    """(3,) centre, metres."""
    rotation: F64
    """(3, 3)."""
    half: F64
    """(3,) half sizes, metres."""

    @property
    def corners(self) -> F64:
        """(8, 3) metres."""
        return self.position + SIGNS * self.half @ self.rotation.T


@dataclass(frozen=True)
class Convex:
    """The hull of corners, or (closed) faces that a height field became."""

    name: str
    vertices: F64
    """(V, 3) simulation frame."""
    triangles: NDArray[np.int32]
    """(K, 3) counter-clockwise seen from outside."""


@dataclass(frozen=True)
class SceneOnDisk:
    """Content of a scene folder. Collision geometry is that of the compiled scene.xml."""

    folder: Path
    vertices: F64
    """(V, 3) of mesh.ply."""
    triangles: NDArray[np.int32]
    colors: NDArray[np.uint8] | None
    boxes: tuple[Box, ...]
    convex: tuple[Convex, ...]
    surfaces: tuple[Convex, ...]
    """Height fields as triangles; open, not convex."""
    floor_z: float | None
    """Height of the infinite floor, None where the floor is among the boxes."""
    sites: dict[str, tuple[F64, F64]]
    """Platforms: name -> (centre, half sizes)."""

    @cached_property
    def bounds(self) -> F64:
        """(2, 3) corners of the mesh."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    def floor_box(self, reach: float = FLOOR_REACH) -> Box | None:
        """The infinite floor as a box of 2 m depth that goes `reach` metres beyond the mesh."""
        if self.floor_z is None:
            return None
        half = (self.bounds[1, :2] - self.bounds[0, :2]) / 2 + reach
        middle = self.bounds.mean(0)
        return Box("floor", np.array([*middle[:2], self.floor_z - 1.0]), np.eye(3), np.array([*half, 1.0]))

    def all_boxes(self) -> tuple[Box, ...]:
        """The boxes, with the floor as one of them."""
        floor = self.floor_box()
        return self.boxes if floor is None else (floor, *self.boxes)


def compile_scene(folder: Path, load: Callable[[str], T]) -> T:
    """What MuJoCo makes of a folder's scene.xml, by `MjModel.from_xml_path` or `MjSpec.from_file`.

    Raises:
        ExportError: scene.xml or mesh.ply is missing, no plain file or XML, or MuJoCo refuses the scene.
    """
    for name in ("scene.xml", "mesh.ply"):
        if not (folder / name).is_file():
            raise ExportError("not a scene folder", file=folder, expected="scene.xml and mesh.ply", found=f"no {name}")
        check_size(folder / name)
    for path in sorted(folder.iterdir()):  # MuJoCo would wait for ever at a pipe in place of a file that it reads
        if not path.is_dir() and not path.is_file():
            raise ExportError("not a plain file", file=path, expected="a scene folder as realsim wrote it")
    check_mjcf(folder / "scene.xml", folder, ExportError)
    try:
        return load(str(folder / "scene.xml"))
    except ValueError as error:
        raise ExportError("the scene does not compile", file=folder / "scene.xml", found=str(error)) from error


def load_scene(folder: Path) -> SceneOnDisk:
    """Read scene.xml (through MuJoCo) and mesh.ply of a folder.

    Raises:
        ExportError: one of them is missing or broken.
    """
    import mujoco
    import trimesh

    model = compile_scene(folder, mujoco.MjModel.from_xml_path)
    try:
        mesh: Any = trimesh.load(folder / "mesh.ply", process=False, force="mesh")
    except Exception as error:  # readers of broken files raise whatever comes up
        raise ExportError("the mesh cannot be read", file=folder / "mesh.ply", found=str(error)) from error
    colors = mesh.visual.vertex_colors[:, :3] if mesh.visual.kind == "vertex" else None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    boxes, convex, surfaces, floor = _collision(model, data)
    world = np.flatnonzero(model.site_bodyid == 0)
    sites = {model.site(i).name: (data.site_xpos[i].copy(), model.site_size[i].copy()) for i in world}
    vertices, triangles = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
    _check_drawn(folder, model, data, used(vertices, triangles))
    return SceneOnDisk(folder, vertices, triangles, colors, boxes, convex, surfaces, floor, sites)


def _check_drawn(folder: Path, model: Any, data: Any, vertices: F64) -> None:
    """Refuse a drawn mesh that does not reach as far as mesh.ply, of which it is a simplified copy: a text file that
    was cut off still compiles."""
    import mujoco

    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "visual")
    if geom < 0 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH or not len(vertices):
        return
    points, faces = mesh_of(model, model.geom_dataid[geom])
    points = points[np.unique(faces)] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    off = np.abs(np.stack([points.min(0) - vertices.min(0), points.max(0) - vertices.max(0)])).max()
    if not off <= DRAWN_OFF * float(np.ptp(vertices, 0).max()):
        raise ExportError(
            "the mesh that is drawn is not that of the scene: it is cut off, or of another scene",
            file=folder / "visual.obj",
            expected=f"a mesh as large as mesh.ply ({' x '.join(f'{v:.2f}' for v in np.ptp(vertices, 0))} m)",
            found=" x ".join(f"{v:.2f}" for v in np.ptp(points, 0)) + " m",
            hint="make the scene again",
        )


def _collision(model: Any, data: Any) -> tuple[tuple[Box, ...], tuple[Convex, ...], tuple[Convex, ...], float | None]:
    """The world's colliding geoms; a robot's belong to other bodies."""
    from mujoco import mjtGeom

    boxes, convex, surfaces = [], [], []
    floor = None
    for g in range(model.ngeom):
        if model.geom_bodyid[g] != 0 or not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        name, kind = model.geom(g).name, mjtGeom(int(model.geom_type[g]))
        position, rotation = data.geom_xpos[g].copy(), data.geom_xmat[g].reshape(3, 3).copy()
        if kind == mjtGeom.mjGEOM_PLANE:
            floor = float(position[2])
        elif kind == mjtGeom.mjGEOM_BOX:
            boxes.append(Box(name, position, rotation, model.geom_size[g].copy()))
        elif kind == mjtGeom.mjGEOM_HFIELD:
            points, faces = height_field(model, model.geom_dataid[g])
            surfaces.append(Convex(name, points + position, faces))
        elif kind in (mjtGeom.mjGEOM_MESH, mjtGeom.mjGEOM_SDF):
            points, faces = mesh_of(model, model.geom_dataid[g])
            points = points @ rotation.T + position
            if kind == mjtGeom.mjGEOM_MESH:
                convex.append(_hull(name, points))
            else:  # it collides as what it is, hollows too
                surfaces.append(Convex(name, points, faces))
        elif (corners := primitive_corners(kind, model.geom_size[g])) is not None:
            convex.append(_hull(name, corners @ rotation.T + position))
        else:
            raise ExportError(
                "a geom of a kind that other formats do not have",
                found=f"{name or g}: {kind.name}",
                hint="reconstruct with another --contact",
            )
    return tuple(boxes), tuple(convex), tuple(surfaces), floor


def collision_triangles(model: Any, data: Any) -> tuple[F64, NDArray[np.int32]]:
    """(V, 3) and (K, 3) of all that the world collides as; an infinite floor is 100 m wide.

    Raises:
        ExportError: a geom of a kind that has no triangles.
    """
    boxes, convex, surfaces, floor = _collision(model, data)
    if floor is not None:
        boxes = (Box("floor", np.array([0.0, 0.0, floor - 1.0]), np.eye(3), np.array([50.0, 50.0, 1.0])), *boxes)
    parts = [*(_hull(box.name, box.corners) for box in boxes), *convex, *surfaces]
    vertices, triangles = merged([(part.vertices, part.triangles) for part in parts])
    return vertices, triangles.astype(np.int32)


def height_nodes(vertices: F64, depth: float) -> tuple[F64, list[float], list[float]]:
    """Of the nodes (V, 3) of a height field: (rows, columns) metres above the lowest, from the lowest y up; its size as
    MuJoCo counts it, with a base of `depth` metres; and where it stands."""
    low, high = vertices.min(0), vertices.max(0)
    columns = int(np.flatnonzero(np.diff(vertices[:, 1]) > 1e-9)[0]) + 1
    size = [*((high - low)[:2] / 2), max(high[2] - low[2], 1e-6), depth]
    return (vertices[:, 2] - low[2]).reshape(-1, columns), size, [*((low + high)[:2] / 2), low[2]]


def primitive_corners(kind: Any, size: F64) -> F64 | None:
    """(M, 3) corners of a primitive, an `mjtGeom`, in its own frame, round ones to a thousandth, or None."""
    a, b, _ = size
    turn = np.arange(72) * np.pi / 36
    circle = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    rise = np.radians(np.arange(-85, 90, 5))[:, None, None]
    ball = (np.cos(rise) * circle + np.sin(rise) * [0, 0, 1]).reshape(-1, 3)
    ends = np.array([[0, 0, -b], [0, 0, b]])
    made = {
        "box": SIGNS * size,
        "sphere": a * ball,
        "ellipsoid": size * ball,
        "cylinder": (a * circle + ends[:, None]).reshape(-1, 3),
        "capsule": (a * ball + ends[:, None]).reshape(-1, 3),
    }
    return made.get(kind.name.removeprefix("mjGEOM_").lower())


def _hull(name: str, points: F64) -> Convex:
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points, qhull_options="QJ")
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used], faces.reshape(-1, 3)
    inward = (across(vertices, faces) * (vertices[faces].mean(1) - vertices.mean(0))).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Convex(name, vertices, faces.astype(np.int32))
