"""The robot drawn in 3D, its links coloured by their share of the gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.gap.diagnosis import Diagnosis
from realsim.report import viewer3d


def robot_view(found: Diagnosis) -> str:
    """Links as boxes and sticks in the pose at the start of the first run, red where the gap is."""
    simulator, comparison = found.evidence["simulator"], found.evidence["comparison"]
    model = simulator.case.model
    share: dict[int, float] = {}
    for c, channel in enumerate(comparison.channels):
        if channel.label in simulator.case.joint_names:
            body = int(model.jnt_bodyid[model.joint(channel.label).id])
            share[body] = share.get(body, 0.0) + float(found.evidence["shares"][c].sum())
    top = max(share.values(), default=1.0) or 1.0
    data = _pose(simulator)
    layers = []
    for body in range(1, model.nbody):
        level = share.get(body, 0.0) / top
        color = [int(190 + 50 * level), int(195 * (1 - 0.8 * level)), int(200 * (1 - 0.85 * level))]
        vertices, cells = _link(model, data, body)
        if len(vertices):
            layers.append((vertices, cells, color))
    if not layers:
        return '<p class="note">nothing to draw</p>'
    offset, V, F, C = 0, [], [], []
    for vertices, cells, color in layers:
        V.append(vertices)
        F.append(cells + offset)
        C.append(np.tile(np.array(color, np.uint8), (len(vertices), 1)))
        offset += len(vertices)
    return viewer3d.viewer(
        [viewer3d.Layer("robot", np.concatenate(V), np.concatenate(F), np.concatenate(C))], label="robot and gap"
    )


def _pose(simulator: Any) -> Any:
    import mujoco

    model = simulator.case.model
    data = mujoco.MjData(model)
    run = simulator.case.runs[0]
    if run.init_qpos is not None:
        data.qpos[:] = run.init_qpos
    for j, name in enumerate(simulator.case.joint_names):
        first = run.signals["joint_pos"][:, j]
        data.qpos[model.joint(name).qposadr[0]] = first[np.isfinite(first)][0]
    mujoco.mj_forward(model, data)
    return data


def _link(model: Any, data: Any, body: int) -> tuple[np.ndarray, np.ndarray]:
    """A stick from a body to each child, and a box of its inertia's size."""
    vertices, cells, count = [], [], 0
    for child in range(model.nbody):
        if model.body_parentid[child] == body:
            v, f = _stick(data.xpos[body], data.xpos[child])
            vertices.append(v)
            cells.append(f + count)
            count += len(v)
    mass, diagonal = model.body_mass[body], model.body_inertia[body]
    if mass > 0:
        half = np.sqrt(np.maximum(1.5 / mass * (diagonal.sum() - 2 * diagonal), 1e-6))
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        v = corners @ data.ximat[body].reshape(3, 3).T + data.xipos[body]
        vertices.append(v)
        cells.append(_BOX + count)
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), int)
    return np.concatenate(vertices), np.concatenate(cells)


_BOX = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def _stick(a: np.ndarray, b: np.ndarray, radius: float = 0.012) -> tuple[np.ndarray, np.ndarray]:
    axis = b - a
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        return np.zeros((0, 3)), np.zeros((0, 3), int)
    axis = axis / length
    side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    ring = [radius * (np.cos(t) * side + np.sin(t) * up) for t in np.arange(6) * np.pi / 3]
    v = np.array([a + r for r in ring] + [b + r for r in ring])
    f = [[i, (i + 1) % 6, 6 + i] for i in range(6)] + [[(i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)]
    return v, np.array(f)
