"""Collision geometry of a compiled scene, and its robot, as triangles for display."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.meshes import across, edges_of, height_field, merged
from realsim.core.types import F64
from realsim.report.solids import Solid, box, mesh, solids


def collision_triangles(scene_xml: Path) -> Solid:
    """(V, 3) vertices and (K, 3) triangles of the world body's collision geoms: boxes, meshes and height fields.

    Infinite planes have no triangles and are left out.
    """
    return merged([part for part, _ in collision_parts(load(scene_xml)[0])])


def collision_parts(model: Any) -> list[tuple[Solid, bool]]:
    """(triangles, whether its edges are worth drawing) of every collision geom of the world body, in the world."""
    import mujoco

    kinds = mujoco.mjtGeom
    draw = {kinds.mjGEOM_BOX: box, kinds.mjGEOM_MESH: mesh, kinds.mjGEOM_SDF: mesh, kinds.mjGEOM_HFIELD: _hfield}
    parts = []
    for g in range(model.ngeom):
        solid = model.geom_contype[g] or model.geom_conaffinity[g]
        kind = kinds(int(model.geom_type[g]))
        if model.geom_bodyid[g] != 0 or not solid or kind not in draw:
            continue
        V, F = draw[kind](model, g)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[g])
        parts.append(((V @ R.reshape(3, 3).T + model.geom_pos[g], F), kind != kinds.mjGEOM_HFIELD))
    return parts


def robot_triangles(model: Any, data: Any) -> Solid:
    """(V, 3) and (K, 3) of all bodies that can move, where `data` has them."""
    return merged([solid for body, solid in solids(model, data, planes=False) if model.body_weldid[body] != 0])


def load(scene_xml: Path) -> tuple[Any, Any]:
    """The compiled model, and its mujoco.MjData at the first keyframe (a robot on the start platform)."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(scene_xml))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return model, data


def sharp_edges(V: F64, F: Any, degrees: float = 20.0) -> Any:
    """(E, 2) edges between faces that meet at more than this angle, and edges of one face only."""
    normals = across(V, F)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)
    edges = edges_of(F)
    shared = np.flatnonzero(edges.uses > 1)
    one, other = (normals[edges.order[edges.first[shared] + k] // 3] for k in (0, 1))
    flat = np.zeros(len(edges.uses), bool)
    flat[shared] = np.einsum("ij,ij->i", one, other) > np.cos(np.radians(degrees))
    return np.sort(edges.runs[edges.order[edges.first]], axis=1)[~flat]


DRAWN_NODES = 200_000
"""Of a height field, at most: ten times what is shown of it after it was simplified."""


def _hfield(model: Any, g: int) -> Solid:
    field = model.geom_dataid[g]
    nodes = int(model.hfield_nrow[field]) * int(model.hfield_ncol[field])
    return height_field(model, field, max(1, round((nodes / DRAWN_NODES) ** 0.5)))
