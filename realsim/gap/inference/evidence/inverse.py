"""What the nominal model's equations of motion lack: a torque at a joint, a wrench at a floating base.

Both come from inverse dynamics along the motion estimated from the log, so nothing is simulated and no error adds up.

- Joints (fixed base, torque logged): logged torque minus the torque that the nominal model needs for this motion.
- Base (floating, with its pose): the six rows that no motor acts on. Contact forces are taken from the legs' torques
  through the legs' own rows, so what is missing in the base's rows is a payload, a push or a wrong mass, while joint
  effects stay in the legs' rows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.statistics import interval90, resampled
from realsim.core.types import F64, Bool, MjData, MjModel
from realsim.gap.case.case import Case, Run
from realsim.gap.case.model.edit import Edit
from realsim.gap.case.motion import Motion, blur, estimate
from realsim.gap.simulation.simulate import Simulator

SPACING = 0.02
"""Seconds between the states that are looked at."""
BLOCK = 25
"""States in a block of the bootstrap: half a second."""
NEAR_GROUND = 0.02
"""m below which a body counts as touching, where contacts were not logged."""
AT_STOP = 0.01
"""rad or m from a joint's stop, inside or beyond: there the stop bears an unknown part of the torque."""
LEAST_EXPLAINED = 0.3
"""Share of a residual that a term must explain to be named."""
GRAVITY = 9.81


@dataclass(frozen=True)
class TorqueResidual:
    """Torque that the nominal model does not explain, of the J joints whose torque was logged away from their stops."""

    joints: tuple[str, ...]
    velocity: F64
    """(N, J) rad/s"""
    residual: F64
    """(N, J) N m: logged minus needed; NaN where the joint is at a stop, or in a run without its torque."""
    rms: F64
    """(J,) of the residual."""
    share: F64
    """(J,) of the logged torque's mean square."""
    undriven: F64
    """(J,) share of the torque's variance that the motion does not ask for, friction and a gain allowed."""
    terms: tuple[dict[str, Any], ...]
    """By joint: the term that explains most of the residual, {what, value, unit, explains}."""


@dataclass(frozen=True)
class BaseWrench:
    """Mean wrench that the base lacks: force in world axes (N), torque in the base's axes (N m)."""

    mean: F64
    """(6,)"""
    ci90: F64
    """(6, 2) by block bootstrap."""
    mass: float
    """kg that the vertical force would weigh; positive if the robot is heavier than the model."""


def torque_residual(simulator: Simulator) -> TorqueResidual | None:
    """None for a floating base (its contact forces are unknown), or where no torque was logged away from the stops."""
    case = simulator.case
    if case.floating or not (case.command_kind == "torque" or _measured(case)):
        return None
    import mujoco

    model = case.model
    dofs = [int(model.joint(n).dofadr[0]) for n in case.joint_names]
    velocity, change, residual, logged, phases = [], [], [], [], []
    for run in case.runs:
        model = Edit(simulator.context).compiled(run.setup)
        data = mujoco.MjData(model)
        motion = estimate(case, run, blur)
        logged_torque = _torque(case, run)
        torque = blur(motion.time, run.time, logged_torque)[0]
        torque[:, ~np.isfinite(logged_torque).any(axis=0)] = np.nan  # a joint without a sensor
        phase = _phase(case, run, motion)
        for n in _picked(motion):
            needed = needed_force(model, data, motion, n)[dofs]
            phases.append(phase[n])
            velocity.append(motion.qvel[n, dofs])
            change.append(motion.qacc[n, dofs])
            residual.append(np.where(at_stop(model, motion.qpos[n])[dofs], np.nan, torque[n] - needed))
            logged.append(torque[n])
    if len(residual) < 20:
        return None
    known = np.flatnonzero(np.isfinite(residual).any(axis=0))
    if not len(known):
        return None
    v, a, r, t, p = (np.take(x, known, axis=1) for x in (velocity, change, residual, logged, phases))
    free = np.isfinite(r)
    count = free.sum(axis=0)
    rms = np.sqrt(np.nansum(r**2, axis=0) / count)
    share = rms**2 / np.maximum(np.where(free, t**2, 0.0).sum(axis=0) / count, 1e-12)
    terms = tuple(_term(v[:, j], a[:, j], t[:, j], r[:, j], p[:, j]) for j in range(r.shape[1]))
    undriven = np.array([_undriven(v[:, j], t[:, j], r[:, j]) for j in range(r.shape[1])])
    return TorqueResidual(tuple(case.joint_names[j] for j in known), v, r, rms, share, undriven, terms)


