"""MuJoCo geoms as triangles to look at: simple solids, meshes, and rods where a robot has no shape."""

from collections.abc import Callable
from typing import Any

import numpy as np

from realsim.core.meshes import mesh_of, simplify
from realsim.core.types import F64

_MESH_TRIANGLES = 2500
"""Most triangles of one mesh geom to look at."""
Solid = tuple[F64, Any]
"""(V, 3) vertices and (K, 3) triangles."""


def extent(model: Any, data: Any) -> float:
    """Size of the moving robot, m."""
    moving = np.flatnonzero(model.body_weldid != 0)
    if not len(moving):
        return 0.1
    points = np.vstack([data.xpos[moving], data.xipos[moving]])
    return max(float(np.linalg.norm(points.max(axis=0) - points.min(axis=0))), 0.1)


def solids(model: Any, data: Any, *, planes: bool = True) -> list[tuple[int, Solid]]:
    """(body, shape in the world) of all geoms that can be seen; bodies without any are rods from joint to joint.

    Args:
        model, data: mujoco.MjModel and an MjData with positions computed.
        planes: whether to draw a piece of each endless plane.
    """
    size = extent(model, data)
    found: list[tuple[int, Solid]] = []
    shown = {int(b) for g, b in enumerate(model.geom_bodyid) if _drawn(model, g) and model.geom_group[g] < 3}
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        # Group 3 and up hold collision shapes by custom: drawn only where a body has nothing else.
        if not _drawn(model, g) or (model.geom_group[g] >= 3 and body in shown):
            continue
        if model.geom_type[g] == 0:
            if not planes:
                continue
            found.append((body, _patch(data, g, size)))
            continue
        V, F = _SHAPES[int(model.geom_type[g])](model, g)
        found.append((body, (V @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g], F)))
    bare = [b for b in range(1, model.nbody) if b not in {int(i) for i in model.geom_bodyid} and model.body_weldid[b]]
    return found + [(b, rod) for b in bare for rod in _skeleton(model, data, b, 0.018 * size)]


def _drawn(model: Any, g: int) -> bool:
    kind = int(model.geom_type[g])
    return (kind == 0 or kind in _SHAPES) and model.geom_rgba[g, 3] > 0


def _skeleton(model: Any, data: Any, body: int, radius: float) -> list[Solid]:
    ends = [data.xpos[c] for c in range(1, model.nbody) if model.body_parentid[c] == body]
    if not ends:  # the last link: through its centre of mass, and as far again
        ends = [data.xpos[body] + 2 * (data.xipos[body] - data.xpos[body])]
    rods = [rod(data.xpos[body], end, radius) for end in ends if np.linalg.norm(end - data.xpos[body]) > 0.2 * radius]
    V, F = _ball(np.full(3, 1.5 * radius))
    return [*rods, (V + data.xpos[body], F)]


def rod(a: F64, b: F64, radius: float) -> Solid:
    """A capsule between two points."""
    return _placed(_capsule(radius, float(np.linalg.norm(b - a)) / 2), b - a, (a + b) / 2)


def ring(centre: F64, axis: F64, radius: float, thickness: float) -> Solid:
    """A torus about an axis."""
    return _placed(_made("torus", radius, thickness, major_sections=40, minor_sections=8), axis, centre)


def _made(kind: str, *sizes: Any, **counts: Any) -> Solid:
    from trimesh import creation  # here, because --help does not wait for it

    found = getattr(creation, kind)(*sizes, **counts)
    return found.vertices, found.faces


def _placed(solid: Solid, axis: F64, centre: F64) -> Solid:
    """A solid whose third axis is turned to point along `axis`."""
    from trimesh.geometry import align_vectors

    V, F = solid
    return V @ align_vectors([0, 0, 1], axis)[:3, :3].T + centre, F


def _capsule(radius: float, half: float) -> Solid:
    return _made("capsule", 2 * half, radius, count=[12, 18])


def _ball(size: F64) -> Solid:
    V, F = _made("uv_sphere", count=[11, 18])
    return V * size, F


def _cylinder(model: Any, g: int) -> Solid:
    radius, half, _ = model.geom_size[g]
    return _made("cylinder", radius, 2 * half, sections=24)


def box(model: Any, g: int) -> Solid:
    """A box geom, geom frame."""
    return _made("box", 2 * model.geom_size[g])


def mesh(model: Any, g: int) -> Solid:
    """A mesh geom as it is, geom frame."""
    return mesh_of(model, model.geom_dataid[g])


def _patch(data: Any, g: int, size: float) -> Solid:
    """A piece of an endless plane below the robot."""
    R, p = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    middle = np.mean(data.xpos[1:], axis=0) if len(data.xpos) > 1 else p
    centre = middle - R[:, 2] * float((middle - p) @ R[:, 2])
    corners = 0.8 * size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return centre + corners @ R.T, np.array([[0, 1, 2], [0, 2, 3]])


# By mujoco.mjtGeom: sphere, capsule, ellipsoid, cylinder, box, mesh. Height fields are not drawn.
_SHAPES: dict[int, Callable[[Any, int], Solid]] = {
    2: lambda model, g: _ball(np.full(3, model.geom_size[g, 0])),
    3: lambda model, g: _capsule(model.geom_size[g, 0], model.geom_size[g, 1]),
    4: lambda model, g: _ball(model.geom_size[g]),
    5: _cylinder,
    6: box,
    7: lambda model, g: simplify(*mesh(model, g), None, _MESH_TRIANGLES)[:2],
}
