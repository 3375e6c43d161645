"""What may differ between a loop and its contract: families of changes, each with its parameters and its words.

A family changes a `Loop` by a vector of parameters; one without parameters is a single change. Families are only
proposals: one score judges all of them (search.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from realsim.core.geometry import exp_so3
from realsim.core.types import F64
from realsim.gap.checks.contract.loop import Loop, actions, commands, merged, targets
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.steps import Steps

FACTORS = (0.0, 0.1, 0.25, 0.5, 2.0, 4.0, 10.0, 57.29578)
"""Where the search for a scale begins: usual ones, and degrees for radians. It ends anywhere."""
AGES = (1.0, 2.0, 3.0, 5.0, 8.0)
ALL_PAIRS = 16
"""Joints up to which any two may have been exchanged; of more, those of one kind and neighbours."""

Told = tuple[str, str]
"""(kind, sentence)"""


@dataclass(frozen=True)
class Family:
    """One way to differ."""

    change: Callable[[Loop, F64], Loop]
    tell: Callable[[F64], Told]
    starts: tuple[F64, ...] = (np.zeros(0),)
    """The neutral value first, from which slopes are taken, if it has parameters."""
    step: float = 0.02
    """Of a parameter, over which slopes are taken: networks run in single precision."""

    @property
    def size(self) -> int:
        return len(self.starts[0])


def families(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """All of them, as changes of a loop."""
    for make in (
        _orders, _signs, _offsets, _gains, _scales, _imu, _velocity_command, _histories, _ages, _limits, _last_actions,
        _term_orders,
    ):  # fmt: skip
        yield from make(contract, steps, loop)


def single(kind: str, text: str, change: Callable[..., Loop], *fixed: Any) -> Family:
    """A change without parameters: `change` of a loop and what is fixed."""
    return Family(lambda loop, _: change(loop, *fixed), lambda _: (kind, text))


# ---------------------------------------------------------------- joints


def _orders(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Joints seen, sent, or both in another order: usual ones, any two exchanged, and the best assignment."""
    joints = contract.joints
    for name, order in usual_orders(joints).items():
        for used in {tuple(order), tuple(int(i) for i in np.argsort(order))}:
            yield from _reordered(used, name)
    kinds, near = ["_".join(j.split("_")[1:]) for j in joints], len(joints) <= ALL_PAIRS
    for i, j in combinations(range(len(joints)), 2):
        if not (near or j - i <= 2 or kinds[i] == kinds[j]):
            continue
        used = tuple(j if k == i else i if k == j else k for k in range(len(joints)))
        yield from _reordered(used, f"{joints[i]} and {joints[j]} exchanged")
    sent, wanted = np.concatenate(commands(contract, steps)), np.concatenate(targets(contract, steps, loop))
    cost = np.array(
        [[np.mean((sent[:, j] - wanted[:, i]) ** 2) for i in range(len(joints))] for j in range(len(joints))]
    )
    best = tuple(int(i) for i in linear_sum_assignment(cost)[1])
    if best != tuple(range(len(joints))):
        moved = [joints[k] for k in range(len(joints)) if best[k] != k]
        text = f"joints are sent in another order: {', '.join(moved[:4])}{' and more' if len(moved) > 4 else ''}"
        yield single("joint_order", text, _send, best)


def _reordered(used: tuple[int, ...], name: str) -> Iterator[Family]:
    P = np.eye(len(used))[list(used)]

    def see(loop: Loop, *kinds: str) -> Loop:
        return merged(loop, mix={k: P @ loop.mix.get(k, np.eye(len(P))) for k in kinds})

    both = ("joint_pos", "joint_vel")
    back = tuple(int(i) for i in np.argsort(used))
    for what, change in (
        ("joints are seen", lambda loop: see(loop, *both)),
        ("joints are sent", lambda loop: _send(loop, used)),
        ("joints are seen and sent", lambda loop: _send(see(loop, *both), back)),
        ("joint positions alone are seen", lambda loop: see(loop, "joint_pos")),
        ("joint velocities alone are seen", lambda loop: see(loop, "joint_vel")),
    ):
        yield single("joint_order", f"{what} in another order: {name}", change)


