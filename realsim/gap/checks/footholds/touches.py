"""Where feet stood: their height above the scanned tops by forward kinematics, their load, and how far they slid."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.case.case import Case, Run
from realsim.gap.case.motion import Motion, estimate
from realsim.gap.checks.camera.terrain import Terrain
from realsim.gap.inference.evidence.inverse import drive_force, needed_force

REACH = 0.12
"""m: tops that are farther above or below a foot are no place where it stands."""
LEAST_SECONDS = 0.12
"""A shorter contact is a knock, or a gap in the reading."""
EDGE = 0.04
"""s at both ends of a contact in which a foot lands or lifts."""
EVERY = 0.05
"""s between the moments that are looked at."""
MOST = 12
"""Moments of one contact: its neighbours in time say the same."""
LOADED = 0.05
"""Share of the robot's weight below which a foot does not stand."""


@dataclass(frozen=True)
class Touch:
    """One foot on one foothold, from landing to lift-off, at M moments."""

    run: int
    foot: int
    name: str
    """The foothold."""
    geom: int
    time: F64
    """(M,) s"""
    height: F64
    """(M,) m of the foot's underside above the scanned top; below zero where it is in it."""
    middle: F64
    """(2,) m, of the foothold."""
    top: float
    """m, scanned."""
    place: F64
    """(M, 2) m of the foot's lowest point from the foothold's middle, world axes."""
    arm: F64
    """(M, 2) m of the foot's lowest point from the base, world axes: how a tilt of the base lifts it."""
    load: F64
    """(M,) N on the foothold, downward."""
    shear: F64
    """(M, 2) N on the foothold, world axes."""
    slid: F64
    """(M, 2) m that the foot's underside moved over the ground since landing, world axes."""
    speed: F64
    """(M,) m/s of that."""


@dataclass
class Touches:
    """All of a log, and what did not fit."""

    items: list[Touch] = field(default_factory=list)
    lost: int = 0
    """Contacts with no top within reach."""
    weight: float = 0.0
    """N of the robot."""


def find_touches(case: Case, terrain: Terrain) -> Touches:
    """Every contact of the log with its foothold.

    Raises:
        GapError: signals are missing, or most contacts lie where the scene has nothing.
    """
    _check(case)
    import mujoco

    model = case.spec.copy().compile()
    data = mujoco.MjData(model)
    points = {f: underside(model, body) for f, body in enumerate(case.contact_bodies)}
    found = Touches(weight=9.81 * float(model.body_subtreemass[0]))
    for r, run in enumerate(case.runs):
        motion = estimate(case, run)
        for f, (begin, end) in _stances(run, motion):
            moments = _moments(motion, begin, end)
            if len(moments) < 2:
                continue
            touch = _touch(case, terrain, model, data, run, motion, (r, f), moments, points, found.weight)
            found.lost += touch is None
            if touch is not None and len(touch.time) >= 2:
                found.items.append(touch)
    total = len(found.items) + found.lost
    if found.lost > 0.5 * total or not found.items:
        raise GapError(
            "the robot's feet do not stand on the scene",
            file=case.folder,
            expected=f"contacts within {100 * REACH:.0f} cm of its tops",
            found=f"{found.lost} of {total} contacts have no top there",
            hint="base_pos and base_quat must be in the scene's frame (origin and x axis at the start platform)",
        )
    return found


def _check(case: Case) -> None:
    if not case.floating:
        raise GapError("footholds need a robot that walks", file=case.folder, expected="base: floating")
    missing = [name for name in ("base_pos", "base_quat", "contact") if not case.has(name)]
    if missing:
        raise GapError(
            f"the log has no {', '.join(missing)}",
            file=case.folder,
            expected="base_pos, base_quat (in the scene's frame), contact and joint_pos in every run",
            found=", ".join(sorted(set.intersection(*(set(r.signals) for r in case.runs)))),
            hint="contact: 1 where a foot's force or torque says that it stands (realsim log reads foot forces)",
        )


