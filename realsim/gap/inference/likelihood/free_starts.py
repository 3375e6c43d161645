"""What a comparison leaves free: the states that the parts of a replay begin in, and what pushes a robot in the air.

A drone's controller answers gusts, its own wake and the drag of its rotors, none of which a log has. Within a part of a
replay such a push is as steady as a cause is, but it differs from second to second, and a cause does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from realsim.core.types import F64, Bool, MjModel
from realsim.gap.case.model.context import base_body
from realsim.gap.case.model.edit import Edit, put
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.anchors import SMALL
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.state import Anchor, Start

STEADY = 1.0
"""s within which a push is taken as one. On four flights of two Crazyflies torques that turn nothing are slower than
2 Hz; lag and delay of the motors, which a fit must see, act faster. Not tuned."""
ANSWERED = 0.05
"""s after which a controller answers a push. Not tuned."""
LEAST_PUSHES = 6
"""Fewer say nothing of their spread. Not tuned."""


def free_starts(simulator: Simulator, comparison: Comparison) -> None:
    """Let a comparison fit the states that the log gave, which noise is in, of every part of a run; of a robot that
    flies, expect pushes in each as they differ from second to second."""
    parted = any(start.anchors for start in simulator.starts)
    runs = [i for i, start in enumerate(simulator.starts) if parted and start.moving]
    if not runs:
        return
    base, plain = simulator.simulate(runs=runs), Edit(simulator.context)
    parts = [
        np.searchsorted([a.time for a in simulator.starts[i].anchors], comparison.times[i], side="right") for i in runs
    ]

    def change(edit: Edit, starts: Sequence[Start] | None = None) -> list[F64]:
        raw = simulator.roll_out(edit, list(runs), starts=starts)
        read = [simulator.read(simulator.case.runs[i], r, plain) for i, r in zip(runs, raw, strict=True)]
        return [(y - y0) / SMALL for y, y0 in zip(read, base, strict=True)]

    model = simulator.case.model
    moved = [
        change(plain, [_aside(model, simulator.starts[i], dof) for i in runs]) for dof in range(2 * model.nv)
    ]  # fmt: skip
    for k, i in enumerate(runs):
        comparison.free_starts(i, np.stack([columns[k] for columns in moved], axis=2), parts[k])
    if simulator.case.floating and not simulator.context.driven:
        pushed = [change(_pushed(simulator, axis)) for axis in range(6)]
        slopes = [np.stack([columns[k] for columns in pushed], axis=2) for k in range(len(runs))]
        answers = [change(_louder(simulator)), change(_later(simulator))]
        _expect_pushes(simulator, comparison, runs, parts, base, slopes, list(zip(*answers, strict=True)))


@dataclass(frozen=True)
class _Second:
    """What acts in some STEADY seconds of a run, as pushes along six axes, m/s2 and rad/s2."""

    later: bool
    """Whether the run is of the later one of two logs: what changed between them is no push."""
    push: F64
    """(6,) that explain the residual best."""
    commanded: F64
    """(6,) what the robot was commanded."""
    noise: F64
    """(6,) variance of the push by the floor."""
    parts: int
    """Parts of the replay in them."""


def _expect_pushes(
    simulator: Simulator,
    comparison: Comparison,
    runs: Sequence[int],
    parts: Sequence[Any],
    base: Sequence[F64],
    slopes: Sequence[F64],
    answers: Sequence[tuple[F64, ...]],
) -> None:
    """Expect pushes as large as they differ from second to second, and that the controller's answers to them hide how
    the robot answers its commands: a torque against a gust turns nothing, as if the robot were heavy or late.

    Args:
        slopes: (T, C, 6) a run, of a push along each axis.
        answers: (T, C) a run each, of all that actuators give, in shares, and of a delay, s.
    """
    found: list[_Second] = []
    each = list(zip(runs, parts, base, slopes, answers, strict=True))
    for i, part, y, columns, (louder, _) in each:
        if i not in simulator.known:
            continue
        sides = [comparison.residual(i, y), comparison.change(i, y + louder, y)]
        second, later = (comparison.times[i] / STEADY).astype(int), simulator.case.runs[i].setup.later
        for rows in (second == k for k in np.unique(second)):
            best, covariance = _as_pushes(comparison, i, y, columns, sides, rows)
            found.append(_Second(later, best[:, 0], best[:, 1], np.diag(covariance), len(np.unique(part[rows]))))
    if len(found) < LEAST_PUSHES:
        return
    noise = np.median([s.noise for s in found], axis=0)
    variance = np.maximum(_variance([s.push for s in found], found) - noise, 0.0)
    turns = _variance([s.commanded for s in found], found)[3:].sum()
    hidden = min(float(np.sqrt(variance[3:].sum() / max(turns, 1e-12))), 1.0)
    # Parts within such a time share their push: as if each had its own, of so much more.
    spread = np.sqrt(variance * np.median([s.parts for s in found]))
    for i, part, y, columns, answer in each:
        sides = [comparison.change(i, y + a, y) for a in answer]
        mean, _ = _as_pushes(comparison, i, y, columns, sides, np.ones(len(part), bool))
        comparison.expect(i, columns * spread, part)
        unsteady = np.stack(answer, axis=2) - columns @ mean
        comparison.expect(i, unsteady * hidden * (1.0, ANSWERED), np.zeros(len(part), int))


def _variance(values: Sequence[F64], found: Sequence[_Second]) -> F64:
    """(6,) about the median of each log, by the median deviation: a run may have a blow in it."""
    whole, later = np.array(values), np.array([s.later for s in found])
    for log in np.unique(later):
        whole[later == log] -= np.median(whole[later == log], axis=0)
    return np.asarray(np.square(1.4826 * np.median(np.abs(whole), axis=0)))


def _as_pushes(
    comparison: Comparison, run: int, y: F64, slopes: F64, sides: Sequence[F64], rows: Bool
) -> tuple[F64, F64]:
    """((6, K) pushes that explain each of K (B, C) in some bins best, (6, 6) covariance by the floor)."""
    push = np.stack([comparison.change(run, y + slopes[:, :, k], y) for k in range(slopes.shape[2])], axis=2)
    wanted = np.stack(sides, axis=2)
    known = rows[:, None] & np.isfinite(wanted).all(axis=2)
    G, w = push[known], (1.0 / comparison.floor(run))[known][:, None]
    covariance: F64 = np.asarray(np.linalg.pinv(G.T @ (w * G)), np.float64)
    return np.asarray(covariance @ (G.T @ (w * wanted[known]))), covariance


def _louder(simulator: Simulator) -> Edit:
    """All that the actuators give is more by a share of SMALL."""
    edit = Edit(simulator.context)
    for name in simulator.case.actuator_names:
        edit.scale_drive(name, 1 + SMALL)
    return edit


def _later(simulator: Simulator) -> Edit:
    """Commands are SMALL s late."""
    edit = Edit(simulator.context)
    edit.signals.command_delay = SMALL
    return edit


def _pushed(simulator: Simulator, axis: int) -> Edit:
    """A push of SMALL m/s2, or from axis 3 on rad/s2, along an axis of the base's frame, about its centre of mass."""
    import mujoco

    case, edit = simulator.case, Edit(simulator.context)
    body = edit.spec.body(case.model.body(base_body(case)).name)
    mass, com, inertia = edit.inertia_of(body)
    body.add_site(name="rs_push", pos=com)
    size = mass if axis < 3 else inertia[axis - 3, axis - 3]
    actuator = edit.spec.add_actuator(
        name="rs_push", target="rs_push", trntype=mujoco.mjtTrn.mjTRN_SITE, gear=np.eye(6)[axis] * size * SMALL
    )
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    put(actuator, "gainprm", 0, 0.0)
    put(actuator, "biasprm", 0, 1.0)
    return edit


def _aside(model: MjModel, start: Start, dof: int) -> Start:
    """All parts begun a little aside in one position, or from nv on one speed."""
    import mujoco

    step = np.zeros(2 * model.nv)
    step[dof] = SMALL

    def moved(qpos: F64, qvel: F64) -> tuple[F64, F64]:
        there = qpos.copy()
        mujoco.mj_integratePos(model, there, step[: model.nv], 1.0)
        return there, qvel + step[model.nv :]

    anchors = tuple(Anchor(a.time, *moved(a.qpos, a.qvel)) for a in start.anchors)
    if start.qpos is None or start.qvel is None:
        return replace(start, anchors=anchors)
    qpos, qvel = moved(start.qpos, start.qvel)
    return replace(start, qpos=qpos, qvel=qvel, anchors=anchors)
