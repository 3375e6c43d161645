"""Errors of a model, one function a kind: what is put in wrongly, and what a diagnosis should say of the robot then.

This shares no code with the effects of the diagnosis. An error changes an `MjSpec`, or the times of the commands, by a
`size` in a coordinate that is 0 without it; the label is what the robot has against the wrong model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

Label = dict[str, Any]


@dataclass(frozen=True)
class Robot:
    """Figures of a baseline that sizes are drawn by."""

    model: mujoco.MjModel
    command_kind: str
    drive: dict[str, str]
    """Joint -> its actuator."""
    effort: dict[str, float]
    """Joint -> N m, 90th percentile of the drive's torque in these runs."""
    speed: dict[str, float]
    """Joint -> rad/s, 90th percentile."""
    saturated: dict[str, float]
    """Joint -> share of the time at the limit of the drive's force."""
    sample: float
    """Seconds between two samples."""


@dataclass(frozen=True)
class Error:
    """A kind of error at a place."""

    kind: str
    place: str
    """Joint or body; "" everywhere."""
    apply: Callable[[mujoco.MjSpec, float], None]
    low: float
    high: float
    """Sizes that are drawn: log-uniform between, with either sign where `either`."""
    either: bool
    label: Callable[[float], Label]
    shifts: str = ""
    """`command` or `reading`: it shifts these by `size` seconds instead of changing the model."""
    least: float = -np.inf
    """The smallest size: there nothing of its kind is left in the model."""
    drawn: bool = True
    """Whether it is put in; the others are only rivals that may look the same."""


def _label(effect: str, name: str, value: float, unit: str, **place: list[str]) -> Label:
    found = {"effect": effect, "joints": None, "bodies": None}
    return found | place | {"parameters": [{"name": name, "value": float(value), "unit": unit}]}


def _drive_errors(robot: Robot, joint: str) -> list[Error]:
    drive = robot.drive[joint]

    def scaled(gain: bool, stiffness: bool, damping: bool) -> Callable[[mujoco.MjSpec, float], None]:
        def apply(spec: mujoco.MjSpec, size: float) -> None:
            actuator, ratio = spec.actuator(drive), float(np.exp(size))
            gains, biases = actuator.gainprm, actuator.biasprm
            gains[0] *= ratio if gain else 1.0
            biases[1] *= ratio if stiffness else 1.0
            biases[2] *= ratio if damping else 1.0
            actuator.gainprm, actuator.biasprm = gains, biases
            if gain and stiffness and damping and actuator.forcelimited == 1:
                actuator.forcerange = np.asarray(actuator.forcerange) * ratio

        return apply

    def ratio(effect: str) -> Callable[[float], Label]:
        return lambda size: _label(effect, "ratio", np.exp(-size), "ratio", joints=[joint])

    def limit(spec: mujoco.MjSpec, size: float) -> None:
        actuator = spec.actuator(drive)
        actuator.forcerange = np.asarray(actuator.forcerange) * float(np.exp(size))

    found = [Error("motor_gain", joint, scaled(True, True, True), 0.2, 0.6, True, ratio("motor_gain"))]
    if robot.command_kind == "position":
        found.append(Error("stiffness_gain", joint, scaled(True, True, False), 0.2, 0.6, True, ratio("stiffness_gain")))
        found.append(Error("damping_gain", joint, scaled(False, False, True), 0.4, 0.9, True, ratio("damping_gain")))
    if robot.saturated[joint] > 0.02:
        top = float(np.abs(robot.model.actuator(drive).forcerange).max())
        label = _label("torque_limit", "limit", top, "N m", joints=[joint])
        found.append(Error("torque_limit", joint, limit, 0.3, 1.0, False, lambda size: label))
    return found


