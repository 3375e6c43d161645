"""Named causes with drawn magnitudes, causes that no library knows, and what a log cannot tell apart.

A label follows the contract: `effect`, where it acts (`joints` / `bodies`), `parameters` as changes against the model
(a ratio multiplies, a quantity with a unit adds; limits, stiffnesses, delays are absolute).
`strength` in 0..1 runs from hardly visible to gross, log-uniform in the parameter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tests.truths.diagnosis.robots import Robot
from tests.truths.diagnosis.truth import Truth

Label = dict[str, Any]


@dataclass(frozen=True)
class Site:
    """What a cause needs to know about the nominal robot."""

    robot: Robot
    model: mujoco.MjModel
    effort: np.ndarray
    """(J,) N m, typical torque in these motions (90th percentile of the asked torque)."""
    speed: np.ndarray
    """(J,) rad/s, typical speed."""


def _log(strength: float, low: float, high: float) -> float:
    return float(low * (high / low) ** strength)


def _value(name: str, value: float, unit: str) -> dict[str, Any]:
    return {"name": name, "value": float(value), "unit": unit}


def _vector(prefix: str, vector: np.ndarray, unit: str) -> list[dict[str, Any]]:
    """Components of a vector, the largest first: the first parameter is the one that errors are measured on."""
    values = [_value(f"{prefix}{a}", v, unit) for a, v in zip("xyz", vector, strict=False)]
    return sorted(values, key=lambda p: -abs(p["value"]))


def _label(
    effect: str, parameters: list[dict[str, Any]], *, joints: list[str] | None = None, bodies: list[str] | None = None
) -> Label:
    return {"effect": effect, "joints": joints, "bodies": bodies, "parameters": parameters}


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _joint(site: Site, rng: np.random.Generator) -> int:
    """A joint that works: one of those with the larger efforts."""
    order = np.argsort(-site.effort * (site.speed > 0.05))
    return int(rng.choice(order[: max(1, (len(order) + 1) // 2)]))


Apply = Callable[[Truth, Site, np.random.Generator, float], Label]


def command_delay(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.command_delay = _log(k, 0.008, 0.04)
    return _label("command_delay", [_value("delay", t.command_delay, "s")])


def observation_delay(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.observation_delay = _log(k, 0.008, 0.04)
    return _label("observation_delay", [_value("delay", t.observation_delay, "s")])


def _ratio(field: str, effect: str, weak: float, strong: float) -> Apply:
    def apply(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
        j = _joint(s, rng)
        change = _log(k, weak, strong)
        ratio = 1 / (1 + change) if rng.random() < 0.6 else 1 + change
        getattr(t, field)[j] = ratio
        return _label(effect, [_value("ratio", ratio, "1")], joints=[s.robot.joints[j]])

    return apply


def torque_limit(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.torque_limit[j] = s.effort[j] * (0.95 - 0.45 * k)
    return _label("torque_limit", [_value("limit", t.torque_limit[j], "N m")], joints=[s.robot.joints[j]])


def torque_speed_limit(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.no_load_speed[j] = s.speed[j] * (2.2 - 1.2 * k)
    return _label(
        "torque_speed_limit", [_value("no_load_speed", t.no_load_speed[j], "rad/s")], joints=[s.robot.joints[j]]
    )


def coulomb_friction(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.coulomb[j] = s.effort[j] * _log(k, 0.08, 0.35)
    return _label("coulomb_friction", [_value("friction", t.coulomb[j], "N m")], joints=[s.robot.joints[j]])


def viscous_friction(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.viscous[j] = s.effort[j] / max(s.speed[j], 0.1) * _log(k, 0.08, 0.35)
    return _label("viscous_friction", [_value("damping", t.viscous[j], "N m s/rad")], joints=[s.robot.joints[j]])


def stribeck_friction(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.coulomb[j] = s.effort[j] * _log(k, 0.06, 0.15)
    t.stribeck[j] = s.effort[j] * _log(k, 0.1, 0.4)
    t.stribeck_speed = float(rng.uniform(0.05, 0.15))
    values = [_value("static_friction", t.coulomb[j] + t.stribeck[j], "N m"), _value("coulomb", t.coulomb[j], "N m")]
    return _label("stribeck_friction", values, joints=[s.robot.joints[j]])


def load_friction(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.load_friction[j] = _log(k, 0.1, 0.4)
    return _label("load_friction", [_value("ratio", t.load_friction[j], "1")], joints=[s.robot.joints[j]])


def armature(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    nominal = float(s.model.dof_armature[s.model.joint(s.robot.joints[j]).dofadr[0]])
    t.armature[j] = nominal * _log(k, 0.6, 3.0)
    return _label("armature", [_value("armature", t.armature[j], "kg m^2")], joints=[s.robot.joints[j]])


def backlash(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.backlash[j] = _log(k, 0.01, 0.05)
    return _label("backlash", [_value("gap", t.backlash[j], "rad")], joints=[s.robot.joints[j]])


def joint_offset(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.encoder_zero[j] = _sign(rng) * _log(k, 0.02, 0.09)
    return _label("joint_offset", [_value("offset", t.encoder_zero[j], "rad")], joints=[s.robot.joints[j]])


def joint_compliance(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.compliance[j] = s.effort[j] / _log(k, 0.012, 0.06)
    return _label("joint_compliance", [_value("stiffness", t.compliance[j], "N m/rad")], joints=[s.robot.joints[j]])


def _link(s: Site, rng: np.random.Generator) -> str:
    names = [s.model.body(s.model.joint(j).bodyid[0]).name for j in s.robot.joints]
    if s.robot.base == "floating":
        return str(rng.choice(["trunk", *(n for n in names if "thigh" in n)]))
    half = names[: max(1, len(names) // 2)] if s.robot.name == "g1" else names
    return str(rng.choice(half))


def payload(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = _link(s, rng)
    below = float(s.model.body_subtreemass[s.model.body(body).id])
    mass = below * _log(k, 0.12, 0.5)
    at = s.model.body(body).ipos * 1.5
    t.payload[body] = (mass, at)
    values = [_value("mass", mass, "kg"), *_vector("pos_", at, "m")]
    return _label("payload", values, bodies=[body])


def com_offset(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = "trunk" if s.robot.base == "floating" else _link(s, rng)
    axis = int(rng.integers(2)) if s.robot.base == "floating" else int(np.argmax(np.abs(s.model.body(body).ipos)))
    shift = np.zeros(3)
    shift[axis] = _sign(rng) * _log(k, 0.02, 0.07)
    t.com[body] = shift
    return _label("com_offset", _vector("d", shift, "m"), bodies=[body])


def link_inertia(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = _link(s, rng)
    t.inertia_ratio[body] = 1 + _log(k, 0.8, 4.0)
    return _label("link_inertia", [_value("ratio", t.inertia_ratio[body], "1")], bodies=[body])


def link_geometry(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    if s.robot.base == "floating":
        body = str(rng.choice(s.robot.contact_bodies))
    else:
        parents = {int(p) for p in s.model.body_parentid}
        names = [s.model.body(s.model.joint(j).bodyid[0]).name for j in s.robot.joints]
        inner = [n for n in names if s.model.body(n).id in parents] or names
        body = str(rng.choice(inner[: max(1, len(inner) // 2)]))
    t.lengthen[body] = _sign(rng) * _log(k, 0.01, 0.04)
    return _label("link_geometry", [_value("length", t.lengthen[body], "m")], bodies=[body])


def external_force(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = "trunk" if s.robot.base == "floating" else s.model.body(s.model.joint(s.robot.joints[-1]).bodyid[0]).name
    weight = 9.81 * float(s.model.body_subtreemass[s.model.body(body).id])
    newton = np.zeros(3)
    newton[int(rng.integers(3)) if s.robot.base == "floating" else 0] = _sign(rng) * weight * _log(k, 0.1, 0.5)
    begin = float(rng.uniform(0.5, 1.5))
    t.force[body] = (newton, begin, begin + float(rng.uniform(2, 3)))
    values = _vector("f", newton, "N")
    return _label("external_force", values, bodies=[body])


def ground_friction(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.friction_ratio = 1 / (1 + _log(k, 1.0, 6.0))
    return _label("ground_friction", [_value("ratio", t.friction_ratio, "1")])


def contact_compliance(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.contact_time = _log(k, 0.015, 0.06)
    return _label("contact_compliance", [_value("time_constant", t.contact_time, "s")])


def terrain_height(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = str(rng.choice(s.robot.supports))
    t.raised[body] = _sign(rng) * _log(k, 0.01, 0.03)
    return _label("terrain_height", [_value("height", t.raised[body], "m")], bodies=[body])


def terrain_tilt(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    angle = rng.uniform(0, 2 * np.pi)
    t.tilt = _log(k, 0.02, 0.08) * np.array([np.cos(angle), np.sin(angle)])
    values = [_value(n, v, "rad") for n, v in zip(("roll", "pitch"), t.tilt, strict=True)]
    return _label("terrain_tilt", sorted(values, key=lambda p: -abs(p["value"])))


def terrain_scale(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.scale = (1 + _log(k, 0.15, 0.5)) ** _sign(rng)
    return _label("terrain_scale", [_value("ratio", t.scale, "1")])


def terrain_wobble(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    body = str(rng.choice(s.robot.supports))
    weight = 9.81 * float(s.model.body_subtreemass[s.model.body("trunk").id]) / 4
    stiffness = weight / _log(k, 0.005, 0.025)
    damping = 0.1 * float(np.sqrt(stiffness * 4.0))
    t.wobble[body] = (stiffness, damping)
    return _label(
        "terrain_wobble", [_value("stiffness", stiffness, "N/m"), _value("damping", damping, "N s/m")], bodies=[body]
    )


def imu_bias(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    t.gyro_bias[int(rng.integers(3))] = _sign(rng) * _log(k, 0.03, 0.2)
    return _label("imu_bias", _vector("gyro_", t.gyro_bias, "rad/s"))


JOINT_CAUSES: dict[str, Apply] = {
    "command_delay": command_delay,
    "observation_delay": observation_delay,
    "motor_gain": _ratio("motor_gain", "motor_gain", 0.12, 0.6),
    "stiffness_gain": _ratio("kp", "stiffness_gain", 0.12, 0.6),
    "damping_gain": _ratio("kd", "damping_gain", 0.3, 1.2),
    "torque_limit": torque_limit,
    "torque_speed_limit": torque_speed_limit,
    "coulomb_friction": coulomb_friction,
    "viscous_friction": viscous_friction,
    "stribeck_friction": stribeck_friction,
    "load_friction": load_friction,
    "armature": armature,
    "backlash": backlash,
    "joint_offset": joint_offset,
    "joint_compliance": joint_compliance,
    "payload": payload,
    "com_offset": com_offset,
    "external_force": external_force,
}
LINK_CAUSES: dict[str, Apply] = {"link_inertia": link_inertia, "link_geometry": link_geometry}
IMU_CAUSES: dict[str, Apply] = {"imu_bias": imu_bias}
GROUND_CAUSES: dict[str, Apply] = {
    "ground_friction": ground_friction,
    "contact_compliance": contact_compliance,
    "terrain_height": terrain_height,
    "terrain_tilt": terrain_tilt,
    "terrain_scale": terrain_scale,
    "terrain_wobble": terrain_wobble,
}


def available(robot: Robot) -> dict[str, Apply]:
    """The causes that this robot can have."""
    causes = dict(JOINT_CAUSES)
    if len(robot.joints) > 1:
        causes |= LINK_CAUSES
    if robot.imu_site:
        causes |= IMU_CAUSES
    if robot.supports:
        causes |= GROUND_CAUSES
        # One leg of four hardly shows these in a stance; a drive that lags or slips does.
        for name in ("torque_speed_limit", "stribeck_friction", "link_inertia", "armature"):
            causes.pop(name)
    return causes


# ---------------------------------------------------------------- outside every library


def cogging(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j, n = _joint(s, rng), int(rng.integers(6, 14))
    a = s.effort[j] * _log(k, 0.3, 0.8)
    t.strange.append(lambda now, q, v, tau: _at(j, a * np.sin(n * q[j]), len(q)))
    return _label("cogging", [], joints=[s.robot.joints[j]])


def cable(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    """A cable that pulls only beyond a certain angle, harder and harder."""
    j = _joint(s, rng)
    a, free = s.effort[j] * _log(k, 2.0, 6.0), 0.25 * s.robot.reach[j]
    home = s.robot.home[j]
    t.strange.append(
        lambda now, q, v, tau: _at(j, -a * max(q[j] - home - free, 0.0) ** 2 / s.robot.reach[j] ** 2, len(q))
    )
    return _label("cable", [], joints=[s.robot.joints[j]])


def coupling(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    """Speed of one joint drags another."""
    if len(s.robot.joints) < 2:
        return cogging(t, s, rng, k)
    i, j = rng.choice(np.argsort(-s.effort)[: max(2, len(s.effort) // 2)], 2, replace=False)
    a = s.effort[j] / max(s.speed[i], 0.1) * _log(k, 0.3, 0.9)
    t.strange.append(lambda now, q, v, tau: _at(j, a * v[i], len(q)))
    return _label("coupling", [], joints=[s.robot.joints[j]])


def dropouts(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.dropout = (j, float(rng.uniform(0.5, 0.9)), _log(k, 0.05, 0.12))
    return _label("dropouts", [], joints=[s.robot.joints[j]])


def warming(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    """Drag that rises and falls with the time of the run, whatever the joint does."""
    j, f = _joint(s, rng), float(rng.uniform(0.3, 0.6))
    a = s.effort[j] * _log(k, 0.3, 0.8)
    t.strange.append(lambda now, q, v, tau: _at(j, a * np.sin(2 * np.pi * f * now), len(q)))
    return _label("warming", [], joints=[s.robot.joints[j]])


def ripple(t: Truth, s: Site, rng: np.random.Generator, k: float) -> Label:
    j = _joint(s, rng)
    t.encoder_ripple = (j, _log(k, 0.04, 0.1), int(rng.integers(8, 14)))
    return _label("ripple", [], joints=[s.robot.joints[j]])


OUTSIDE: dict[str, Apply] = {
    "cogging": cogging,
    "cable": cable,
    "coupling": coupling,
    "dropouts": dropouts,
    "warming": warming,
    "ripple": ripple,
}


def _at(j: int, value: float, n: int) -> np.ndarray:
    out = np.zeros(n)
    out[j] = value
    return out


# ---------------------------------------------------------------- what a log cannot tell apart


def equivalents(labels: list[Label], site: Site, *, torque_logged: bool) -> list[list[Label]]:
    """Other cause sets that would have made the same log, from the physics of what is logged.

    - Extra viscous friction on a joint and extra velocity gain of its servo brake alike: only a logged torque tells.
    - With a fixed base and no IMU there is no clock but the joints': a late command and a late reading look alike.
    - On a single hinge, rotor inertia, link inertia and a load on the axis differ by nothing.
    """
    out: list[list[Label]] = []
    if len(labels) != 1:
        return out
    (label,) = labels
    effect, first = label["effect"], label["parameters"][0]["value"] if label["parameters"] else 0.0
    if effect in ("command_delay", "observation_delay") and site.robot.base == "fixed" and not site.robot.imu_site:
        other = "observation_delay" if effect == "command_delay" else "command_delay"
        out.append([_label(other, [_value("delay", first, "s")])])
    if effect in ("viscous_friction", "damping_gain") and not torque_logged:
        (name,) = label["joints"]
        kv = -float(site.model.actuator(f"{name}_servo").biasprm[2])
        if effect == "viscous_friction":
            out.append([_label("damping_gain", [_value("ratio", 1 + first / kv, "1")], joints=[name])])
        else:
            out.append([_label("viscous_friction", [_value("damping", (first - 1) * kv, "N m s/rad")], joints=[name])])
    if effect == "armature" and site.robot.name == "pendulum":
        body = site.model.body(site.model.joint(site.robot.joints[0]).bodyid[0])
        ratio = 1 + first / float(max(body.inertia))
        out.append([_label("link_inertia", [_value("ratio", ratio, "1")], bodies=[body.name])])
    return out


MASSES = {"payload", "com_offset", "armature", "link_inertia"}


def one_by_physics(labels: list[Label], site: Site) -> bool:
    """Whether two causes are one: on a single hinge all masses together are a torque of gravity and an inertia, and one
    payload gives both."""
    return len(site.robot.joints) == 1 and len(labels) == 2 and all(label["effect"] in MASSES for label in labels)


def enact(label: Label, truth: Truth, site: Site) -> None:
    """Give a truth one of the causes that `equivalents` names."""
    value = label["parameters"][0]["value"]
    if label["effect"] in ("command_delay", "observation_delay"):
        setattr(truth, label["effect"], value)
    elif label["effect"] == "link_inertia":
        body = label["bodies"][0]
        truth.inertia_ratio[body] = truth.inertia_ratio.get(body, 1.0) * value
    else:
        j = site.robot.joints.index(label["joints"][0])
        if label["effect"] == "damping_gain":
            truth.kd[j] *= value
        else:
            truth.viscous[j] += value


CONFOUNDED = {
    "pendulum": ("command_delay", "observation_delay", "viscous_friction", "damping_gain", "armature"),
    "arm2": ("command_delay", "observation_delay", "viscous_friction", "damping_gain"),
    "arm6": ("viscous_friction", "damping_gain"),
    "quadruped": ("viscous_friction", "damping_gain"),
    "g1": ("command_delay", "observation_delay", "viscous_friction", "damping_gain"),
}
"""Causes of a robot that a log without torque cannot tell from another."""
