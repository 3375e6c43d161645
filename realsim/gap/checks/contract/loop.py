"""The loop on the robot as parameters: observations -> actions -> targets, all steps of a run at once.

The default is the contract. The action before is what was sent before, turned back: so an error of one step does not
grow along the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from realsim.core.types import F64, Bool
from realsim.gap.checks.contract.policy import Camera, Contract, Term
from realsim.gap.checks.contract.steps import Run, Steps, turn

SENSORS = ("ang_vel", "gravity", "lin_vel", "joint_pos", "joint_vel")
WINDOW = 10
"""Policy steps (a fifth of a second) for which an input that is not logged is taken to be constant."""


REPLAYS, SETTLED, AT_LIMIT = 16, 3e-3, 1e-6
"""Rounds at most in which last actions that limits cut off are replayed, each a call of the policy; by how much (rms)
the last one still changes them; and nearness to a limit. The second was set on one log of the policy with a camera
(half the time, 2.5 to 2.6 % left)."""


@dataclass(frozen=True)
class Loop:
    """How a loop really runs. Matrices act from the left on columns in the policy's order of joints."""

    mix: Mapping[str, F64] = field(default_factory=dict)
    """Kind of a term -> (W, W) on what is seen: its scale, signs, order, or the rotation of its sensor."""
    shift: Mapping[str, F64] = field(default_factory=dict)
    """Kind of a term -> (W,) added to what is seen."""
    age: Mapping[str, float] = field(default_factory=dict)
    """Kind of a term -> policy steps by which it is older than the log has it."""
    source: Mapping[str, str] = field(default_factory=dict)
    """Kind of a term -> what else is shown in its place; see `_now`."""
    terms: tuple[int, ...] | None = None
    """The order in which the terms are put together."""
    newest_first: bool = False
    by_time: bool = False
    """History as whole observations, oldest first, instead of term by term."""
    length: int | None = None
    """Moments that the history really holds; the older ones repeat the oldest."""
    skipped: int = 1
    """Policy steps between two moments of the history."""
    clip: float | None = None
    gain: F64 | float = 1.0
    """(J,) on the scaled actions."""
    sent: F64 | float = 0.0
    """(J,) rad added to the targets."""
    order: tuple[int, ...] | None = None
    """Whose target each joint is sent."""
    bounds: tuple[F64 | float, F64 | float] = (-np.inf, np.inf)
    """(J,) and (J,) rad at which targets end."""
    alpha: float | None = None
    """Of the low pass between actions and what is sent; None: the contract's."""
    unaware: bool = False
    """Whether the policy is shown its own last actions, of which such limits leave less in the log."""
    stale: tuple[F64, ...] | None = None
    """Of every run (K,) policy steps by which all sensors are older in a row."""

    def with_entries(self, field: str, entries: Mapping[str, Any]) -> Loop:
        """With entries added to one of its maps."""
        whole: dict[str, Any] = {field: {**getattr(self, field), **entries}}
        return replace(self, **whole)

    def mixed(self, kinds: Sequence[str], W: F64) -> Loop:
        """`W` (n, n) on top of what these terms are mixed with and shifted by."""
        loop = self.with_entries("mix", {k: W @ self.mix.get(k, np.eye(len(W))) for k in kinds})
        return loop.with_entries("shift", {k: W @ self.shift[k] for k in kinds if k in self.shift})

    def shifted(self, kind: str, by: F64) -> Loop:
        """A term shifted further."""
        return self.with_entries("shift", {kind: self.shift.get(kind, 0.0) + by})

    def sent_to(self, order: tuple[int, ...]) -> Loop:
        """Targets handed to the motors in this order on top of the loop's own."""
        return replace(self, order=order if self.order is None else tuple(self.order[i] for i in order))


def targets(contract: Contract, steps: Steps, loop: Loop) -> list[F64]:
    """(K, J) targets of every run in the policy's order of joints."""
    return [_of_run(contract, steps, k, loop) for k in range(len(steps.runs))]


def commands(contract: Contract, steps: Steps) -> list[F64]:
    """(K, J) rad sent in every run, in the policy's order of joints."""
    order = [steps.joints.index(j) for j in contract.joints]
    return [run.command[:, order] for run in steps.runs]


