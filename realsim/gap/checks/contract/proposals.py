"""What may differ between a loop and its contract: families of changes, each with its parameters and its words.

A family changes a `Loop` by a vector of parameters; one without parameters is a single change. Families are only
proposals: one score judges all of them (search.py).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations, product

import numpy as np
from scipy.optimize import linear_sum_assignment

from realsim.core.geometry import exp_so3
from realsim.core.types import F64
from realsim.gap.checks.contract.loop import Loop, actions, commands, targets
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.steps import Steps

FACTORS = (0.0, 0.1, 0.25, 0.5, 2.0, 4.0, 10.0, 57.29578)
"""Where the search for a scale begins: usual ones, and degrees for radians. It ends anywhere."""
AGES = (1.0, 2.0, 3.0, 5.0, 8.0)
ALL_PAIRS = 16
"""Joints up to which any two may have been exchanged; of more, those of one kind and neighbours."""
JOINT = ("joint_pos", "joint_vel")
WHOLE = "the whole observation with the last action"
WORDS = {
    "ang_vel": "the angular velocity", "gravity": "gravity", "command": "the velocity command",
    "joint_pos": "joint positions", "joint_vel": "joint velocities", "last_action": "the last action",
    "lin_vel": "the linear velocity",
}  # fmt: skip


@dataclass(frozen=True)
class Family:
    """One way to differ."""

    change: Callable[[Loop, F64], Loop]
    describe: Callable[[F64], tuple[str, str]]
    """Parameters -> (kind, sentence)."""
    starts: tuple[F64, ...] = (np.zeros(0),)
    """The neutral value first, from which slopes are taken, if it has parameters."""
    step: float | F64 = 0.02
    """Of the parameters, over which slopes are taken: networks run in single precision."""
    read: int = 0
    """Figures of it that are read from the log, beside its parameters."""

    @property
    def size(self) -> int:
        return len(self.starts[0])


def families(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """All of them, as changes of a loop."""
    for make in (
        _orders, _signs, _offsets, _gains, _scales, _imu, _velocity_command, _histories, _ages, _limits, _filters,
        _last_actions, _term_orders,
    ):  # fmt: skip
        yield from make(contract, steps, loop)


def single(kind: str, text: str, change: Callable[[Loop], Loop]) -> Family:
    """A change without parameters."""
    return Family(lambda loop, _: change(loop), lambda _: (kind, text))


def _set(kind: str, text: str, read: int = 0, **fields: object) -> Family:
    """A change of some of the loop's fields."""
    return replace(single(kind, text, lambda loop: replace(loop, **fields)), read=read)  # type: ignore[arg-type]


def _from(*first: float) -> tuple[F64, ...]:
    """Starts of one parameter."""
    return tuple(np.array([value]) for value in first)


# ---------------------------------------------------------------- joints


