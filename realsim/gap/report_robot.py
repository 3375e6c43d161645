"""The robot in 3D, its parts coloured by their share of the gap."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from realsim.gap.case import Case, Run
from realsim.gap.diagnosis import Diagnosis
from realsim.gap.report_overlays import HEAT
from realsim.gap.report_series import place_shares
from realsim.gap.report_words import place_of
from realsim.meshes import simplify
from realsim.report import page, raster, svg
from realsim.report.viewer3d import Layer, viewer
from realsim.types import F64

_GROUND, _MARK = (196, 202, 210), (124, 58, 237)
_MESH_TRIANGLES = 2500
"""Most triangles of one mesh geom to look at."""
Solid = tuple[F64, Any]
"""(V, 3) vertices and (K, 3) triangles."""


def robot_card(found: Diagnosis) -> str:
    """Bodies at the first pose of the log; a joint's share colours the body that it moves."""
    if "simulator" not in found.evidence or "shares" not in found.evidence:
        return page.card("On the robot", page.bullets([], "The simulator was not kept with this diagnosis."))
    case: Case = found.evidence["simulator"].case
    data = first_pose(case.model, case.runs[0], case.joint_names)
    shares = body_shares(found, case)
    top = max(shares.max(), 1e-9)
    gap = found.verdict != "no_gap"
    colors = raster.colorize(shares[:, None] / top * gap, 0.0, 1.0, HEAT)[:, 0, :3]
    parts, ground = [], []
    for body, (V, F) in solids(case.model, data):
        if case.model.body_weldid[body] == 0:
            ground.append((V, F, np.tile(np.array(_GROUND, np.uint8), (len(V), 1))))
        else:
            parts.append((V, F, np.tile(colors[body], (len(V), 1))))
    parts.append(_frame(parts))
    layers = [_layer("robot", parts), *([_layer("ground", ground)] if ground else []), *_marks(found, case, data)]
    view = viewer(layers, label="the robot, coloured by the share of the gap")
    scale = svg.color_bar(0.0, 100 * top, "%", HEAT) if gap else ""
    note = "Colour: share of the gap seen at the joint that moves a part, or at the base. Drag to turn."
    note = note if gap else "As the log begins. There is no gap to colour. Drag to turn."
    return page.card("On the robot", view + scale + _key(found), note)


def _key(found: Diagnosis) -> str:
    if not any(place_of(c) for c in found.causes):
        return ""
    mark = f'<i style="background:rgb{_MARK}"></i>'
    return f'<div class="legend"><span>{mark}where the diagnosis puts the cause</span></div>'


