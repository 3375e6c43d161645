"""The robot in 3D, its parts coloured by their share of the gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.core.types import F64
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.case.case import Case, Run
from realsim.gap.effects.lookup import places_of
from realsim.gap.report.series import place_shares
from realsim.gap.report.words import HEAT, NOT_KEPT
from realsim.report import page, raster, svg
from realsim.report.solids import Solid, extent, ring, rod, solids
from realsim.report.viewer3d import Layer, viewer

_GROUND, _MARK = (196, 202, 210), (124, 58, 237)


def robot_card(found: Diagnosis) -> str:
    """Bodies at the first pose of the log; a joint's share colours the body that it moves."""
    if found.evidence is None:
        return page.card("On the robot", page.bullets([], NOT_KEPT))
    case = found.evidence.case
    data = first_pose(case.model, case.runs[0], case.joint_names)
    shares = body_shares(found.evidence)
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
    if not any(places_of(c) for c in found.causes):
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


def body_shares(kept: Arrays) -> F64:
    """(nbody,) share of the gap at each body."""
    case, model = kept.case, kept.case.model
    free = np.flatnonzero(model.jnt_type == 0)
    base = int(model.jnt_bodyid[free[0]]) if len(free) else 0
    result = np.zeros(model.nbody)
    names, shares = place_shares(kept)
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
    size = extent(case.model, data)
    parts: list[tuple[F64, Any, Any]] = []
    for cause in found.causes:
        for joint in cause.get("joints", []):
            j = case.model.joint(joint).id
            half = 0.1 * size * data.xaxis[j]
            parts.append(_painted(rod(data.xanchor[j] - half, data.xanchor[j] + half, 0.008 * size)))
            if case.model.jnt_type[j] == 3:
                parts.append(_painted(ring(data.xanchor[j], data.xaxis[j], 0.1 * size, 0.012 * size)))
        for body in cause.get("bodies", []):
            low, high = _box_of(case.model, data, case.model.body(body).id, 0.02 * size)
            parts += [_painted(rod(a, b, 0.006 * size)) for a, b in _edges(low, high)]
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
