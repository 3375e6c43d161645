"""The robot in 3D, its parts coloured by their share of the gap."""

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from realsim.core.types import F64, MjData
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.case.case import Case
from realsim.gap.case.motion import estimate
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
    data = first_pose(case)
    shares = body_shares(found.evidence)
    top = max(shares.max(), 1e-9)
    gap = found.verdict != "no_gap"
    colors = raster.colorize(shares[:, None] / top * gap, 0.0, 1.0, HEAT)[:, 0, :3]
    shapes = [(b, V, F, case.model.body_weldid[b] == 0) for b, (V, F) in solids(case.model, data)]
    layers = [Layer("robot", V, F, colors[body]) for body, V, F, fixed in shapes if not fixed]
    if layers:
        layers.append(_air(np.vstack([layer.vertices for layer in layers])))
    layers += [Layer("ground", V, F, _GROUND) for _, V, F, fixed in shapes if fixed]
    layers += [Layer("cause", *solid, _MARK) for solid in _marks(found, case, data)]
    view = viewer(layers, label="the robot, coloured by the share of the gap")
    scale = svg.color_bar(0.0, 100 * top, "%", HEAT) if gap else ""
    note = "Colour: share of the gap seen at the joint that moves a part, or at the base. Drag to turn."
    note = note if gap else "As the log begins. There is no gap to colour. Drag to turn."
    return page.card("On the robot", view + scale + _key(found), note)


def _key(found: Diagnosis) -> str:
    placed = any(places_of(c) for c in found.causes)
    return page.legend([("where the diagnosis puts the cause", f"rgb{_MARK}")] if placed else [])


def first_pose(case: Case) -> MjData:
    """mujoco.MjData at the beginning of the first run, positions only."""
    import mujoco

    data, run = mujoco.MjData(case.model), case.runs[0]
    data.qpos[:] = estimate(case, run).qpos[0] if run.init_qpos is None else run.init_qpos
    mujoco.mj_forward(case.model, data)
    return data


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


def _air(P: F64) -> Layer:
    """A triangle without area that spans the robot's box and some air, so that the first view holds all of it."""
    middle, half = (P.min(axis=0) + P.max(axis=0)) / 2, 0.62 * np.ptp(P, axis=0)
    return Layer("robot", np.stack([middle - half, middle + half]), [[0, 0, 1]])


def _marks(found: Diagnosis, case: Case, data: MjData) -> Iterator[Solid]:
    """A ring about the axis of every joint, and a cage around every body, that a cause names."""
    size = extent(case.model, data)
    for cause in found.causes:
        for joint in cause.get("joints", []):
            j = case.model.joint(joint).id
            half = 0.1 * size * data.xaxis[j]
            yield rod(data.xanchor[j] - half, data.xanchor[j] + half, 0.008 * size)
            if case.model.jnt_type[j] == 3:
                yield ring(data.xanchor[j], data.xaxis[j], 0.1 * size, 0.012 * size)
        for body in cause.get("bodies", []):
            b = case.model.body(body).id
            P = np.vstack([data.xipos[b][None], *(V for part, (V, _) in solids(case.model, data) if part == b)])
            box = np.array([P.min(axis=0) - 0.02 * size, P.max(axis=0) + 0.02 * size])
            corners = np.array(list(product(*box.T)))
            edges = [(a, b) for a, b in combinations(corners, 2) if np.sum(a != b) == 1]
            yield from (rod(a, b, 0.006 * size) for a, b in edges)
