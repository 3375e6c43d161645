"""The ways to get a contract wrong, each with its hypotheses. One function a kind, one line in KINDS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from realsim.core.types import F64
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.replay import Mistake, targets
from realsim.gap.checks.contract.steps import Steps, at_changes

GAINS = (0.1, 0.25, 0.5, 0.8, 1.25, 2.0, 4.0, 10.0)
CLIPS = (0.5, 1.0, 2.0, 5.0)
LATE = (1, 2, 3, 4)
SPEEDS = (0.0, 0.05, 0.1, 20.0, 57.29578)
OFFSET = 0.03
"""rad from which an offset is a mistake and not a calibration."""
ONE_JOINT = 0.8
"""Share of an offset's square in one joint from which it is that joint's zero and not another default pose."""
STEP = 5e-3
"""rad, or of the logarithm of a gain, over which slopes are taken."""
MOST_ROWS = 600
"""Policy steps a run on which continuous parameters are fitted."""


@dataclass(frozen=True)
class Hypothesis:
    """One mistake with all its parameters."""

    kind: str
    text: str
    mistake: Mistake
    steps: Steps
    parameters: int = 0


Kind = Callable[[Contract, Steps], Iterator[Hypothesis]]


def residual(contract: Contract, steps: Steps, mistake: Mistake) -> F64:
    """(rows, J) rad: what was sent less what the policy would have sent, without the first second of histories."""
    parts = []
    for run, wanted in zip(steps.runs, targets(contract, steps, mistake), strict=True):
        skip = max(t.history for t in contract.terms)
        parts.append((run.command - wanted)[skip:])
    return np.concatenate(parts)


def joint_order(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """Joints seen, sent, or both in another usual order, or with two legs exchanged."""
    n = len(contract.joints)
    for name, order in _orders(contract.joints).items():
        inverse = tuple(int(i) for i in np.argsort(order))
        for see, send in ((True, True), (True, False), (False, True)):
            what = {(True, True): "seen and sent", (True, False): "seen", (False, True): "sent"}[see, send]
            for used in dict.fromkeys((tuple(order), inverse)):
                if used != tuple(range(n)):
                    mistake = Mistake(see=used if see else None, send=tuple(np.argsort(used)) if see and send else used)
                    mistake = mistake if send else replace(mistake, send=None)
                    yield Hypothesis("joint_order", f"joints are {what} in another order: {name}", mistake, steps)


def _orders(joints: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Usual other orders of the same joints: by kind instead of by limb, alphabetical, limbs exchanged, reversed."""
    n = len(joints)
    words = [j.replace("_joint", "").split("_") for j in joints]
    found: dict[str, tuple[int, ...]] = {}
    limbs = [w[0] for w in words]
    kinds = ["_".join(w[1:]) for w in words]
    if len(set(limbs)) > 1 and all(kinds):
        limb_order, kind_order = list(dict.fromkeys(limbs)), list(dict.fromkeys(kinds))
        found["by joint instead of by limb"] = tuple(
            sorted(range(n), key=lambda i: (kind_order.index(kinds[i]), limb_order.index(limbs[i])))
        )
        found["by limb instead of by joint"] = tuple(
            sorted(range(n), key=lambda i: (limb_order.index(limbs[i]), kind_order.index(kinds[i])))
        )
        for a, b in product(limb_order, limb_order):
            if a < b:
                swap = {a: b, b: a}
                place = {(li, k): i for i, (li, k) in enumerate(zip(limbs, kinds, strict=True))}
                moved = [place.get((swap.get(li, li), k)) for li, k in zip(limbs, kinds, strict=True)]
                if None not in moved:
                    found[f"{a} and {b} exchanged"] = tuple(int(i) for i in moved if i is not None)
        pairs = [("FL", "FR", "RL", "RR"), ("LF", "RF", "LH", "RH"), ("left", "right", "", "")]
        for a, b, c, d in pairs:
            if {a, b} <= set(limbs):
                swap = {a: b, b: a, c: d, d: c}
                place = {(li, k): i for i, (li, k) in enumerate(zip(limbs, kinds, strict=True))}
                moved = [place.get((swap.get(li, li), k)) for li, k in zip(limbs, kinds, strict=True)]
                if None not in moved:
                    found["left and right exchanged"] = tuple(int(i) for i in moved if i is not None)
    found["alphabetical"] = tuple(sorted(range(n), key=lambda i: joints[i]))
    found["reversed"] = tuple(range(n))[::-1]
    return {k: v for k, v in found.items() if v != tuple(range(n))}