def _of_run(contract: Contract, steps: Steps, which: int, loop: Loop) -> F64:
    run = steps.runs[which]
    order = [steps.joints.index(j) for j in contract.joints]
    sent = run.command[:, order]
    shown = sent if loop.source.get("last_action") == "filtered" else _before_filter(contract, sent, loop)
    action = actions(contract, shown if loop.order is None else shown[:, np.argsort(loop.order)], loop)
    cut = _cut(sent, action, loop)
    for _ in range(REPLAYS if loop.unaware else 0):  # each carries what was cut off one step on
        own = contract.run(_vector(_parts(contract, steps, which, loop, action), loop), run.images)
        before, action = action, np.where(cut, own, action)
        if np.sqrt(np.mean((action - before) ** 2)) < SETTLED:
            break
    parts = _parts(contract, steps, which, loop, action)
    if run.commanded is None and any(t.kind == "command" for t in contract.terms):
        return _with_unknown(contract, sent, parts, run.images, loop, "command")
    return _targets(contract, sent, parts, run.images, loop)


def _alpha(contract: Contract, loop: Loop) -> float:
    return contract.alpha if loop.alpha is None else loop.alpha


def _before_filter(contract: Contract, sent: F64, loop: Loop) -> F64:
    """(K, J) the targets that the loop's low pass made `sent` of; the first is as it was sent."""
    alpha = _alpha(contract, loop)
    return np.concatenate([sent[:1], sent[:-1] + np.diff(sent, axis=0) / alpha]) if alpha < 1 else sent


def _cut(sent: F64, action: F64, loop: Loop) -> Bool:
    """(K, J) bool, where a target or an action is at a limit of the loop."""
    low, high = loop.bounds
    ends = (sent <= low + AT_LIMIT) | (sent >= high - AT_LIMIT)
    return ends if loop.clip is None else ends | (np.abs(action) >= loop.clip - AT_LIMIT)


def _parts(contract: Contract, steps: Steps, which: int, loop: Loop, action: F64) -> list[F64]:
    """(K, length, W) a term, of what the policy was shown in a run beside its (K, J) last `action`."""
    run = steps.runs[which]
    order = [steps.joints.index(j) for j in contract.joints]
    sent = run.command[:, order]
    now = _now(contract, run, order, sent, loop, action)
    rows = np.arange(len(sent), dtype=float)
    stale = 0.0 if loop.stale is None else loop.stale[which]
    parts = []
    for term in contract.terms:
        values = now[term.kind] if term.kind in now else np.zeros((len(sent), term.width))
        age = loop.age.get(term.kind, 0.0) + (stale if term.kind in SENSORS else 0.0)
        if np.any(age != 0):
            values = _at(values, rows - age)
        if term.kind in loop.mix:
            values = values @ loop.mix[term.kind].T
        if term.kind in loop.shift:
            values = values + loop.shift[term.kind]
        if term.kind == "joint_pos":
            values = values - contract.default
        parts.append(_history(values * term.scale, term, loop))
    return parts


def _targets(contract: Contract, sent: F64, parts: Sequence[F64], images: F64 | None, loop: Loop) -> F64:
    action = contract.run(_vector(parts, loop), images)
    limit = loop.clip if loop.clip is not None else contract.clip
    if limit is not None:
        action = np.clip(action, -limit, limit)
    wanted = contract.zero + contract.scale * action * loop.gain + loop.sent
    if loop.order is not None:  # targets are handed to the wrong motors, default pose and all
        wanted = wanted[:, list(loop.order)]
    if (alpha := _alpha(contract, loop)) < 1:
        # From the first target on its own: beside each logged one, a filter that hardly moves would fit any log.
        from scipy.signal import lfilter

        wanted = lfilter([alpha], [1, alpha - 1], wanted, axis=0, zi=sent[:1] - alpha * wanted[:1])[0]
    return np.clip(wanted, *loop.bounds)


def _now(contract: Contract, run: Run, order: Sequence[int], sent: F64, loop: Loop, action: F64) -> dict[str, F64]:
    """What a term shows of the moment itself."""
    source = loop.source
    if source.get("last_action") == "zero":
        action = np.zeros_like(action)
    elif source.get("last_action") == "target":
        action = sent
    elif source.get("last_action") == "scaled":
        action = contract.scale * action
    before = np.concatenate([np.zeros_like(action[:1]), action[:-1]])
    gyro = turn(run.quat, run.gyro) if source.get("ang_vel") == "world" else run.gyro
    commanded = np.zeros((len(sent), 3)) if run.commanded is None else run.commanded
    now = {"ang_vel": gyro, "gravity": _gravity(run, source.get("gravity", "body")), "command": commanded,
           "joint_pos": run.pos[:, order], "joint_vel": run.vel[:, order], "last_action": before}  # fmt: skip
    return now if run.lin_vel is None else now | {"lin_vel": run.lin_vel}