def first_pose(model: Any, run: Run, joint_names: tuple[str, ...]) -> Any:
    """mujoco.MjData at the initial state of a run, positions only."""
    import mujoco

    data = mujoco.MjData(model)
    if run.init_qpos is not None:
        data.qpos[:] = run.init_qpos
    else:
        for name, column in zip(joint_names, run.signals["joint_pos"].T, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = _first(column)
        free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        for signal, offset in (("base_pos", 0), ("base_quat", 3)):
            if len(free) and signal in run.signals:
                for k, column in enumerate(run.signals[signal].T):
                    data.qpos[model.jnt_qposadr[free[0]] + offset + k] = _first(column)
    mujoco.mj_forward(model, data)
    return data


def _first(column: F64) -> float:
    good = column[np.isfinite(column)]
    return float(good[0]) if len(good) else 0.0


def body_shares(found: Diagnosis, case: Case) -> F64:
    """(nbody,) share of the gap at each body."""
    model = case.model
    free = np.flatnonzero(model.jnt_type == 0)
    base = int(model.jnt_bodyid[free[0]]) if len(free) else 0
    result = np.zeros(model.nbody)
    names, shares = place_shares(found)
    for (kind, name), share in zip(names, shares.sum(axis=1), strict=True):
        if kind == "joint":
            result[int(model.joint(name).bodyid[0])] += share
        elif name.startswith("imu") and case.imu_site:
            result[int(model.site(case.imu_site).bodyid[0])] += share
        else:
            result[base] += share
    return result


def _layer(name: str, parts: list[tuple[F64, Any, Any]]) -> Layer:
    offsets = np.cumsum([0, *(len(V) for V, _, _ in parts)])
    vertices = np.vstack([V for V, _, _ in parts]) if parts else np.zeros((0, 3))
    cells = [np.asarray(F) + o for (_, F, _), o in zip(parts, offsets[:-1], strict=True)]
    colors = [C for _, _, C in parts]
    return Layer(name, vertices, np.vstack(cells) if cells else None, np.vstack(colors) if colors else None)


def _frame(parts: list[tuple[F64, Any, Any]]) -> tuple[F64, Any, Any]:
    """Two triangles without area that span the robot's box and some air, so that the first view holds all of it."""
    P = np.vstack([V for V, _, _ in parts]) if parts else np.zeros((1, 3))
    middle, half = (P.min(axis=0) + P.max(axis=0)) / 2, 0.62 * (P.max(axis=0) - P.min(axis=0))
    return np.stack([middle - half, middle + half]), np.array([[0, 0, 0], [1, 1, 1]]), np.zeros((2, 3), np.uint8)


def _marks(found: Diagnosis, case: Case, data: Any) -> list[Layer]:
    """A ring about the axis of every joint, and a cage around every body, that a cause names."""
    size = _extent(case.model, data)
    parts: list[tuple[F64, Any, Any]] = []
    for cause in found.causes:
        for joint in cause.get("joints", []):
            j = case.model.joint(joint).id
            half = 0.1 * size * data.xaxis[j]
            parts.append(_painted(_rod(data.xanchor[j] - half, data.xanchor[j] + half, 0.008 * size)))
            if case.model.jnt_type[j] == 3:
                parts.append(_painted(_ring(data.xanchor[j], data.xaxis[j], 0.1 * size, 0.012 * size)))
        for body in cause.get("bodies", []):
            low, high = _box_of(case.model, data, case.model.body(body).id, 0.02 * size)
            parts += [_painted(_rod(a, b, 0.006 * size)) for a, b in _edges(low, high)]
    return [_layer("cause", parts)] if parts else []


def _box_of(model: Any, data: Any, body: int, air: float) -> tuple[F64, F64]:
    """Lowest and highest corner of a body's shapes in the world; a small cube at its centre where it has none."""
    P = [V for b, (V, _) in solids(model, data) if b == body]
    points = np.vstack(P) if P else data.xipos[body][None]
    air = air if P else 2 * air
    return points.min(axis=0) - air, points.max(axis=0) + air


def _edges(low: F64, high: F64) -> list[tuple[F64, F64]]:
    """The twelve edges of a box."""
    corners = [np.array([x, y, z]) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    return [(a, b) for i, a in enumerate(corners) for b in corners[i + 1 :] if np.sum(a != b) == 1]


def _painted(solid: Solid) -> tuple[F64, Any, Any]:
    return *solid, np.tile(np.array(_MARK, np.uint8), (len(solid[0]), 1))


def _extent(model: Any, data: Any) -> float:
    """Size of the moving robot, m."""
    moving = np.flatnonzero(model.body_weldid != 0)
    points = np.vstack([data.xpos[moving], data.xipos[moving]])
    return max(float(np.linalg.norm(points.max(axis=0) - points.min(axis=0))), 0.1)


# ---------------------------------------------------------------- shapes


def solids(model: Any, data: Any) -> list[tuple[int, Solid]]:
    """(body, shape in the world) of all geoms that can be seen; bodies without any are rods from joint to joint."""
    size = _extent(model, data)
    found: list[tuple[int, Solid]] = []
    shown = {int(b) for g, b in enumerate(model.geom_bodyid) if _drawn(model, g) and model.geom_group[g] < 3}
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        # Group 3 and up hold collision shapes by custom: drawn only where a body has nothing else.
        if not _drawn(model, g) or (model.geom_group[g] >= 3 and body in shown):
            continue
        if model.geom_type[g] == 0:
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
    rods = [_rod(data.xpos[body], end, radius) for end in ends if np.linalg.norm(end - data.xpos[body]) > 0.2 * radius]
    V, F = _ball(np.full(3, 1.5 * radius))
    return [*rods, (V + data.xpos[body], F)]


def _rod(a: F64, b: F64, radius: float) -> Solid:
    """A capsule between two points."""
    V, F = _capsule(radius, float(np.linalg.norm(b - a)) / 2)
    return V @ _turned(b - a) + (a + b) / 2, F


def _turned(z: F64) -> F64:
    """(3, 3) rows are the axes of a frame whose third axis lies along z: V @ R turns V there."""
    z = z / max(float(np.linalg.norm(z)), 1e-9)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= max(float(np.linalg.norm(x)), 1e-9)
    return np.stack([x, np.cross(z, x), z])


def _ring(centre: F64, axis: F64, radius: float, thickness: float) -> Solid:
    """A torus about an axis."""
    turn = np.linspace(0, 2 * np.pi, 9)
    V, F = _surface(np.column_stack([radius + thickness * np.cos(turn), thickness * np.sin(turn)]), 40)
    return V @ _turned(axis) + centre, F


def _surface(rings: F64, sides: int = 18) -> Solid:
    """A surface of revolution: (M, 2) radius and height, bottom to top."""
    turn = 2 * np.pi * np.arange(sides) / sides
    r, z = rings[:, 0, None], rings[:, 1, None]
    V = np.stack([r * np.cos(turn), r * np.sin(turn), z + 0 * turn], axis=-1).reshape(-1, 3)
    i, k = np.meshgrid(np.arange(len(rings) - 1), np.arange(sides), indexing="ij")
    a, b = (i * sides + k).ravel(), (i * sides + (k + 1) % sides).ravel()
    return V, np.vstack([np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])])


def _capsule(radius: float, half: float) -> Solid:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 12)
    side = np.repeat([-half, half], 6)
    return _surface(np.column_stack([radius * np.cos(angle), radius * np.sin(angle) + side]))


def _ball(size: F64) -> Solid:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 11)
    V, F = _surface(np.column_stack([np.cos(angle), np.sin(angle)]))
    return V * size, F


def _cylinder(model: Any, g: int) -> Solid:
    r, h, _ = model.geom_size[g]
    return _surface(np.array([[0, -h], [r, -h], [r, h], [0, h]]), 24)


def _box(model: Any, g: int) -> Solid:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * model.geom_size[g]
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _mesh(model: Any, g: int) -> Solid:
    m = model.geom_dataid[g]
    v, f = model.mesh_vertadr[m], model.mesh_faceadr[m]
    V = model.mesh_vert[v : v + model.mesh_vertnum[m]].astype(float)
    return simplify(V, model.mesh_face[f : f + model.mesh_facenum[m]], None, _MESH_TRIANGLES)[:2]


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
    6: _box,
    7: _mesh,
}