def underside(model: Any, body: str) -> list[Part]:
    """All that a foot can touch with."""
    import mujoco

    root = model.body(body).id
    geoms = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] == model.body_weldid[root]]
    solid = [g for g in geoms if model.geom_contype[g] | model.geom_conaffinity[g]]
    own = [g for g in solid if int(model.geom_bodyid[g]) == root] or solid
    if not own:
        raise GapError(f"the foot {body!r} has no geom that touches", expected="a colliding geom on every contact body")
    kinds = mujoco.mjtGeom
    found: list[Part] = []
    for g in own:
        size, kind = model.geom_size[g], kinds(int(model.geom_type[g]))
        if kind == kinds.mjGEOM_MESH:
            mesh = model.geom_dataid[g]
            start = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(float)
            found.append(Part(g, vertices[:: max(1, len(vertices) // 200)]))
        elif kind == kinds.mjGEOM_BOX:
            grid = np.linspace(-1, 1, 5)
            cube = np.array(np.meshgrid(grid, grid, grid)).reshape(3, -1).T
            found.append(Part(g, cube[(np.abs(cube) == 1).any(axis=1)] * size))
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE):
            half = size[1] if kind == kinds.mjGEOM_CAPSULE else 0.0
            centres = np.array([[0.0, 0.0, z] for z in (np.linspace(-half, half, 5) if half else [0.0])])
            found.append(Part(g, centres, float(size[0])))
        elif kind == kinds.mjGEOM_CYLINDER:
            turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
            rim = np.column_stack([np.cos(turn), np.sin(turn)]) * size[0]
            found.append(Part(g, np.vstack([np.column_stack([rim, np.full(24, z)]) for z in (-size[1], size[1])])))
        else:
            found.append(Part(g, _ball() * size))
    return found


@dataclass(frozen=True)
class Part:
    """Points of a geom that may touch the ground, in its frame; with a radius, the centres of balls."""

    geom: int
    points: F64
    radius: float = 0.0

    def world(self, data: Any) -> F64:
        """(P, 3) m: of balls, points of their lower halves, the lowest among them."""
        found = self.points @ data.geom_xmat[self.geom].reshape(3, 3).T + data.geom_xpos[self.geom]
        if not self.radius:
            return found
        return (found[:, None] + self.radius * _BOWL).reshape(-1, 3)


def _bowl() -> F64:
    """(P, 3) of the lower half of the unit sphere: its lowest point, and rings around it."""
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    rings = [
        [np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.full(8, -np.cos(a))]
        for a in np.radians([12, 30, 50, 75])
    ]
    return np.vstack([[[0.0, 0.0, -1.0]], *(np.transpose(ring) for ring in rings)])


_BOWL = _bowl()


def _ball(count: int = 200) -> F64:
    """(count, 3) points spread over the unit sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def _stances(run: Run, motion: Motion) -> list[tuple[int, tuple[float, float]]]:
    """(foot, (begin, end) s) of every contact; gaps below two moments are lost messages."""
    found = []
    for f, column in enumerate(run.signals["contact"].T):
        finite = np.isfinite(column)
        if not finite.any():
            continue
        at = np.searchsorted(run.time[finite], motion.time, side="right") - 1
        on = (column[finite][np.clip(at, 0, None)] > 0.5) & motion.good
        step = float(motion.time[1] - motion.time[0])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int))).reshape(-1, 2)
        spans: list[list[float]] = []
        for begin, end in edges * step:
            if spans and begin - spans[-1][1] < EDGE:
                spans[-1][1] = end
            else:
                spans.append([begin, end])
        found += [(f, (b, e)) for b, e in spans if e - b >= LEAST_SECONDS]
    return found


def _moments(motion: Motion, begin: float, end: float) -> list[int]:
    count = min(max(2, int((end - begin - 2 * EDGE) / EVERY) + 1), MOST)
    wanted = np.linspace(begin + EDGE, end - EDGE, count)
    return [int(n) for n in np.unique(np.searchsorted(motion.time, wanted)) if n < len(motion.time) and motion.good[n]]


def _touch(
    case: Case, terrain: Terrain, model: Any, data: Any, run: Run, motion: Motion, who: tuple[int, int],
    moments: list[int], points: dict[int, list[Part]], weight: float,
) -> Touch | None:  # fmt: skip
    """One contact, or None where no top is near."""
    import mujoco

    r, f = who
    rows: list[tuple[float, ...]] = []
    holds: list[tuple[str, int]] = []
    middles: dict[str, tuple[F64, float]] = {}
    slid, before, body = np.zeros(2), None, model.body(case.contact_bodies[f]).id
    for n in moments:
        needed = needed_force(model, data, motion, n)
        driven = drive_force(case, model, data, run, float(motion.time[n]))
        data.qpos[:], data.qvel[:] = motion.qpos[n], motion.qvel[n]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        height, geom, low = clearance(terrain, data, points[f])
        if geom < 0:
            continue
        force = _forces(case, model, data, run, float(motion.time[n]), needed - driven, points)
        now = _Sole(float(motion.time[n]), data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy(), low)
        step = np.zeros(2) if before is None else now.moved_since(before)
        speed = 0.0 if before is None else float(np.linalg.norm(step)) / (now.time - before.time)
        slid, before = slid + step, now
        name, middle, _ = terrain.foothold(geom, low)
        push = force.get(f, np.full(3, np.nan))
        if not push[2] > LOADED * weight:
            continue
        holds.append((name, geom))
        middles[name] = middle, float(low[2] - height)
        base = motion.qpos[n][_base_address(case)]
        rows.append(
            (motion.time[n], height, *(low[:2] - middle), *(low[:2] - base[:2]), push[2], *-push[:2], *slid, speed)
        )
    if not rows:
        return None if not holds and before is None else _empty(r, f)
    usual = max(set(holds), key=holds.count)
    a = np.array([row for row, hold in zip(rows, holds, strict=True) if hold == usual])
    return Touch(
        r,
        f,
        *usual,
        a[:, 0],
        a[:, 1],
        *middles[usual[0]],
        a[:, 2:4],
        a[:, 4:6],
        a[:, 6],
        a[:, 7:9],
        a[:, 9:11] - a[0, 9:11],
        a[:, 11],
    )


@dataclass(frozen=True)
class _Sole:
    """A foot at a moment: its frame in the world, and its lowest point."""

    time: float
    origin: F64
    axes: F64
    low: F64

    def moved_since(self, before: _Sole) -> F64:
        """(2,) m that the underside moved over the ground: what a round foot rolls does not count.

        The material points that are lowest before and after are both followed from one moment to the other.
        """
        steps = [self._follow(before, point) for point in (before._own(before.low), self._own(self.low))]
        return np.mean(steps, axis=0)[:2]

    def _own(self, point: F64) -> F64:
        return self.axes.T @ (point - self.origin)

    def _follow(self, before: _Sole, own: F64) -> F64:
        return (self.origin + self.axes @ own) - (before.origin + before.axes @ own)


def _empty(r: int, f: int) -> Touch:
    """A contact that never bore load."""
    none, pair = np.zeros(0), np.zeros((0, 2))
    return Touch(r, f, "", -1, none, none, none, 0.0, pair, pair, none, pair, pair, none)


def _base_address(case: Case) -> slice:
    joint = int(np.flatnonzero(case.model.jnt_type == 0)[0])
    start = int(case.model.jnt_qposadr[joint])
    return slice(start, start + 3)


def clearance(terrain: Terrain, data: Any, points: list[Part]) -> tuple[float, int, F64]:
    """(m that a foot could sink until it touches, the geom it would touch, where); (inf, -1, ...) out of reach.

    The least distance, straight down, of the lower half of its surface: so a round foot beside a higher edge is held
    by that edge.
    """
    world = np.vstack([part.world(data) for part in points])
    world = world[world[:, 2] <= np.quantile(world[:, 2], 0.5) + 1e-9]
    best: tuple[float, int, F64] = (np.inf, -1, world[int(np.argmin(world[:, 2]))])
    for point in world:
        top, geom = terrain.below(point, REACH)
        if point[2] - top < min(best[0], REACH):
            best = (float(point[2] - top), geom, point)
    return best


def _forces(
    case: Case, model: Any, data: Any, run: Run, when: float, rest: F64, points: dict[int, list[Part]]
) -> dict[int, F64]:
    """Foot -> (3,) N that the ground pushes it with, from what the joints' rows lack; the base's only steady it."""
    import mujoco

    at = int(np.argmin(np.abs(run.time - when)))
    contact = run.signals["contact"][at]
    feet = [f for f in range(len(case.contact_bodies)) if not contact[f] <= 0.5]
    if not feet:
        return {}
    rows = []
    for f in feet:
        world = np.vstack([part.world(data) for part in points[f]])
        jac = np.zeros((3, model.nv))
        low = world[int(np.argmin(world[:, 2]))]
        mujoco.mj_jac(model, data, jac, None, low, model.body(case.contact_bodies[f]).id)
        rows.append(jac)
    J = np.vstack(rows)
    free = int(model.jnt_dofadr[int(np.flatnonzero(model.jnt_type == 0)[0])])
    sigma = np.full(model.nv, 0.3)
    sigma[free : free + 6] = 0.1 * 9.81 * float(model.body_subtreemass[0])
    known = np.isfinite(rest)
    A = np.vstack([(J.T / sigma[:, None])[known], np.eye(len(J)) / (3 * 9.81 * float(model.body_subtreemass[0]))])
    b = np.concatenate([(rest / sigma)[known], np.zeros(len(J))])
    force = np.linalg.lstsq(A, b, rcond=None)[0].reshape(-1, 3)
    return dict(zip(feet, force, strict=True))
