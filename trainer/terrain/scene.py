"""A reconstructed scene as a terrain: the folder that `realsim reconstruct` writes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.files import read_json
from realsim.core.mjcf import check_mjcf
from trainer.errors import TrainerError
from trainer.terrain.base import Platform, Terrain

_PLATFORM_M = (0.25, 4.0)
"""Edge lengths between which a platform is believable; beyond, the scene's scale is wrong."""
_SHORTEST_M = 0.1
"""From start to goal."""
_MARGIN_M = 0.1
"""How far a platform's centre may lie outside the mesh's box: the one is fitted, the other as scanned."""
_GROUND_NOISE = 0.03
"""Metres: parts no higher than this are the scanned ground; a foot on them stands on the ground."""


def load(folder: str | Path) -> Terrain:
    """The scene in `folder`: contact geometry from `scene.xml`, rays from `mesh.ply`, platforms from `report.json`.

    Raises:
        TrainerError: a file is missing or cut off, the scene has no platforms, or its scale cannot be right.
    """
    folder = Path(folder)
    report = _report(folder)
    start, goal = (_platform(folder, report, role) for role in ("start", "goal"))
    length = float(np.linalg.norm(goal.centre[:2] - start.centre[:2]))
    if length < _SHORTEST_M:
        raise TrainerError(
            "start and goal are the same place",
            file=folder / "report.json",
            expected=f"at least {_SHORTEST_M} m from centre to centre",
            found=f"{length:.3f} m",
            hint="name them: realsim reconstruct --start X Y --goal X Y",
        )
    vertices, triangles = _mesh(folder, start, goal)
    floor = float(_numbers(folder, report.get("ground_z"), "ground_z", 1)[0])
    if not 0.0 <= -floor <= 2.0:
        raise TrainerError(
            "the ground is not at a height that a course can have",
            file=folder / "report.json",
            expected="the ground 0 to 2 m below the start platform's top",
            found=f"ground_z = {floor:.3f} m",
            hint="look at the scene with `realsim view`; choose other platforms with --start and --goal",
        )
    return Terrain(
        name=folder.resolve().name,
        boxes=(),
        vertices=vertices,
        triangles=triangles,
        start=start,
        goal=goal,
        floor_z=floor,
        contact=_contact(folder, floor),
        drawn=folder / "visual.obj" if (folder / "visual.obj").is_file() else None,
        family="scene",
        facts={"length": length},
    )


def _report(folder: Path) -> dict[str, Any]:
    path = _file(folder, "report.json")
    try:
        report = read_json(path)
    except RealsimError as error:
        raise TrainerError(
            "report.json cannot be read", file=path, found=error.found, hint="reconstruct again"
        ) from None
    if not isinstance(report, dict):
        raise TrainerError("report.json is no report", file=path, expected="an object", found=type(report).__name__)
    return report


def _numbers(folder: Path, value: Any, what: str, count: int, unit: str = "metres") -> NDArray[np.float64]:
    """The first `count` of the numbers that an entry of the report must hold."""
    try:
        numbers = np.atleast_1d(np.asarray(value, float))
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.ndim != 1 or len(numbers) < count or not np.isfinite(numbers).all():
        raise TrainerError(
            f"{what} is not given",
            file=folder / "report.json",
            expected=f"{count} finite numbers, {unit}",
            found=repr(value),
            hint="reconstruct again",
        )
    return numbers[:count]


def _mesh(folder: Path, start: Platform, goal: Platform) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """((V, 3), (F, 3)) of mesh.ply, in which both platforms must lie: a mesh of another scale is another scene's."""
    import trimesh

    path = _file(folder, "mesh.ply")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OSError) as error:
        raise TrainerError(
            "mesh.ply cannot be read: it is cut off or not a mesh",
            file=path,
            found=str(error),
            hint="reconstruct again",
        ) from None
    if not len(triangles) or not np.isfinite(vertices).all():
        raise TrainerError("mesh.ply holds no surface", file=path, found=f"{len(triangles)} triangles")
    low, high = vertices.min(0) - _MARGIN_M, vertices.max(0) + _MARGIN_M
    for role, platform in (("start", start), ("goal", goal)):
        if not np.all((low <= platform.centre) & (platform.centre <= high)):
            raise TrainerError(
                f"the {role} platform does not lie on the mesh: they are of different scale, frame or scene",
                file=path,
                expected=f"a mesh around {np.round(platform.centre, 2).tolist()} m (report.json)",
                found=f"x, y, z from {np.round(low, 2).tolist()} to {np.round(high, 2).tolist()} m",
                hint="reconstruct again",
            )
    return vertices, triangles


def _file(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        raise TrainerError(
            "this folder is not a reconstructed scene",
            file=folder,
            expected="scene.xml, mesh.ply and report.json as `realsim reconstruct` writes them",
            found=f"no {name}",
        )
    return folder / name


def _platform(folder: Path, report: dict[str, Any], role: str) -> Platform:
    entry = report.get(role)
    if not isinstance(entry, dict) or entry.get("size") is None:
        raise TrainerError(
            f"the scene has no {role} platform",
            file=folder / "report.json",
            expected="a start and a goal platform",
            found=f"{role}: {entry}",
            hint="name them: realsim reconstruct --start X Y --goal X Y",
        )
    size = _numbers(folder, entry["size"], f"the size of the {role} platform", 2)
    low, high = _PLATFORM_M
    if not np.all((low <= size) & (size <= high)):
        raise TrainerError(
            f"the {role} platform's size cannot be right: the scene's scale may be wrong",
            file=folder / "report.json",
            expected=f"edges of {low} to {high} m",
            found=" x ".join(f"{s:.3f}" for s in size) + " m",
            hint="check `scale` in report.json",
        )
    centre = _numbers(folder, entry.get("centroid"), f"the centre of the {role} platform", 3)
    yaw = _numbers(folder, entry.get("yaw", 0.0), f"the yaw of the {role} platform", 1, "radians")
    return Platform(centre, size, float(yaw[0]))


def _contact(folder: Path, floor: float) -> Any:
    """The scene's specification with nothing left but what collides above the ground, which is the engine's own."""
    import mujoco

    path = _file(folder, "scene.xml")
    check_mjcf(path, folder, TrainerError)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        # A robot that was put into the scene to look at is not terrain; its actuators go with its bodies.
        for part in [*spec.keys, *spec.worldbody.bodies]:
            spec.delete(part)
        spec.nkey = 0
        low = _low_geoms(spec, floor + _GROUND_NOISE)
        for geom in list(spec.geoms):
            drawn_only = geom.contype == 0 and geom.conaffinity == 0
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE or drawn_only or geom.name in low:
                spec.delete(geom)
        for unused in [*spec.materials, *spec.textures, *spec.meshes]:
            if not isinstance(unused, mujoco.MjsMesh) or all(g.meshname != unused.name for g in spec.geoms):
                spec.delete(unused)
        spec.compile()
    except ValueError as error:
        raise TrainerError(
            "scene.xml does not compile", file=path, found=str(error), hint="reconstruct again"
        ) from None
    return spec


def _low_geoms(spec: Any, height: float) -> set[str]:
    """Names of the geoms that lie wholly below `height` metres."""
    import mujoco

    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low = set()
    for i in range(model.ngeom):
        centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
        up = data.geom_xmat[i].reshape(3, 3)[2]
        if data.geom_xpos[i, 2] + up @ centre + np.abs(up) @ half < height:
            low.add(model.geom(i).name)
    return low