def _gravity(run: Run, source: str) -> F64:
    """(K, 3) down in the body's axes; or in the world's, turned by the inverse, or by a quaternion misread."""
    if source == "body":
        return run.down
    down = np.tile([0.0, 0.0, -1.0], (len(run.quat), 1))
    if source == "world":
        return down
    if source == "turned":
        return turn(run.quat, down)
    return turn(run.quat[:, [3, 0, 1, 2]] * [1, -1, -1, -1], down)


def actions(contract: Contract, sent: F64, loop: Loop) -> F64:
    """(K, J) the actions behind the targets that were sent, each to the joint that it was meant for."""
    gain = contract.scale * loop.gain
    return (sent - contract.zero - loop.sent) / np.where(np.abs(gain) < 1e-9, np.inf, gain)


def _at(values: F64, rows: F64) -> F64:
    """Values between rows; before the first there was the first."""
    rows = np.clip(rows, 0, len(values) - 1)
    low = np.floor(rows).astype(int)
    part = (rows - low)[:, None]
    return (1 - part) * values[low] + part * values[np.minimum(low + 1, len(values) - 1)]


def _history(values: F64, term: Term, loop: Loop) -> F64:
    """(K, length, W), oldest first; before the first moment there was the first moment."""
    if term.history == 1:
        return values[:, None]
    held = term.history if loop.length is None else min(loop.length, term.history)
    back = np.minimum(np.arange(term.history)[::-1], held - 1) * loop.skipped
    rows = np.take(values, np.maximum(np.arange(len(values))[:, None] - back, 0), axis=0)
    return rows[:, ::-1] if loop.newest_first else rows


def _vector(parts: Sequence[F64], loop: Loop) -> F64:
    if loop.terms is not None:
        parts = [parts[i] for i in loop.terms]
    if loop.by_time and len({r.shape[1] for r in parts}) == 1:
        return np.concatenate(parts, axis=2).reshape(len(parts[0]), -1)
    return np.concatenate([r.reshape(len(r), -1) for r in parts], axis=1)


def looking(contract: Contract, steps: Steps, blank: float = 1.0) -> Steps:
    """The steps with the depth images that the network is shown, which no change of a loop touches.

    Args:
        blank: what an image that is not logged shows, 0 near to 1 far.
    """
    camera = contract.camera
    if camera is None:
        return steps
    return steps.each(lambda run: replace(run, images=_images(camera, run, blank)))


def _images(camera: Camera, run: Run, blank: float) -> F64:
    """(K, M, H, W) what the network is shown: newest first; a blank where nothing is logged."""
    if run.frames is None:
        return np.full((len(run.time), *camera.shape), blank)
    near, far = camera.near, camera.far
    measured = np.isfinite(run.frames) & (run.frames > 0)
    image = np.where(measured, np.clip((np.nan_to_num(run.frames) - near) / (far - near), 0, 1), 1.0)
    back = np.arange(camera.shape[0]) * camera.stride
    return image[np.maximum(np.arange(len(image))[:, None] - back, 0)]


def _with_unknown(
    contract: Contract, sent: F64, parts: Sequence[F64], images: F64 | None, loop: Loop, kind: str
) -> F64:
    """The targets with an input that is not logged as it explains them best: one value for each window.

    Two Gauss-Newton steps with slopes by row; a window has many times more targets than unknowns.
    """
    which = next(i for i, t in enumerate(contract.terms) if t.kind == kind)
    term, count = contract.terms[which], len(sent)
    windows, ends = np.arange(count) // WINDOW, [(0, -count % WINDOW), (0, 0)]
    value = np.zeros((windows[-1] + 1, term.width))

    def given(per_row: F64) -> F64:
        shown = list(parts)
        shown[which] = _history(per_row * term.scale, term, loop)
        return _targets(contract, sent, shown, images, loop)

    for _ in range(2):
        here = given(value[windows])
        slopes = np.stack([(given(value[windows] + e) - here) / 0.05 for e in 0.05 * np.eye(term.width)], axis=2)
        x = np.pad(slopes, [*ends, (0, 0)]).reshape(len(value), -1, term.width)
        y = np.pad(sent - here, ends).reshape(len(value), -1, 1)
        A = x.mT @ x
        ridge = 1e-6 * np.maximum(np.trace(A, axis1=1, axis2=2), 1e-9)
        step = np.linalg.solve(A + ridge[:, None, None] * np.eye(term.width), x.mT @ y)
        value = np.clip(value + step[..., 0], -2.0, 2.0)
    return given(value[windows])