def _send(loop: Loop, used: tuple[int, ...]) -> Loop:
    order = used if loop.order is None else tuple(loop.order[i] for i in used)
    return replace(loop, order=order)


def usual_orders(joints: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Usual other orders of the same joints: by kind instead of by limb, alphabetical, limbs exchanged, reversed."""
    n = len(joints)
    words = [j.replace("_joint", "").split("_") for j in joints]
    limbs, kinds = [w[0] for w in words], ["_".join(w[1:]) for w in words]
    found: dict[str, tuple[int, ...]] = {}
    place = {(limb, kind): i for i, (limb, kind) in enumerate(zip(limbs, kinds, strict=True))}

    def exchange(name: str, swap: dict[str, str]) -> None:
        moved = [place.get((swap.get(limb, limb), kind)) for limb, kind in zip(limbs, kinds, strict=True)]
        if None not in moved:
            found[name] = tuple(int(i) for i in moved if i is not None)

    if len(set(limbs)) > 1 and all(kinds):
        of_limb, of_kind = list(dict.fromkeys(limbs)), list(dict.fromkeys(kinds))
        at = [(of_limb.index(limb), of_kind.index(kind)) for limb, kind in zip(limbs, kinds, strict=True)]
        found["by joint instead of by limb"] = tuple(sorted(range(n), key=lambda i: at[i][::-1]))
        found["by limb instead of by joint"] = tuple(sorted(range(n), key=lambda i: at[i]))
        for a, b in product(of_limb, of_limb):
            if a < b:
                exchange(f"{a} and {b} exchanged", {a: b, b: a})
        for a, b, c, d in (("FL", "FR", "RL", "RR"), ("LF", "RF", "LH", "RH"), ("left", "right", "", "")):
            if {a, b} <= set(limbs):
                exchange("left and right exchanged", {a: b, b: a, c: d, d: c})
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
        for what, used, sent in (
            ("seen", ("joint_pos", "joint_vel"), False), ("sent", (), True),
            ("seen and sent", ("joint_pos", "joint_vel"), True),
        ):  # fmt: skip
            for middle in (0.0, 1.0) if used else (0.0,):  # about zero, or about the default pose
                yield single(
                    "joint_sign", f"{name} is {what} with the other sign",
                    _flipped, contract, sign, used, sent, middle,
                )  # fmt: skip


def _flipped(loop: Loop, contract: Contract, sign: F64, seen: Sequence[str], sent: bool, middle: float) -> Loop:
    loop = _mixed(loop, seen, np.diag(sign))
    if seen and middle:
        loop = _shifted(loop, "joint_pos", middle * (1 - sign) * contract.default)
    return replace(loop, gain=loop.gain * sign) if sent else loop


def _replaced(loop: Loop, field: str, value: Any) -> Loop:
    return replace(loop, **{field: value})


def _sourced(loop: Loop, kind: str, value: str) -> Loop:
    return merged(loop, source={kind: value})


def _mixed(loop: Loop, kinds: Sequence[str], W: F64) -> Loop:
    """`W` on top of what kinds of terms are mixed with already."""
    mix = {kind: W @ loop.mix.get(kind, np.eye(len(W))) for kind in kinds}
    return merged(loop, mix=mix, shift={kind: W @ loop.shift[kind] for kind in kinds if kind in loop.shift})


def _shifted(loop: Loop, kind: str, by: F64) -> Loop:
    return merged(loop, shift={kind: loop.shift.get(kind, 0.0) + by})


def _offsets(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Another default pose, or an encoder's zero: what is seen, what is sent, or both, beside by an offset a joint."""
    joints, n = contract.joints, len(contract.joints)

    def family(what: str, seen: bool, sent: bool) -> Family:
        def change(loop: Loop, x: F64) -> Loop:
            if seen:
                loop = _shifted(loop, "joint_pos", -x if sent else x)
            return replace(loop, sent=loop.sent + x) if sent else loop

        def tell(x: F64) -> Told:
            most = int(np.argmax(np.abs(x)))
            if np.sum(np.abs(x) > 0.25 * np.abs(x[most])) == 1:
                return "zero_offset", f"{joints[most]} is {what} {x[most]:+.3f} rad beside its zero"
            return "default_pose", f"another default pose is {what}: {listed(joints, x, 0.0, '{:+.3f} rad')}"

        return Family(change, tell, (np.zeros(n),), 0.01)

    yield family("sent", False, True)
    yield family("seen", True, False)
    yield family("seen and sent", True, True)
    yield single(
        "default_pose", "joint positions are seen as they are, without the default pose taken off",
        lambda loop: _shifted(loop, "joint_pos", contract.default),
    )  # fmt: skip
    yield single(
        "default_pose", "targets are sent without the default pose added",
        lambda loop: replace(loop, sent=loop.sent - contract.zero),
    )  # fmt: skip


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
        lambda loop, x: replace(loop, gain=loop.gain * np.exp(x[0])),
        lambda x: ("action_scale", f"actions are scaled by {np.exp(x[0]):.3g} of what they should be"),
        (np.zeros(1), *(np.array([np.log(f)]) for f in FACTORS if f)),
    )  # fmt: skip
    yield Family(
        lambda loop, x: replace(loop, gain=loop.gain * (1 + x)),
        lambda x: ("action_scale", f"the action's scale is off: {listed(contract.joints, 1 + x, 1.0, 'times {:.3g}')}"),
        (np.zeros(len(contract.joints)),),
    )  # fmt: skip


