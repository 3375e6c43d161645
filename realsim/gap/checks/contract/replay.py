"""Observations -> actions -> targets, as the contract says or as a mistake would have it. All steps of a run at once.

The action before is what was sent before, turned back: so an error of one step does not grow along the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.types import F64
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.steps import Run, Steps


@dataclass(frozen=True)
class Mistake:
    """Differences of a loop from the contract. The default is none."""

    see: tuple[int, ...] | None = None
    """Joint of the policy whose place the reading of joint i takes: the order in which joints are seen."""
    send: tuple[int, ...] | None = None
    """The order in which targets are sent."""
    see_sign: F64 | None = None
    send_sign: F64 | None = None
    see_offset: F64 | None = None
    """(J,) rad added to the positions that are seen."""
    send_offset: F64 | None = None
    gain: float = 1.0
    """On the action scale."""
    gravity: str = "body"
    """`body`, `negated`, `world` (not turned into the body), `turned` (by the inverse), `xyzw` (the order misread)."""
    rates: str = "body"
    """Angular velocity: `body`, `world`, `deg`."""
    speeds: float = 1.0
    """On the joint velocities that are seen."""
    told: str = "given"
    """The velocity command: `given`, `zero`, `negated` (yaw and left)."""
    newest_first: bool = False
    by_time: bool = False
    """History as whole observations, oldest first, instead of term by term."""
    length: int | None = None
    """Moments that the history really holds; the older ones repeat the oldest."""
    late: int = 0
    """Policy steps by which what is seen is old."""
    clip: float | None = None
    last: str = "action"
    """The last action that is seen: `action`, `zero`, `target` (the joint target), `clipped`."""


def targets(contract: Contract, steps: Steps, mistake: Mistake) -> list[F64]:
    """(K, J) targets of every run in the log's order of joints."""
    return [_of_run(contract, steps, run, mistake) for run in steps.runs]


def _of_run(contract: Contract, steps: Steps, run: Run, m: Mistake) -> F64:
    order = [steps.joints.index(j) for j in contract.joints]  # the policy's joint i is the log's order[i]
    before = _last_action(contract, run.command[:, order], m)
    pos, vel = run.pos[:, order], run.vel[:, order]
    if m.see_sign is not None:
        pos, vel = pos * m.see_sign, vel * m.see_sign
    if m.see_offset is not None:
        pos = pos + m.see_offset
    if m.see is not None:
        pos, vel = pos[:, list(m.see)], vel[:, list(m.see)]
    now = {
        "ang_vel": _rates(run, m), "gravity": _gravity(run, m), "command": _told(run, m),
        "joint_pos": pos - contract.default, "joint_vel": vel * m.speeds, "last_action": before,
    }  # fmt: skip
    rows = []
    for term in contract.terms:
        values = now[term.kind] * term.scale
        if m.late and term.kind not in ("last_action", "command"):
            values = _earlier(values, m.late)
        rows.append(_history(values, term.history, m))
    action = contract.run(_vector(rows, m)) if len(rows) else np.zeros((len(pos), len(contract.joints)))
    limit = m.clip if m.clip is not None else contract.clip
    if limit is not None:
        action = np.clip(action, -limit, limit)
    if m.send_sign is not None:
        action = action * m.send_sign
    wanted = contract.default + m.gain * contract.scale * action
    if m.send_offset is not None:
        wanted = wanted + m.send_offset
    if m.send is not None:  # targets are handed to the wrong motors, default pose and all
        wanted = wanted[:, list(m.send)]
    out = np.empty_like(wanted)
    out[:, order] = wanted
    return out


def _last_action(contract: Contract, sent: F64, m: Mistake) -> F64:
    """(K, J) what the policy is shown as its last action: zeros before the first step."""
    if m.last == "zero":
        return np.zeros_like(sent)
    if m.last == "target":
        return np.concatenate([np.zeros_like(sent[:1]), sent[:-1]])
    if m.send is not None:
        back = np.empty_like(sent)
        back[:, list(m.send)] = sent
        sent = back
    action = sent - contract.default
    if m.send_offset is not None:
        action = action - m.send_offset
    action = action / (m.gain * contract.scale)
    if m.send_sign is not None:
        action = action * m.send_sign
    return np.concatenate([np.zeros_like(action[:1]), action[:-1]])


def _rates(run: Run, m: Mistake) -> F64:
    if m.rates == "deg":
        return np.degrees(run.gyro)
    return _turn(run.quat, run.gyro) if m.rates == "world" else run.gyro


def _gravity(run: Run, m: Mistake) -> F64:
    down = np.tile([0.0, 0.0, -1.0], (len(run.quat), 1))
    if m.gravity == "world":
        return down
    if m.gravity == "turned":
        return _turn(run.quat, down)
    quat = run.quat[:, [3, 0, 1, 2]] if m.gravity == "xyzw" else run.quat
    body = _turn(quat * [1, -1, -1, -1], down)
    return -body if m.gravity == "negated" else body


def _told(run: Run, m: Mistake) -> F64:
    if m.told == "zero":
        return np.zeros_like(run.told)
    return run.told * [1, -1, -1] if m.told == "negated" else run.told


def _turn(quat: F64, v: F64) -> F64:
    """(K, 3) vectors rotated by unit quaternions w x y z."""
    w, u = quat[:, :1], quat[:, 1:]
    t = 2 * np.cross(u, v)
    return np.asarray(v + w * t + np.cross(u, t))


def _earlier(values: F64, steps: int) -> F64:
    return values[np.clip(np.arange(len(values)) - steps, 0, None)]


def _history(values: F64, length: int, m: Mistake) -> F64:
    """(K, length, W), oldest first; before the first moment there was the first moment."""
    held = length if m.length is None else min(m.length, length)
    back = np.minimum(np.arange(length)[::-1], held - 1)
    index = np.clip(np.arange(len(values))[:, None] - back[None], 0, None)
    rows = values[index]
    return rows[:, ::-1] if m.newest_first else rows


def _vector(rows: Sequence[F64], m: Mistake) -> F64:
    if m.by_time and len({r.shape[1] for r in rows}) == 1:
        return np.concatenate(rows, axis=2).reshape(len(rows[0]), -1)
    return np.concatenate([r.reshape(len(r), -1) for r in rows], axis=1)