def _undriven(v: F64, torque: F64, residual: F64) -> float:
    """Share of the torque's variance that needed torque, Coulomb and viscous friction and a constant leave."""
    good = np.isfinite(residual)
    y = torque[good]
    if good.sum() < 20 or np.var(y) < 1e-12:
        return 0.0
    X = np.column_stack([y - residual[good], np.sign(v[good]), v[good], np.ones(len(y))])
    return _left(X, y)[0] / float(np.sum((y - y.mean()) ** 2))


def _measured(case: Case) -> bool:
    return case.has("joint_torque") and case.torque_kind != "none"


def _torque(case: Case, run: Run) -> F64:
    """(T, J) of the drives, N m: measured, or commanded where no torque is; NaN for joints without a drive."""
    if _measured(case):
        return run.signals["joint_torque"]
    found = np.full(run.signals["joint_pos"].shape, np.nan)
    for j, joint in enumerate(case.joint_names):
        name = case.actuator_of(joint)
        if name is not None:
            u = case.actuator_names.index(name)
            found[:, j] = case.command_torque(joint) * run.command[:, u] * run.on[:, u]
    return found


def _phase(case: Case, run: Run, motion: Motion) -> F64:
    """(N, J) what a position servo's torque changes by within one held command, N m.

    A log has the torque of one instant between two commands, nobody says which; the mean lies up to half of this off.
    """
    found = np.zeros((len(motion.time), len(case.joint_names)))
    if case.command_kind == "position":
        rate = blur(motion.time, run.time, run.command)[1]
        step = float(motion.time[1] - motion.time[0])
        for j, joint in enumerate(case.joint_names):
            servo = case.actuator_of(joint)
            if servo is not None:
                found[:, j] = case.command_torque(joint) * step * rate[:, case.actuator_names.index(servo)]
    return found


def _term(v: F64, a: F64, torque: F64, residual: F64, phase: F64) -> dict[str, Any]:
    """The one regressor that explains most of a joint's residual; states near rest say nothing about friction."""
    moving = (np.abs(v) > 0.03 * np.abs(v).max(initial=1e-9)) & np.isfinite(residual)
    rivals = {
        "against the velocity, of constant size": (np.sign(v), "N m"),
        "in proportion to the velocity": (v, "N m s/rad"),
        "in proportion to the acceleration": (a, "kg m^2"),
        "in proportion to the torque": (torque, "ratio"),
        "constant": (np.ones_like(v), "N m"),
    }
    best: dict[str, Any] = {"what": "none of these", "value": 0.0, "unit": "N m", "explains": 0.0}
    y, p = residual[moving], phase[moving, None]
    total, _ = _left(p, y)
    for what, (x, unit) in rivals.items():
        left, weights = _left(np.column_stack([x[moving], p]), y)
        explains = 1 - left / max(total, 1e-12)
        if explains > max(best["explains"], LEAST_EXPLAINED):
            best = {"what": what, "value": float(weights[0]), "unit": unit, "explains": explains}
    return best


def _left(X: F64, y: F64) -> tuple[float, F64]:
    """(sum of squares that a linear fit leaves, its weights)."""
    weights: F64 = np.asarray(np.linalg.lstsq(X, y, rcond=None)[0], dtype=np.float64)
    return float(np.sum((y - X @ weights) ** 2)), weights


