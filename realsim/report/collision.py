"""What a compiled scene collides with, as triangles to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from realsim.types import F64


def collision_triangles(scene_xml: Path) -> tuple[F64, Any]:
    """(V, 3) vertices and (K, 3) triangles of the world body's collision geoms: boxes, meshes and height fields.

    Infinite planes have no triangles and are left out.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(scene_xml))
    kinds = mujoco.mjtGeom
    drawn = (
        (kinds.mjGEOM_BOX, _box),
        (kinds.mjGEOM_MESH, _mesh),
        (kinds.mjGEOM_SDF, _mesh),
        (kinds.mjGEOM_HFIELD, _height_field),
    )
    draw = {int(kind): function for kind, function in drawn}
    parts: list[tuple[F64, Any]] = []
    for g in range(model.ngeom):
        solid = model.geom_contype[g] or model.geom_conaffinity[g]
        if model.geom_bodyid[g] != 0 or not solid or int(model.geom_type[g]) not in draw:
            continue
        V, F = draw[int(model.geom_type[g])](model, g)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[g])
        parts.append((V @ R.reshape(3, 3).T + model.geom_pos[g], F))
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    offsets = np.cumsum([0] + [len(V) for V, _ in parts])
    return np.vstack([V for V, _ in parts]), np.vstack([F + o for (_, F), o in zip(parts, offsets[:-1], strict=True)])


def _box(model: Any, g: int) -> tuple[F64, Any]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * model.geom_size[g]
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _mesh(model: Any, g: int) -> tuple[F64, Any]:
    m = model.geom_dataid[g]
    v, f = model.mesh_vertadr[m], model.mesh_faceadr[m]
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[m]].astype(float)
    return vertices, model.mesh_face[f : f + model.mesh_facenum[m]].astype(np.int64)


def _height_field(model: Any, g: int) -> tuple[F64, Any]:
    h = model.geom_dataid[g]
    rows, columns = int(model.hfield_nrow[h]), int(model.hfield_ncol[h])
    sx, sy, top, _ = model.hfield_size[h]
    at = model.hfield_adr[h]
    z = model.hfield_data[at : at + rows * columns].reshape(rows, columns) * top
    X, Y = np.meshgrid(np.linspace(-sx, sx, columns), np.linspace(-sy, sy, rows))
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (index[i, j].ravel() for i, j in _CORNERS)
    # MuJoCo cuts every cell from its lower left to its upper right corner.
    F = np.vstack([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    return np.column_stack([X.ravel(), Y.ravel(), z.ravel()]).astype(float), F


_CORNERS = (
    (slice(None, -1), slice(None, -1)),
    (slice(None, -1), slice(1, None)),
    (slice(1, None), slice(None, -1)),
    (slice(1, None), slice(1, None)),
)