def _orders(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Joints seen, sent, or both in another order: the robot's, usual ones, any two exchanged, the best assignment."""
    joints = contract.joints
    orders = usual_orders(joints)
    own = tuple(joints.index(j) for j in steps.joints if j in joints)
    if own != tuple(range(len(joints))):
        orders = {"the robot's own": own} | {k: v for k, v in orders.items() if v != own}
    kinds, near = ["_".join(j.split("_")[1:]) for j in joints], len(joints) <= ALL_PAIRS
    for i, j in combinations(range(len(joints)), 2):
        if near or j - i <= 2 or kinds[i] == kinds[j]:
            exchanged = tuple(j if k == i else i if k == j else k for k in range(len(joints)))
            orders[f"{joints[i]} and {joints[j]} exchanged"] = exchanged
    for name, order in orders.items():
        for used in {order, _inverse(order)}:
            yield from _reordered(used, name)
    sent, wanted = np.concatenate(commands(contract, steps)), np.concatenate(targets(contract, steps, loop))
    cost = np.mean((sent[:, :, None] - wanted[:, None, :]) ** 2, axis=0)
    best = tuple(int(i) for i in linear_sum_assignment(cost)[1])
    moved = [name for k, name in enumerate(joints) if best[k] != k]
    if moved:
        text = f"joints are sent in another order: {', '.join(moved[:4])}{' and more' if len(moved) > 4 else ''}"
        yield single("joint_order", text, lambda loop: loop.sent_to(best))


def _inverse(order: Sequence[int]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argsort(order))


def _reordered(used: tuple[int, ...], name: str) -> Iterator[Family]:
    P = np.eye(len(used))[list(used)]
    changes: dict[str, Callable[[Loop], Loop]] = {
        "joints are seen": lambda loop: loop.mixed(JOINT, P),
        "joints are sent": lambda loop: loop.sent_to(used),
        "joints are seen and sent": lambda loop: loop.mixed(JOINT, P).sent_to(_inverse(used)),
        "joint positions alone are seen": lambda loop: loop.mixed(JOINT[:1], P),
        "joint velocities alone are seen": lambda loop: loop.mixed(JOINT[1:], P),
    }
    for what, change in changes.items():
        yield single("joint_order", f"{what} in another order: {name}", change)


def usual_orders(joints: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Usual other orders of the same joints: by kind instead of by limb, alphabetical, limbs exchanged, reversed."""
    n = len(joints)
    words = [j.replace("_joint", "").split("_") for j in joints]
    parts = [(w[0], "_".join(w[1:])) for w in words]
    place = {part: i for i, part in enumerate(parts)}
    limbs, kinds = (list(dict.fromkeys(p[k] for p in parts)) for k in (0, 1))
    found: dict[str, tuple[int, ...]] = {}
    if len(limbs) > 1 and all(kinds):
        at = [(limbs.index(limb), kinds.index(kind)) for limb, kind in parts]
        found["by joint instead of by limb"] = tuple(sorted(range(n), key=lambda i: at[i][::-1]))
        found["by limb instead of by joint"] = tuple(sorted(range(n), key=lambda i: at[i]))
        swaps = {f"{a} and {b} exchanged": {a: b, b: a} for a, b in product(limbs, limbs) if a < b}
        for a, b, c, d in (("FL", "FR", "RL", "RR"), ("LF", "RF", "LH", "RH"), ("left", "right", "", "")):
            if {a, b} <= set(limbs):
                swaps["left and right exchanged"] = {a: b, b: a, c: d, d: c}
        for name, swap in swaps.items():
            moved = [place.get((swap.get(limb, limb), kind)) for limb, kind in parts]
            if None not in moved:
                found[name] = tuple(int(i) for i in moved if i is not None)
    found["alphabetical"] = tuple(sorted(range(n), key=lambda i: joints[i]))
    found["reversed"] = tuple(range(n))[::-1]
    return {k: v for k, v in found.items() if v != tuple(range(n))}


def _signs(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """One joint, or one kind of joint, seen, sent, or both with the other sign."""
    joints, n = contract.joints, len(contract.joints)
    groups = {name: [i] for i, name in enumerate(joints)}
    kinds = ["_".join(j.split("_")[1:]) for j in joints]
    for kind in dict.fromkeys(kinds):
        members = [i for i, k in enumerate(kinds) if k == kind]
        if 1 < len(members) < n:
            groups[f"all {kind}"] = members
    for name, members in groups.items():
        sign = np.ones(n)
        sign[members] = -1.0
        # What is seen turns about zero, or about the default pose.
        about = (np.zeros(n), (1 - sign) * contract.default)
        for what, sent, middles in (("seen", False, about), ("sent", True, (None,)), ("seen and sent", True, about)):
            for middle in middles:
                change = partial(_flipped, sign=sign, middle=middle, sent=sent)
                yield single("joint_sign", f"{name} is {what} with the other sign", change)


def _flipped(loop: Loop, sign: F64, middle: F64 | None, sent: bool) -> Loop:
    """Joints with these signs: seen about a `middle` (None: not seen so), and sent."""
    if middle is not None:
        loop = loop.mixed(JOINT, np.diag(sign))
        loop = loop.shifted("joint_pos", middle) if middle.any() else loop
    return replace(loop, gain=loop.gain * sign) if sent else loop


def _offsets(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Another default pose, or an encoder's zero: what is seen, what is sent, or both, beside by an offset a joint."""
    joints, start = contract.joints, (np.zeros(len(contract.joints)),)

    def describe(x: F64, what: str) -> tuple[str, str]:
        most = int(np.argmax(np.abs(x)))
        if np.sum(np.abs(x) > 0.25 * np.abs(x[most])) == 1:
            return "zero_offset", f"{joints[most]} is {what} {x[most]:+.3f} rad beside its zero"
        return "default_pose", f"another default pose is {what}: {listed(joints, x, 0.0, '{:+.3f} rad')}"

    changes: dict[str, Callable[[Loop, F64], Loop]] = {
        "sent": lambda loop, x: replace(loop, sent=loop.sent + x),
        "seen": lambda loop, x: loop.shifted("joint_pos", x),
        "seen and sent": lambda loop, x: replace(loop.shifted("joint_pos", -x), sent=loop.sent + x),
    }
    for what, change in changes.items():
        yield Family(change, partial(describe, what=what), start, 0.01)
    text = "joint positions are seen as they are, without the default pose taken off"
    yield single("default_pose", text, lambda loop: loop.shifted("joint_pos", contract.default))
    text = "targets are sent without the default pose added"
    yield single("default_pose", text, lambda loop: replace(loop, sent=loop.sent - contract.zero))


def listed(joints: Sequence[str], values: F64, neutral: float, form: str) -> str:
    """The joints whose values differ most from the neutral one, in words."""
    off = np.abs(values - neutral)
    order = [int(i) for i in np.argsort(-off) if off[i] > 0.25 * off.max()]
    if len(order) > 0.7 * len(joints) and np.std(values) < 0.25 * off.max():
        return f"{form.format(float(np.median(values)))} at every joint"
    words = [f"{joints[i]} {form.format(values[i])}" for i in order[:3]]
    return ", ".join(words) + (f" and {len(order) - 3} more" if len(order) > 3 else "")


def _gains(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """The action scale: one factor, or one a joint."""
    yield Family(
        lambda loop, x: replace(loop, gain=loop.gain * (1 + x[0])),
        lambda x: ("action_scale", f"actions are scaled by {1 + x[0]:.3g} of what they should be"),
        _from(0.0, *(f - 1 for f in FACTORS if f)),
    )
    yield Family(
        lambda loop, x: replace(loop, gain=loop.gain * (1 + x)),
        lambda x: ("action_scale", f"the action's scale is off: {listed(contract.joints, 1 + x, 1.0, 'times {:.3g}')}"),
        (np.zeros(len(contract.joints)),),
    )


# ---------------------------------------------------------------- what is seen


def _kinds(contract: Contract) -> list[str]:
    return [k for k in dict.fromkeys(t.kind for t in contract.terms) if k in WORDS]


def _scales(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """A term seen times a factor, relative to what it should be; a joint's columns each with their own; a bias."""

    def change(loop: Loop, x: F64, kind: str, width: int) -> Loop:
        by = np.broadcast_to(1 + x, (width,))
        loop = loop.mixed((kind,), np.diag(by))
        # Of joint positions, it is what is relative to the default pose.
        return loop.shifted(kind, (1 - by) * contract.default) if kind == "joint_pos" else loop

    def describe(x: F64, kind: str) -> tuple[str, str]:
        what = {"command": "velocity_command", "last_action": "last_action"}.get(kind, "observation_scale")
        if len(x) > 1:
            return what, f"{WORDS[kind]} are seen times {listed(contract.joints, 1 + x, 1.0, '{:.3g}')}"
        does, is_ = ("do", "are") if WORDS[kind].endswith("s") else ("does", "is")
        if abs(1 + x[0]) < 0.02:
            return what, f"{WORDS[kind]} {does} not reach the policy"
        if abs(np.log(abs(1 + x[0]) / 57.29578)) < 0.05:
            return what, f"{WORDS[kind]} {is_} seen in degrees"
        return what, f"{WORDS[kind]} {is_} seen times {1 + x[0]:.3g}"

    for kind in _kinds(contract):
        if kind == "command" and not _commanded(steps):
            continue
        width = next(t.width for t in contract.terms if t.kind == kind)
        scaled, words = partial(change, kind=kind, width=width), partial(describe, kind=kind)
        yield Family(scaled, words, _from(0.0, *(f - 1 for f in FACTORS)))
        if kind in JOINT:
            yield Family(scaled, words, (np.zeros(width),))
        if kind == "ang_vel":
            yield Family(
                lambda loop, x: loop.shifted("ang_vel", x),
                lambda x: ("observation_offset", f"the angular velocity has a bias of {np.round(x, 3).tolist()} rad/s"),
                (np.zeros(3),),
            )


IMU = {
    "the inertial unit is": (("gravity", "ang_vel"), "imu_rotation"),
    "gravity is": (("gravity",), "gravity_frame"),
    "the angular velocity is": (("ang_vel",), "rate_frame"),
}
"""What is turned -> its terms, and the kind of mistake if its axes are exchanged."""


def _imu(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """The inertial unit turned, its axes exchanged, its orientation read wrongly."""
    for term, value, kind, text in (
        ("gravity", "world", "gravity_frame", "gravity is not turned into the body's frame"),
        ("gravity", "turned", "gravity_frame", "gravity is turned by the inverse rotation"),
        ("gravity", "xyzw", "quaternion_order", "the quaternion is read in another order (w x y z against x y z w)"),
        ("ang_vel", "world", "rate_frame", "the angular velocity is in world axes"),
    ):
        yield _sourced(kind, text, term, value)

    def describe(x: F64, name: str) -> tuple[str, str]:
        axis, size = "xyz"[int(np.argmax(np.abs(x)))], np.linalg.norm(x)
        return "imu_rotation", f"{name} turned by {size:.3f} rad, most about {axis}: {np.round(x, 3).tolist()}"

    quarters = (np.zeros(3), *(np.pi / 2 * s * e for e in np.eye(3) for s in (1.0, -1.0)))
    for name, (terms, kind) in IMU.items():
        turned = partial(lambda loop, x, terms: loop.mixed(terms, exp_so3(x)), terms=terms)
        yield Family(turned, partial(describe, name=name), quarters)
        for W, axes in _other_axes(tuple("xyz")):
            up = np.array_equal(W, -np.eye(3)) and kind == "gravity_frame"
            text = "gravity points up instead of down" if up else f"{name} seen with other axes: {axes} for x, y, z"
            yield single(kind, text, partial(Loop.mixed, kinds=terms, W=W))


def _sourced(kind: str, text: str, term: str, value: str) -> Family:
    """Something else shown in a term's place."""
    return single(kind, text, lambda loop: loop.with_entries("source", {term: value}))


def _commanded(steps: Steps) -> bool:
    return any(r.commanded is not None and np.abs(r.commanded).max() > 0 for r in steps.runs)


def _velocity_command(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Ahead, left and yaw with other signs, or in another order."""
    if _commanded(steps) and "command" in _kinds(contract):
        for W, names in _other_axes(("ahead", "left", "yaw")):
            text = f"the policy is commanded {names} for ahead, left, yaw"
            yield single("velocity_command", text, partial(Loop.mixed, kinds=("command",), W=W))


def _other_axes(names: tuple[str, ...]) -> Iterator[tuple[F64, str]]:
    """(matrix, the names as they are then) of all exchanges of three axes and their signs but none."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        W = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if not np.array_equal(W, np.eye(3)):
            yield W, ", ".join(f"{'-' if s < 0 else ''}{names[o]}" for o, s in zip(order, signs, strict=True))


def _last_actions(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    if "last_action" in _kinds(contract):
        yield _sourced("last_action", "the joint target is shown as the last action", "last_action", "target")
        yield _sourced("last_action", "the last action is shown after scaling", "last_action", "scaled")


# ---------------------------------------------------------------- time, order and limits


def _histories(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """The window: newest first, whole observations behind each other, shorter, or with gaps."""
    longest = contract.history
    if longest < 2:
        return
    yield _set("history_order", "the history is newest first", newest_first=True)
    yield _set("history_order", "the history is by moments, not by terms", by_time=True)
    yield _set("history_order", "the history is by moments, newest first", by_time=True, newest_first=True)
    for length in range(1, longest):
        yield _set("history_length", f"the history holds {length} moments instead of {longest}", length=length)
    for gap in (2, 3, 4):
        yield _set("history_stride", f"moments of the history are {gap} policy steps apart", skipped=gap)


def _ages(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Sensors, all or some, older than the log has them."""
    known = [k for k in _kinds(contract) if k != "command" or _commanded(steps)]
    seen = [k for k in _kinds(contract) if k not in ("command", "last_action")]
    groups = {"all sensors": tuple(seen), "the inertial unit": ("ang_vel", "gravity"), "joints": JOINT}
    groups |= {WHOLE: tuple(known)} | {WORDS[k]: (k,) for k in (*seen, "last_action", "command")}

    def describe(x: F64, name: str) -> tuple[str, str]:
        ms = f"{x[0]:.2g} policy steps ({1e3 * x[0] * steps.period:.3g} ms)"
        if x[0] < 0.5:
            return "timing", f"{name}: {ms} between the log and what the policy saw"
        if name in ("all sensors", WHOLE):
            return "sensor_delay", f"{'what is seen' if name != WHOLE else name} is {ms} old"
        are = "are" if name.endswith("s") else "is"
        return "last_action" if name == WORDS["last_action"] else "sensor_age", f"{name} {are} {ms} old"

    def change(loop: Loop, x: F64, kinds: Sequence[str]) -> Loop:
        return loop.with_entries("age", {k: loop.age.get(k, 0.0) + x[0] for k in kinds})

    for name, kinds in groups.items():
        used = [k for k in kinds if k in known]
        if len(used) >= min(len(kinds), 2) > 0:
            yield Family(partial(change, kinds=used), partial(describe, name=name), _from(0.0, *AGES), 0.1)


def _filters(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """A first-order low pass of the targets: another one than the contract's, one that it lacks, none."""
    now = 1 - (contract.alpha if loop.alpha is None else loop.alpha)

    def describe(x: F64, shown: str) -> tuple[str, str]:
        if contract.alpha < 1 and x[0] < 0.05:
            return (
                "action_filter",
                f"the contract's low pass (alpha {contract.alpha:.3g}) is not in what is logged as sent",
            )
        text = f"targets go through a low pass of alpha {1 - x[0]:.3g} ({1 - x[0]:.3g} new, the rest the target before)"
        return "action_filter", text + shown

    def change(loop: Loop, x: F64) -> Loop:
        return replace(loop, alpha=1 - float(np.clip(x[0], 0.0, 0.99)))

    starts = _from(now, *(s for s in (0.0, 0.2, 0.5, 0.8, 0.95) if s != now))
    yield Family(change, partial(describe, shown=""), starts)
    if "last_action" in _kinds(contract):
        shown = partial(describe, shown=", and the policy's last action is what is left of it")
        yield Family(lambda loop, x: change(loop, x).with_entries("source", {"last_action": "filtered"}), shown, starts)


def _limits(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Actions, or targets, that end at a value which the contract does not have: at the largest that was sent."""
    sent = np.concatenate(commands(contract, steps))
    for limit in (float(np.abs(actions(contract, sent, loop)).max()), 0.5, 1.0, 2.0, 5.0):
        if limit > 1e-6 and (contract.clip is None or limit < contract.clip - 1e-6):
            yield _set("clipped_action", f"actions are clipped at {limit:.3g}", clip=limit)
            text = f"targets end where actions reach {limit:.3g}, which the policy's last action does not show"
            yield _set("clipped_target", text, clip=limit, unaware=True)
    low, high = sent.min(axis=0), sent.max(axis=0)
    often = ((sent <= low + 1e-6) | (sent >= high - 1e-6)).mean(axis=0) > 0.05
    if often.any() and not any(np.isfinite(ends).any() for ends in loop.bounds):
        names = ", ".join(np.array(contract.joints)[often][:3])
        bounds = np.where(often, low, -np.inf), np.where(often, high, np.inf)
        text = f"targets end at limits that the contract does not have: {names}"
        for unaware in (False, True):
            yield _set("clipped_target", text, 2 * int(often.sum()), bounds=bounds, unaware=unaware)


def _term_orders(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Two terms exchanged, or one put elsewhere."""
    n = len(contract.terms)
    own = tuple(range(n)) if loop.terms is None else loop.terms
    names = [contract.terms[k].name for k in own]
    orders = {}
    for i, j in product(range(n), range(n)):
        if i < j:
            swapped = list(own)
            swapped[i], swapped[j] = own[j], own[i]
            orders[tuple(swapped)] = f"{names[i]} and {names[j]} are exchanged"
        moved = [k for k in own if k != own[i]]
        moved.insert(j, own[i])
        orders.setdefault(tuple(moved), f"{names[i]} stands at place {j + 1}")
    orders.pop(own, None)
    for order, text in orders.items():
        yield _set("term_order", f"terms of the observation are in another order: {text}", terms=order)