def joint_sign(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """One joint, or one kind of joint, seen, sent, or both with the other sign."""
    n = len(contract.joints)
    groups = {name: [i] for i, name in enumerate(contract.joints)}
    for kind in dict.fromkeys("_".join(j.split("_")[1:]) for j in contract.joints):
        members = [i for i, j in enumerate(contract.joints) if "_".join(j.split("_")[1:]) == kind]
        if 1 < len(members) < n:
            groups[f"all {kind}"] = members
    for name, members in groups.items():
        sign = np.ones(n)
        sign[members] = -1.0
        for see, send in ((True, True), (True, False), (False, True)):
            what = {(True, True): "seen and sent", (True, False): "seen", (False, True): "sent"}[see, send]
            mistake = Mistake(see_sign=sign if see else None, send_sign=sign if send else None)
            yield Hypothesis("joint_sign", f"{name} is {what} with the other sign", mistake, steps)


def pose(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """Another default pose, or an encoder's zero: what is seen, what is sent, or both, beside by an offset a joint."""
    n = len(contract.joints)
    order = [steps.joints.index(j) for j in contract.joints]
    few = _few(steps)

    def made(see: bool, send: bool, offset: F64) -> Mistake:
        return Mistake(see_offset=-offset if see else None, send_offset=offset if send else None)

    for see, send in ((False, True), (True, False), (True, True)):
        offset = np.zeros(n)
        if send and not see:
            for _ in range(3):  # the last action that is seen depends on it
                offset = offset + np.median(residual(contract, few, made(see, send, offset))[:, order], axis=0)
        else:

            def error(x: F64, see: bool = see, send: bool = send) -> F64:
                return residual(contract, few, made(see, send, x)).ravel()

            offset = _fitted(error, offset)
        largest = int(np.argmax(np.abs(offset)))
        if abs(offset[largest]) < OFFSET:
            continue
        what = {(False, True): "sent", (True, False): "seen", (True, True): "seen and sent"}[see, send]
        if offset[largest] ** 2 > ONE_JOINT * float(offset @ offset):
            single = np.where(np.arange(n) == largest, offset, 0.0)
            text = f"{contract.joints[largest]} is {what} {offset[largest]:+.3f} rad beside its zero"
            yield Hypothesis("zero_offset", text, made(see, send, single), steps, 1)
        else:
            text = f"another default pose is {what}: up to {offset[largest]:+.3f} rad at {contract.joints[largest]}"
            yield Hypothesis("default_pose", text, made(see, send, offset), steps, n)


def action_scale(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """All actions scaled by another factor; the nearest usual one is refined."""
    few = _few(steps)
    costs = {g: float(np.sum(residual(contract, few, Mistake(gain=g)) ** 2)) for g in GAINS}
    start = min(costs, key=lambda g: costs[g])

    def error(x: F64) -> F64:
        return residual(contract, few, Mistake(gain=float(np.exp(x[0])))).ravel()

    gain = float(np.exp(_fitted(error, np.array([np.log(start)]))[0]))
    if abs(np.log(gain)) > 0.05:
        yield Hypothesis(
            "action_scale", f"actions are scaled by {gain:.3g} of what they should be", Mistake(gain=gain), steps, 1
        )


def gravity(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """The vertical in another frame or sense."""
    said = {
        "negated": ("gravity_frame", "gravity points up instead of down"),
        "world": ("gravity_frame", "gravity is not turned into the body's frame"),
        "turned": ("gravity_frame", "gravity is turned by the inverse rotation"),
        "xyzw": ("quaternion_order", "the quaternion is read in another order (w x y z against x y z w)"),
    }
    for value, (kind, text) in said.items():
        yield Hypothesis(kind, text, Mistake(gravity=value), steps)


def rates(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """Angular velocity in another frame or unit; joint velocities scaled."""
    yield Hypothesis("rate_frame", "the angular velocity is in world axes", Mistake(rates="world"), steps)
    yield Hypothesis("observation_scale", "the angular velocity is in deg/s", Mistake(rates="deg"), steps)
    for factor in SPEEDS:
        yield Hypothesis(
            "observation_scale", f"joint velocities are seen times {factor:g}", Mistake(speeds=factor), steps
        )


def told(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """The velocity command lost, or left and yaw with the other sign."""
    if any(np.abs(r.told).max() > 0 for r in steps.runs):
        yield Hypothesis(
            "velocity_command", "the velocity command does not reach the policy", Mistake(told="zero"), steps
        )
        yield Hypothesis(
            "velocity_command", "left and yaw are commanded with the other sign", Mistake(told="negated"), steps
        )


def history(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """The window: newest first, whole observations behind each other, or shorter than it should be."""
    longest = max(t.history for t in contract.terms)
    if longest < 2:
        return
    yield Hypothesis("history_order", "the history is newest first", Mistake(newest_first=True), steps)
    yield Hypothesis("history_order", "the history is by moments, not by terms", Mistake(by_time=True), steps)
    both = Mistake(newest_first=True, by_time=True)
    yield Hypothesis("history_order", "the history is by moments, newest first", both, steps)
    for length in range(1, longest):
        text = f"the history holds {length} moments instead of {longest}"
        yield Hypothesis("history_length", text, Mistake(length=length), steps)


def observation_delay(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """What is seen is some policy steps old."""
    for late in LATE:
        text = f"what is seen is {late} policy steps ({1e3 * late * steps.period:.3g} ms) old"
        yield Hypothesis("observation_delay", text, Mistake(late=late), steps)


def clipped(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """Actions clipped at a value that the contract does not have; at the largest that was sent, or a usual one."""
    order = [steps.joints.index(j) for j in contract.joints]
    sent = np.concatenate([np.abs((r.command[:, order] - contract.default) / contract.scale) for r in steps.runs])
    largest = float(sent.max())
    often = float((sent > largest - 1e-3).mean())
    values = (*CLIPS, largest) if often > 1e-3 else CLIPS
    for value in values:
        if contract.clip is None or abs(value - contract.clip) > 1e-6:
            yield Hypothesis("clipped_action", f"actions are clipped at {value:.3g}", Mistake(clip=value), steps, 1)


def last_action(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """The last action that is seen is none, or is the joint target."""
    yield Hypothesis("last_action", "the last action that is seen is always zero", Mistake(last="zero"), steps)
    yield Hypothesis("last_action", "the joint target is shown as the last action", Mistake(last="target"), steps)


def decimation(contract: Contract, steps: Steps) -> Iterator[Hypothesis]:
    """The policy runs at another period than it was trained at, or only every n-th of its actions is sent."""
    if abs(steps.changes / contract.period - 1) < 0.1:
        return
    slow = at_changes(steps)
    text = f"the policy is asked every {1e3 * steps.changes:.3g} ms instead of every {1e3 * contract.period:.3g} ms"
    yield Hypothesis("control_period", text, Mistake(), slow)


KINDS: dict[str, Kind] = {
    "joint_order": joint_order, "joint_sign": joint_sign, "pose": pose, "action_scale": action_scale,
    "gravity": gravity, "rates": rates, "told": told, "history": history, "observation_delay": observation_delay,
    "clipped": clipped, "last_action": last_action, "decimation": decimation,
}  # fmt: skip


def _fitted(error: Callable[[F64], F64], start: F64) -> F64:
    """Least squares whose slopes are taken over a step that single precision can resolve: networks run in it."""

    def slopes(x: F64) -> F64:
        here = error(x)
        return np.stack([(error(x + STEP * e) - here) / STEP for e in np.eye(len(x))], axis=1)

    found = least_squares(error, start, jac=slopes, loss="soft_l1", f_scale=0.1, max_nfev=10)
    return np.asarray(found.x, dtype=np.float64)


def _few(steps: Steps) -> Steps:
    """The beginning of each run, for fits."""

    def cut(a: F64 | None) -> F64 | None:
        return None if a is None else a[:MOST_ROWS]

    runs = tuple(
        replace(
            r, time=r.time[:MOST_ROWS], command=r.command[:MOST_ROWS], pos=r.pos[:MOST_ROWS], vel=r.vel[:MOST_ROWS],
            gyro=r.gyro[:MOST_ROWS], quat=r.quat[:MOST_ROWS], told=r.told[:MOST_ROWS], torque=cut(r.torque),
            sent=r.sent[:MOST_ROWS],
        )
        for r in steps.runs[:2]
    )  # fmt: skip
    return replace(steps, runs=runs)