# ---------------------------------------------------------------- what is seen

WORDS = {
    "ang_vel": "the angular velocity", "gravity": "gravity", "command": "the velocity command",
    "joint_pos": "joint positions", "joint_vel": "joint velocities", "last_action": "the last action",
    "lin_vel": "the linear velocity",
}  # fmt: skip


def _kinds(contract: Contract) -> list[str]:
    return [k for k in dict.fromkeys(t.kind for t in contract.terms) if k in WORDS]


def _scales(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """A term seen times a factor, relative to what it should be; a term's columns each with their own."""
    for kind in _kinds(contract):
        if kind == "command" and not _commanded(steps):
            continue
        width = next(t.width for t in contract.terms if t.kind == kind)

        def change(loop: Loop, x: F64, kind: str = kind, width: int = width) -> Loop:
            by = np.broadcast_to(1 + x, (width,))
            loop = _mixed(loop, (kind,), np.diag(by))
            if kind == "joint_pos":  # of what is relative to the default pose
                loop = _shifted(loop, kind, (1 - by) * contract.default)
            return loop

        def tell(x: F64, kind: str = kind) -> Told:
            what = {"command": "velocity_command", "last_action": "last_action"}.get(kind, "observation_scale")
            does, is_ = ("do", "are") if WORDS[kind].endswith("s") else ("does", "is")
            if abs(1 + x[0]) < 0.02:
                return what, f"{WORDS[kind]} {does} not reach the policy"
            if abs(np.log(abs(1 + x[0]) / 57.29578)) < 0.05:
                return what, f"{WORDS[kind]} {is_} seen in degrees"
            return what, f"{WORDS[kind]} {is_} seen times {1 + x[0]:.3g}"

        yield Family(change, tell, (np.zeros(1), *(np.array([f - 1]) for f in FACTORS)))
        if kind in ("joint_pos", "joint_vel"):

            def tell_each(x: F64, kind: str = kind) -> Told:
                return (
                    "observation_scale",
                    f"{WORDS[kind]} are seen times {listed(contract.joints, 1 + x, 1.0, '{:.3g}')}",
                )

            yield Family(change, tell_each, (np.zeros(width),))
        if kind == "ang_vel":
            yield Family(
                lambda loop, x: _shifted(loop, "ang_vel", x),
                lambda x: ("observation_offset", f"the angular velocity has a bias of {np.round(x, 3).tolist()} rad/s"),
                (np.zeros(3),),
            )  # fmt: skip


def _imu(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """The inertial unit turned, its axes exchanged, its orientation read wrongly."""
    for value, kind, text in (
        ("world", "gravity_frame", "gravity is not turned into the body's frame"),
        ("turned", "gravity_frame", "gravity is turned by the inverse rotation"),
        ("xyzw", "quaternion_order", "the quaternion is read in another order (w x y z against x y z w)"),
    ):
        yield single(kind, text, _sourced, "gravity", value)
    yield single("rate_frame", "the angular velocity is in world axes", _sourced, "ang_vel", "world")
    groups = {
        "the inertial unit is": ("gravity", "ang_vel"),
        "gravity is": ("gravity",),
        "the angular velocity is": ("ang_vel",),
    }
    for name, kinds in groups.items():

        def turned(loop: Loop, x: F64, kinds: Sequence[str] = kinds) -> Loop:
            return _mixed(loop, kinds, exp_so3(x))

        def tell(x: F64, name: str = name) -> Told:
            axis = "xyz"[int(np.argmax(np.abs(x)))]
            return (
                "imu_rotation",
                f"{name} turned by {np.linalg.norm(x):.3f} rad, most about {axis}: {np.round(x, 3).tolist()}",
            )

        yield Family(turned, tell, (np.zeros(3), *(np.pi / 2 * s * e for e in np.eye(3) for s in (1.0, -1.0))))
        for W, axes in _other_axes(tuple("xyz")):
            up = np.array_equal(W, -np.eye(3)) and kinds == ("gravity",)
            text = "gravity points up instead of down" if up else f"{name} seen with other axes: {axes} for x, y, z"
            yield single(
                "gravity_frame" if kinds == ("gravity",) else "rate_frame" if kinds == ("ang_vel",) else "imu_rotation",
                text, _mixed, kinds, W,
            )  # fmt: skip


def _commanded(steps: Steps) -> bool:
    return any(r.told is not None and np.abs(r.told).max() > 0 for r in steps.runs)


def _velocity_command(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Ahead, left and yaw with other signs, or in another order."""
    if not (_commanded(steps) and "command" in _kinds(contract)):
        return
    for W, names in _other_axes(("ahead", "left", "yaw")):
        text = f"the policy is commanded {names} for ahead, left, yaw"
        yield single("velocity_command", text, _mixed, ("command",), W)


def _other_axes(names: tuple[str, ...]) -> Iterator[tuple[F64, str]]:
    """(matrix, what stands for the names) of all exchanges of three axes and their signs but none."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        W = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if not np.array_equal(W, np.eye(3)):
            yield W, ", ".join(f"{'-' if s < 0 else ''}{names[o]}" for o, s in zip(order, signs, strict=True))


def _last_actions(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    if "last_action" in _kinds(contract):
        for value, text in (
            ("target", "the joint target is shown as the last action"),
            ("scaled", "the last action is shown after scaling"),
        ):
            yield single("last_action", text, _sourced, "last_action", value)


# ---------------------------------------------------------------- time, order and limits


def _histories(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """The window: newest first, whole observations behind each other, shorter, or with gaps."""
    longest = contract.history
    if longest < 2:
        return
    yield single("history_order", "the history is newest first", lambda loop: replace(loop, newest_first=True))
    yield single("history_order", "the history is by moments, not by terms", lambda loop: replace(loop, by_time=True))
    yield single(
        "history_order", "the history is by moments, newest first",
        lambda loop: replace(loop, by_time=True, newest_first=True),
    )  # fmt: skip
    for length in range(1, longest):
        text = f"the history holds {length} moments instead of {longest}"
        yield single("history_length", text, _replaced, "length", length)
    for gap in (2, 3, 4):
        text = f"moments of the history are {gap} policy steps apart"
        yield single("history_stride", text, _replaced, "skipped", gap)


def _ages(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Sensors, all or some, older than the log has them."""
    seen = [k for k in _kinds(contract) if k not in ("command", "last_action")]
    groups = {
        "all sensors": tuple(seen), "the inertial unit": ("ang_vel", "gravity"), "joints": ("joint_pos", "joint_vel"),
        **{WORDS[k]: (k,) for k in seen}, WORDS["last_action"]: ("last_action",), WORDS["command"]: ("command",),
    }  # fmt: skip
    for name, kinds in groups.items():
        used = [k for k in kinds if k in _kinds(contract) and (k != "command" or _commanded(steps))]
        if not used or (len(kinds) > 1 and len(used) < 2):
            continue

        def change(loop: Loop, x: F64, used: Sequence[str] = tuple(used)) -> Loop:
            return merged(loop, age={k: loop.age.get(k, 0.0) + x[0] for k in used})

        def tell(x: F64, name: str = name) -> Told:
            ms = f"{x[0]:.2g} policy steps ({1e3 * x[0] * steps.period:.3g} ms)"
            if abs(x[0]) < 0.5 or x[0] < 0:
                return "timing", f"{name}: {ms} between the log and what the policy saw"
            if name == "all sensors":
                return "sensor_delay", f"what is seen is {ms} old"
            are = "are" if name.endswith("s") else "is"
            return "last_action" if name == WORDS["last_action"] else "sensor_age", f"{name} {are} {ms} old"

        yield Family(change, tell, (np.zeros(1), *(np.array([a]) for a in AGES)), 0.1)


def _limits(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Actions, or targets, that end at a value which the contract does not have: at the largest that was sent."""
    sent = np.concatenate(commands(contract, steps))
    for limit in (float(np.abs(actions(contract, sent, loop)).max()), 0.5, 1.0, 2.0, 5.0):
        if limit > 1e-6 and (contract.clip is None or limit < contract.clip - 1e-6):
            for unaware in (False, True):
                change = partial(_ending, clip=limit, unaware=unaware)
                yield single("clipped_action", f"actions are clipped at {limit:.3g}", change)
    low, high = sent.min(axis=0), sent.max(axis=0)
    often = ((sent <= low + 1e-6) | (sent >= high - 1e-6)).mean(axis=0) > 0.05
    if often.any() and not np.isfinite(loop.bounds[0]).any() and not np.isfinite(loop.bounds[1]).any():
        bounds = np.where(often, low, -np.inf), np.where(often, high, np.inf)
        text = (
            f"targets end at limits that the contract does not have: {', '.join(np.array(contract.joints)[often][:3])}"
        )
        for unaware in (False, True):
            yield single("clipped_target", text, partial(_ending, bounds=bounds, unaware=unaware))


def _ending(loop: Loop, **limits: Any) -> Loop:
    return replace(loop, **limits)


def _term_orders(contract: Contract, steps: Steps, loop: Loop) -> Iterator[Family]:
    """Two terms exchanged, or one put elsewhere."""
    n = len(contract.terms)
    own = tuple(range(n)) if loop.terms is None else loop.terms
    orders = {}
    for i, j in product(range(n), range(n)):
        if i < j:
            swapped = list(own)
            swapped[i], swapped[j] = own[j], own[i]
            orders[tuple(swapped)] = f"{contract.terms[own[i]].name} and {contract.terms[own[j]].name} are exchanged"
        moved = [k for k in own if k != own[i]]
        moved.insert(j, own[i])
        orders.setdefault(tuple(moved), f"{contract.terms[own[i]].name} stands at place {j + 1}")
    orders.pop(own, None)
    for order, text in orders.items():
        yield single(
            "term_order", f"terms of the observation are in another order: {text}",
            _replaced, "terms", order,
        )  # fmt: skip