def _joint_errors(robot: Robot, joint: str) -> list[Error]:
    model = robot.model
    dof = int(model.joint(joint).dofadr[0])
    body = model.body(int(model.joint(joint).bodyid[0])).name
    friction = robot.effort[joint]
    damping = robot.effort[joint] / max(robot.speed[joint], 0.1)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, full, data.qM)
    except (TypeError, AttributeError):  # newer bindings take the data
        mujoco.mj_fullM(model, data, full)
    inertia = float(full[dof, dof])

    def coulomb(spec: mujoco.MjSpec, size: float) -> None:
        target = spec.joint(joint)
        target.frictionloss = max(float(target.frictionloss) + size * friction, 0.0)

    def viscous(spec: mujoco.MjSpec, size: float) -> None:
        target = spec.joint(joint)
        values = np.array(target.damping)
        values.flat[0] = max(float(values.flat[0]) + size * damping, 0.0)
        target.damping = values if np.ndim(target.damping) else float(values)

    def rotor(spec: mujoco.MjSpec, size: float) -> None:
        spec.joint(joint).armature = max(float(spec.joint(joint).armature) + size * inertia, 0.0)

    def zero(spec: mujoco.MjSpec, size: float) -> None:
        """The link is turned about its joint: the same reading is another posture, of this body and all behind it."""
        target, axis = spec.body(body), np.asarray(spec.joint(joint).axis, float)
        turn, quat = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, axis / np.linalg.norm(axis), size)
        mujoco.mju_mulQuat(quat, np.asarray(target.quat, float), turn)
        target.quat = quat
        if spec.joint(joint).limited != 0:
            spec.joint(joint).range = np.asarray(spec.joint(joint).range) - size

    def of(effect: str, name: str, unit: str, scale: float) -> Callable[[float], Label]:
        return lambda size: _label(effect, name, -size * scale, unit, joints=[joint])

    found = [
        Error(
            "coulomb_friction", joint, coulomb, 0.1, 0.35, True, of("coulomb_friction", "friction", "N m", friction),
            least=-float(model.dof_frictionloss[dof]) / friction,
        ),
        Error(
            "viscous_friction", joint, viscous, 0.1, 0.35, True,
            of("viscous_friction", "damping", "N m s/rad", damping),
            least=-float(np.atleast_1d(model.dof_damping[dof])[0]) / damping,
        ),
        Error(
            "armature", joint, rotor, 0.4, 1.5, True, of("armature", "armature", "kg m^2", inertia),
            least=-float(model.dof_armature[dof]) / inertia,
        ),
    ]  # fmt: skip
    if not np.any(model.joint(joint).pos):
        label = of("joint_offset", "offset", "rad", -1.0)
        found.append(Error("joint_offset", joint, zero, 0.03, 0.12, True, label))
    return found


def _body_errors(robot: Robot, body: str) -> list[Error]:
    model = robot.model
    here = model.body(body)
    below, arm = float(here.subtreemass[0]), np.array(here.ipos)
    children = [i for i in range(model.nbody) if model.body_parentid[i] == here.id]

    def mass(spec: mujoco.MjSpec, size: float) -> None:
        target = spec.body(body)
        target.mass = float(target.mass) + size * below

    def inertia(spec: mujoco.MjSpec, size: float) -> None:
        target = spec.body(body)
        for name in ("inertia", "fullinertia"):
            values = np.asarray(getattr(target, name))
            if np.isfinite(values).all():
                setattr(target, name, values * float(np.exp(size)))

    def ratio(size: float) -> Label:
        return _label("link_inertia", "ratio", np.exp(-size), "ratio", bodies=[body])

    def mass_label(size: float) -> Label:
        return _label("payload", "mass", -size * below, "kg", bodies=[body])

    found = [
        Error("payload", body, mass, 0.15, 0.5, True, mass_label),
        Error("link_inertia", body, inertia, 0.6, 1.2, True, ratio, drawn=False),
    ]
    length = float(np.linalg.norm(arm))
    if length > 0.02:
        axis = int(np.argmax(np.abs(arm)))

        def com(spec: mujoco.MjSpec, size: float) -> None:
            place = np.array(spec.body(body).ipos)
            place[axis] += size * arm[axis]
            spec.body(body).ipos = place

        def com_label(size: float) -> Label:
            return _label("com_offset", f"d{'xyz'[axis]}", -size * arm[axis], "m", bodies=[body])

        found.append(Error("com_offset", body, com, 0.12, 0.35, True, com_label))
    if len(children) == 1 and (reach := float(np.linalg.norm(model.body_pos[children[0]]))) > 0.05:
        child = model.body(children[0]).name

        def longer(spec: mujoco.MjSpec, size: float) -> None:
            spec.body(child).pos = np.asarray(spec.body(child).pos) * (1 + size)

        def length_label(size: float) -> Label:
            return _label("link_geometry", "length", -size * reach, "m", bodies=[body])

        found.append(Error("link_geometry", body, longer, 0.1, 0.3, True, length_label))
    return found


def _nothing(spec: mujoco.MjSpec, size: float) -> None:
    """The model stays as it is."""


def errors(robot: Robot) -> list[Error]:
    """All kinds at all places of a robot with a fixed base."""

    def delayed(effect: str) -> Callable[[float], Label]:
        return lambda size: _label(effect, "delay", size, "s")

    least = 0.008 / robot.sample
    low, high = max(round(least), 1), max(round(5 * least), 2)
    low, high = low * robot.sample, high * robot.sample
    found = [
        Error("command_delay", "", _nothing, low, high, False, delayed("command_delay"), "command"),
        Error(
            "observation_delay", "", _nothing, low, high, False, delayed("observation_delay"), "reading", drawn=False
        ),
    ]
    for joint in robot.drive:
        found += _drive_errors(robot, joint) + _joint_errors(robot, joint)
        found += _body_errors(robot, robot.model.body(int(robot.model.joint(joint).bodyid[0])).name)
    return found
