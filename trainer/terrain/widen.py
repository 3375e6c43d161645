"""The same course with wider tops: an easier one from which the way leads back to the true one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from realsim.core.geometry import R_to_quat, make_T, quat_to_R, transform
from realsim.core.meshes import mesh_of
from trainer.terrain.base import F64, Box, Terrain
from trainer.terrain.shapes import mesh

LADDER = (0.12, 0.08, 0.05, 0.025, 0.0)
"""Metres by which tops are wider, from the first rung to the true course. On beams 11 to 15 cm wide, which its base
crossed in 6 of 100, the first is a beam of 25 cm, which it crossed at once."""
_STEEP = 0.906
"""A face whose normal has a smaller z (25 degrees) is the flank of a top, not a top: wedges tilt by up to 20."""
_CORNERS = np.array([[x, y, 0.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])


def ladder(terrains: Sequence[Terrain], widths: Sequence[float] = LADDER) -> tuple[Terrain, ...]:
    """Rows of a curriculum: all terrains at the first width, then at the next; the last row is the terrains."""
    return tuple(widened(terrain, width) for width in widths for terrain in terrains)


def widened(terrain: Terrain, by: float) -> Terrain:
    """The course with every top `by` metres wider in all horizontal directions together, at the same height.

    Boxes stay boxes: flanks move outward with the top that they descend from. Of a reconstruction each convex part
    grows (a Minkowski sum with a square), a height field is dilated; rays see the grown parts beside the scan.
    """
    if by <= 0.0:
        return terrain
    half = by / 2
    terrain = replace(terrain, family=f"{terrain.family} +{100 * by:g} cm")
    if terrain.contact is None:
        boxes = tuple(_wider_box(b, half) for b in terrain.boxes)
        solid = mesh(boxes)
        return replace(terrain, boxes=boxes, vertices=solid[0], triangles=solid[1])
    contact, parts = _wider_contact(terrain.contact, half)
    seen, faces = [terrain.vertices], [terrain.triangles]
    for points, triangles in parts:
        faces.append((triangles + sum(map(len, seen))).astype(np.int32))
        seen.append(points)
    return replace(terrain, contact=contact, vertices=np.vstack(seen), triangles=np.vstack(faces))


def _wider_box(box: Box, half: float) -> Box:
    R, size = box.T[:3, :3], np.array(box.size, float)
    up = int(np.argmax(np.abs(R[2])))
    normal = R[:, up] * np.sign(R[2, up])
    others = [axis for axis in range(3) if axis != up]
    if normal[2] >= _STEEP:
        size[others] += 2 * half
        return Box(size, box.T)
    level = min(others, key=lambda axis: abs(R[2, axis]))
    size[level] += 2 * half
    outward = normal[:2] / np.linalg.norm(normal[:2])
    T = box.T.copy()
    T[:2, 3] += half * outward
    return Box(size, T)


def _wider_contact(spec: Any, half: float) -> tuple[Any, list[tuple[F64, Any]]]:
    """(A copy of a `mujoco.MjSpec` with grown world geoms, the surface of each part)."""
    import mujoco

    copy, model = spec.copy(), spec.compile()
    parts: list[tuple[F64, Any]] = []
    for i, geom in enumerate(list(copy.worldbody.geoms)):
        kind = model.geom_type[i]
        T = make_T(quat_to_R(model.geom_quat[i]), model.geom_pos[i])
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            box = _wider_box(Box(2 * model.geom_size[i], T), half)
            geom.pos, geom.quat, geom.size = box.T[:3, 3], R_to_quat(box.T[:3, :3]), box.size / 2
            parts.append(mesh((box,)))
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            points, faces = _grown_hull(transform(T, mesh_of(model, model.geom_dataid[i])[0]), half)
            new = copy.add_mesh(name=f"wider{i}", uservert=points.ravel(), userface=faces.ravel())
            geom.meshname, geom.pos, geom.quat = new.name, [0, 0, 0], [1, 0, 0, 0]
            parts.append((points, faces))
        elif kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            _dilate(copy, model, int(model.geom_dataid[i]), half)
            # Rays need no part of it: the scan beside it is what the camera sees, and a field has no edges of its own.
    used = {geom.meshname for geom in copy.worldbody.geoms}
    for old in list(copy.meshes):
        if old.name not in used:
            copy.delete(old)
    copy.compile()
    return copy, parts


def _grown_hull(points: F64, half: float) -> tuple[F64, Any]:
    """((V, 3), (F, 3)) the convex hull of points moved to the corners of a level square, outward triangles."""
    from scipy.spatial import ConvexHull

    spread = (points[:, None] + half * _CORNERS).reshape(-1, 3)
    hull = ConvexHull(spread)
    corners = spread[hull.vertices]
    index = np.full(len(spread), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces = index[hull.simplices]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces.astype(np.int32)


def _dilate(copy: Any, model: Any, field: int, half: float) -> None:
    """Every cell takes the highest of those at most `half` metres away."""
    from scipy.ndimage import grey_dilation

    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    first = model.hfield_adr[field]
    heights = np.asarray(model.hfield_data[first : first + rows * columns], float).reshape(rows, columns)
    reach_x, reach_y = (
        round(half / (2 * size / (count - 1)))
        for size, count in zip(model.hfield_size[field][:2], (columns, rows), strict=True)
    )
    wider = grey_dilation(heights, size=(2 * reach_y + 1, 2 * reach_x + 1))
    for target in copy.hfields:
        if target.name == model.hfield(field).name:
            target.userdata = wider.ravel()
