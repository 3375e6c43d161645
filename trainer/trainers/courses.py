"""A terrain's contact geometry as geoms of somebody else's `mujoco.MjSpec`."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.geometry import R_to_quat
from trainer.terrain import Terrain

GROUND_HALF_THICKNESS = 0.05


def extent(terrain: Terrain, margin: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """((2,) lowest, (2,) highest) x and y of the course with a margin around it, metres."""
    points = np.concatenate([terrain.start.corners(), terrain.goal.corners(), terrain.vertices[:, :2]])
    return points.min(0) - margin, points.max(0) + margin


def add_course(spec: Any, body: Any, terrain: Terrain, offset: np.ndarray, name: str) -> list[Any]:
    """Add everything that a robot can touch to `body` of `spec`: obstacles, platforms, and the ground as a slab.

    Args:
        spec: gets mesh assets, if the terrain has any.
        body: gets the geoms.
        terrain: boxes, or contact geometry of a reconstructed scene.
        offset: (3,) metres from the body's origin to the terrain's.
        name: prefix of mesh names.

    Returns:
        The geoms.
    """
    import mujoco

    low, high = extent(terrain)
    middle = np.array([*(low + high) / 2, terrain.floor_z - GROUND_HALF_THICKNESS])
    half = np.array([*(high - low) / 2, GROUND_HALF_THICKNESS])
    box = mujoco.mjtGeom.mjGEOM_BOX
    geoms = [body.add_geom(type=box, size=half, pos=middle + offset)]
    for b in terrain.boxes:
        pos, quat = b.T[:3, 3] + offset, R_to_quat(b.T[:3, :3])
        geoms.append(body.add_geom(type=box, size=b.size / 2, pos=pos, quat=quat))
    if terrain.contact is None:
        return geoms
    model = terrain.contact.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for i in range(model.ngeom):
        pos, quat = data.geom_xpos[i] + offset, np.zeros(4)
        mujoco.mju_mat2Quat(quat, data.geom_xmat[i])
        kind = mujoco.mjtGeom(model.geom_type[i])
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = _add_mesh(spec, model, int(model.geom_dataid[i]), f"{name}_{i}")
            geoms.append(body.add_geom(type=kind, meshname=mesh, pos=pos, quat=quat))
        else:
            geoms.append(body.add_geom(type=kind, size=model.geom_size[i], pos=pos, quat=quat))
    return geoms


def _add_mesh(spec: Any, model: Any, index: int, name: str) -> str:
    """A copy of a compiled mesh.

    Its vertices are in the frame whose pose is the geom's `xpos`, `xmat`: placed there, the copy is the same shape in
    the same place, whatever frame the next compiler chooses.
    """
    start, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
    faces, triangles = model.mesh_faceadr[index], model.mesh_facenum[index]
    spec.add_mesh(
        name=name,
        uservert=np.asarray(model.mesh_vert[start : start + count], float).ravel(),
        userface=np.asarray(model.mesh_face[faces : faces + triangles]).ravel(),
    )
    return name