def base_wrench(simulator: Simulator, seed: int = 0) -> BaseWrench | None:
    """None without a floating base whose pose was logged, or where the feet are hardly ever on the ground."""
    case = simulator.case
    if not (case.floating and case.has("base_pos") and case.has("base_quat")):
        return None
    import mujoco

    model = case.spec.copy().compile()
    model.geom_margin[:] = model.geom_margin + NEAR_GROUND
    data = mujoco.MjData(model)
    blocks = []
    for run in case.runs:
        motion = estimate(case, run)  # the servos' law needs positions without bias
        states = [w for n in _picked(motion) if (w := _lacking(case, model, data, run, motion, n)) is not None]
        blocks += [np.mean(states[i : i + BLOCK], axis=0) for i in range(0, len(states) - BLOCK // 2, BLOCK)]
    if len(blocks) < 4:
        return None
    found = np.array(blocks)
    mean, ends = found.mean(axis=0), interval90(resampled(found, 400, seed).mean(axis=1)).T
    return BaseWrench(mean, ends, float(-mean[2] / GRAVITY))


def _lacking(case: Case, model: MjModel, data: MjData, run: Run, motion: Motion, n: int) -> F64 | None:
    """(6,) wrench missing in the base's rows at one state, or None if nothing touches the ground."""

    joint = int(np.flatnonzero(model.jnt_type == 0)[0])
    base = slice(int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[joint]) + 6)
    needed = needed_force(model, data, motion, n)
    J = _contact_rows(case, model, data, run, float(motion.time[n]))
    if J is None:
        return None
    driven = drive_force(case, model, data, run, float(motion.time[n]))
    unknown = ~np.isfinite(driven)
    driven[unknown] = 0.0
    rest = needed - driven
    weight = GRAVITY * float(model.body_subtreemass[0])
    # The legs' rows fix the contact forces; the base's rows are trusted only as far as a wrench of half the weight
    # might be missing there, and no contact force is likely to be much larger than the weight.
    sigma = np.full(model.nv, 0.0)
    sigma[:] = 0.2 + 0.05 * np.abs(driven)
    sigma[base] = 0.5 * weight
    sigma[at_stop(model, motion.qpos[n]) | unknown] = weight  # what a stop, or a drive without a sensor, bears
    A = np.vstack([J.T / sigma[:, None], np.eye(len(J)) / (3 * weight)])
    b = np.concatenate([rest / sigma, np.zeros(len(J))])
    force = np.linalg.lstsq(A, b, rcond=None)[0]
    return np.asarray((rest - J.T @ force)[base])


def needed_force(model: MjModel, data: MjData, motion: Motion, n: int) -> F64:
    """(nv,) generalised force that the model needs for a state and its acceleration, without contacts or stops."""
    import mujoco

    flags = int(model.opt.disableflags)
    outside = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.disableflags = flags | int(outside)
    try:
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.qpos[n], motion.qvel[n], motion.qacc[n]
        mujoco.mj_inverse(model, data)
    finally:
        model.opt.disableflags = flags
    return np.array(data.qfrc_inverse)


def at_stop(model: MjModel, qpos: F64) -> Bool:
    """(nv,) whether a hinge or slide is at the end of its range."""
    found = np.zeros(model.nv, bool)
    ends = model.jnt_limited.astype(bool) & (model.jnt_type >= 2)  # mjJNT_SLIDE, mjJNT_HINGE
    q, (low, high) = qpos[model.jnt_qposadr[ends]], model.jnt_range[ends].T
    found[model.jnt_dofadr[ends]] = (q < low + AT_STOP) | (q > high - AT_STOP)
    return found


def drive_force(case: Case, model: MjModel, data: MjData, run: Run, when: float) -> F64:
    """(nv,) of the drives: the logged torque if torques were measured, else the servos' law at the logged state.

    NaN for a joint whose torque this run does not have.
    """
    import mujoco

    if case.has("joint_torque") and case.torque_kind == "measured":
        force = np.zeros(model.nv)
        for j, name in enumerate(case.joint_names):
            force[model.joint(name).dofadr[0]] = _at(when, run.time, run.signals["joint_torque"][:, j])
        return force
    at = int(np.clip(np.searchsorted(run.time, when, side="right") - 1, 0, len(run.time) - 1))
    for u, name in enumerate(case.actuator_names):
        data.ctrl[model.actuator(name).id] = run.command[at, u]
    mujoco.mj_forward(model, data)
    force = np.array(data.qfrc_actuator)
    for joint in case.joint_names:
        servo = case.actuator_of(joint)
        if servo is not None and not run.on[at, case.actuator_names.index(servo)]:
            force[model.joint(joint).dofadr[0]] = 0.0
    return force


def _contact_rows(case: Case, model: MjModel, data: MjData, run: Run, when: float) -> F64 | None:
    """(K, nv): three rows for each body that touches, at the middle of its contacts, and three more for a flat foot."""
    import mujoco

    mujoco.mj_fwdPosition(model, data)
    points: dict[int, list[F64]] = {}
    for contact in data.contact:
        bodies = [int(model.geom_bodyid[g]) for g in contact.geom]
        moving = [b for b in bodies if model.body_weldid[b] != 0]
        if len(moving) == 1:
            points.setdefault(moving[0], []).append(np.array(contact.pos))
    if "contact" in run.signals:
        at = int(np.argmin(np.abs(run.time - when)))
        touching = {
            model.body(b).id for b, c in zip(case.contact_bodies, run.signals["contact"][at], strict=True) if c > 0.5
        }
        points = {b: p for b, p in points.items() if b in touching}
    rows = []
    for body, where in points.items():
        place, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, place, turn, np.mean(where, axis=0), body)
        rows.append(place)
        if len(where) >= 3:
            rows.append(turn)
    return np.vstack(rows) if rows else None


def _picked(motion: Motion) -> list[int]:
    step = max(1, round(SPACING / float(motion.time[1] - motion.time[0])))
    edge = max(3, round(0.05 / float(motion.time[1] - motion.time[0])))  # derivatives are poor at the ends
    return [n for n in range(edge, len(motion.time) - edge, step) if motion.good[n]]


def _at(when: float, time: F64, column: F64) -> float:
    """A column between its finite samples; NaN where it has none."""
    finite = np.isfinite(column)
    return float(np.interp(when, time[finite], column[finite])) if finite.any() else np.nan
