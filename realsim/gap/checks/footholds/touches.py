"""Where feet stood: their height above the scanned tops by forward kinematics, their load, and how far they slid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from realsim.core.errors import GapError
from realsim.core.meshes import mesh_of
from realsim.core.types import F64, MjData, MjModel
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
    feet = _Feet(case, terrain)
    found = Touches(weight=feet.weight)
    for r, run in enumerate(case.runs):
        motion = estimate(case, run)
        for f, (begin, end) in _stances(run, motion):
            count = min(max(2, int((end - begin - 2 * EDGE) / EVERY) + 1), MOST)
            wanted = np.unique(np.searchsorted(motion.time, np.linspace(begin + EDGE, end - EDGE, count)))
            moments = [int(n) for n in wanted if n < len(motion.time) and motion.good[n]]
            if len(moments) >= 2:
                touch, near = feet.touch(r, f, motion, moments)
                found.lost += not near
                found.items += [touch] if touch is not None else []
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


def underside(model: MjModel, body: str) -> list[Part]:
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
            vertices, _ = mesh_of(model, model.geom_dataid[g])
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
        else:  # an ellipsoid: points spread by Fibonacci's spiral
            k = np.arange(200) + 0.5
            up, around = 1 - k / 100, np.pi * (1 + 5**0.5) * k
            flat = np.sqrt(1 - up * up)
            found.append(Part(g, np.column_stack([flat * np.cos(around), flat * np.sin(around), up]) * size))
    return found


@dataclass(frozen=True)
class Part:
    """Points of a geom that may touch the ground, in its frame; with a radius, the centres of balls."""

    geom: int
    points: F64
    radius: float = 0.0

    def world(self, data: MjData) -> F64:
        """(P, 3) m: of balls, points of their lower halves, the lowest among them."""
        found = self.points @ data.geom_xmat[self.geom].reshape(3, 3).T + data.geom_xpos[self.geom]
        if not self.radius:
            return found
        return (found[:, None] + self.radius * _BOWL).reshape(-1, 3)


def _bowl() -> F64:
    """(P, 3) of the lower half of the unit sphere: its lowest point, and rings around it."""
    turn, low = np.meshgrid(np.linspace(0, 2 * np.pi, 8, endpoint=False), np.radians([12, 30, 50, 75]))
    rings = np.stack([np.sin(low) * np.cos(turn), np.sin(low) * np.sin(turn), -np.cos(low)], axis=-1)
    return np.asarray(np.vstack([[[0.0, 0.0, -1.0]], rings.reshape(-1, 3)]), dtype=np.float64)


_BOWL = _bowl()


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


class _Feet:
    """The feet of a robot over a terrain, at moments of its log."""

    def __init__(self, case: Case, terrain: Terrain) -> None:
        import mujoco

        self.case, self.terrain = case, terrain
        self.model = case.spec.copy().compile()
        self.data = mujoco.MjData(self.model)
        self.bodies = [self.model.body(name).id for name in case.contact_bodies]
        self.parts = [underside(self.model, name) for name in case.contact_bodies]
        self.weight = 9.81 * float(self.model.body_subtreemass[0])
        """N"""
        free = int(np.flatnonzero(self.model.jnt_type == 0)[0])
        self.base, self.base_dof = int(self.model.jnt_qposadr[free]), int(self.model.jnt_dofadr[free])

    def touch(self, r: int, f: int, motion: Motion, moments: Sequence[int]) -> tuple[Touch | None, bool]:
        """(a contact of a run's foot on its most usual foothold, or None where it hardly bears load, whether a top is
        near)."""
        import mujoco

        model, data, run = self.model, self.data, self.case.runs[r]
        rows: list[tuple[float, ...]] = []
        holds: list[tuple[str, int]] = []
        places: dict[str, tuple[F64, float]] = {}
        slid, before = np.zeros(2), None
        for n in moments:
            time = float(motion.time[n])
            lacking = needed_force(model, data, motion, n) - drive_force(self.case, model, data, run, time)
            data.qpos[:], data.qvel[:] = motion.qpos[n], motion.qvel[n]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            height, geom, low = clearance(self.terrain, data, self.parts[f])
            if geom < 0:
                continue
            push = self.forces(run, time, lacking).get(f, np.full(3, np.nan))
            body = self.bodies[f]
            now = _Sole(time, data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy(), low)
            step = np.zeros(2) if before is None else now.moved_since(before)
            speed = 0.0 if before is None else float(np.linalg.norm(step)) / (now.time - before.time)
            slid, before = slid + step, now
            if not push[2] > LOADED * self.weight:
                continue
            name, middle, _ = self.terrain.foothold(geom, low)
            holds.append((name, geom))
            places[name] = middle, float(low[2] - height)
            arm = low[:2] - motion.qpos[n][self.base : self.base + 2]
            rows.append((time, height, *(low[:2] - middle), *arm, push[2], *-push[:2], *slid, speed))
        usual = max(set(holds), key=holds.count, default=("", -1))
        a = np.array([row for row, hold in zip(rows, holds, strict=True) if hold == usual])
        if len(a) < 2:
            return None, before is not None
        middle, top = places[usual[0]]
        return Touch(
            r, f, *usual, time=a[:, 0], height=a[:, 1], middle=middle, top=top, place=a[:, 2:4], arm=a[:, 4:6],
            load=a[:, 6], shear=a[:, 7:9], slid=a[:, 9:11] - a[0, 9:11], speed=a[:, 11],
        ), True  # fmt: skip

    def forces(self, run: Run, when: float, lacking: F64) -> dict[int, F64]:
        """Foot -> (3,) N that the ground pushes it with, from what the joints' rows lack; the base's only steady it."""
        import mujoco

        contact = run.signals["contact"][int(np.argmin(np.abs(run.time - when)))]
        feet = [f for f in range(len(self.bodies)) if not contact[f] <= 0.5]
        rows = []
        for f in feet:
            world = np.vstack([part.world(self.data) for part in self.parts[f]])
            jac = np.zeros((3, self.model.nv))
            mujoco.mj_jac(self.model, self.data, jac, None, world[int(np.argmin(world[:, 2]))], self.bodies[f])
            rows.append(jac)
        if not rows:
            return {}
        J = np.vstack(rows)
        sigma = np.full(self.model.nv, 0.3)
        sigma[self.base_dof : self.base_dof + 6] = 0.1 * self.weight
        known = np.isfinite(lacking)
        A = np.vstack([(J.T / sigma[:, None])[known], np.eye(len(J)) / (3 * self.weight)])
        b = np.concatenate([(lacking / sigma)[known], np.zeros(len(J))])
        return dict(zip(feet, np.linalg.lstsq(A, b, rcond=None)[0].reshape(-1, 3), strict=True))


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
        kept = (sole.axes.T @ (sole.low - sole.origin) for sole in (before, self))
        steps = [self.origin + self.axes @ own - (before.origin + before.axes @ own) for own in kept]
        return np.mean(steps, axis=0)[:2]


def clearance(terrain: Terrain, data: MjData, points: list[Part]) -> tuple[float, int, F64]:
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
