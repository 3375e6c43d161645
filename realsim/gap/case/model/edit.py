"""Changes to a simulator: of the spec (joints, bodies, actuators) and of what lies between it and the log."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64, MjModel, MjSpec
from realsim.gap.case.setups import Setup

if TYPE_CHECKING:
    from realsim.gap.case.model.context import Context

STIFFEST = 2.2
"""Time steps in which a constraint gives way at the fastest; below 2, MuJoCo takes 2."""
SPECK, LIGHT = "__compensation", 1e-6
"""End of the name of a body that carries nothing but another one's gravity compensation, and its share of its mass."""
NEAR = 0.3
"""Seconds by which an onset that was read off a log may be wrong."""
EVER = 1e5
"""A force that lasts longer than this many seconds counts as always acting."""


@dataclass(frozen=True)
class Pulse:
    """A force that the control of its actuator turns on (1) and off (0)."""

    actuator: str
    start: float
    end: float
    """Seconds of each run, or since its onset."""
    by_onset: bool = False
    """Whether it comes at a moment of its own in each run, and in some not at all
    (realsim.gap.inference.evidence.onsets)."""

    @property
    def always(self) -> bool:
        """Whether it acts throughout every run."""
        return self.start <= 0 and self.end >= EVER


def _wrapper(unit: str, what: str) -> dict[str, str]:
    """Metadata of what no compiled model holds: its unit, and what the loop that steps the simulator does about it."""
    return {"unit": unit, "what": what}


@dataclass
class Signals:
    """What lies between the simulator and the log: wrappers of commands and sensors, and forces known in time."""

    command_delay: float = field(
        default=0.0,
        metadata=_wrapper(
            "s",
            "hold back every command by this time before it is written to ctrl (model.xml does it itself, but for a "
            "delay below 0)",
        ),
    )
    """Seconds."""
    actuator_lag: float = 0.0
    """Seconds beyond the time constants that the actuators have in the model; MJCF holds it."""
    observation_delay: float = field(
        default=0.0, metadata=_wrapper("s", "read joint positions, velocities and torques this much later")
    )
    """Seconds, of joint signals."""
    joint_offset: dict[str, float] = field(
        default_factory=dict,
        metadata=_wrapper(
            "rad",
            "add it to the joint's reading, and give the servo the command less it (times the actuator's gear; for "
            "position servos model.xml does this)",
        ),
    )
    """Reading minus true position, of encoders that the servo also uses, rad."""
    reading_offset: dict[str, float] = field(
        default_factory=dict, metadata=_wrapper("rad", "add it to the joint's reading; the servo is right")
    )
    """The same of encoders that only the log uses."""
    gyro_bias: tuple[float, float, float] = field(
        default=(0.0, 0.0, 0.0), metadata=_wrapper("rad/s", "add it to the gyroscope's reading")
    )
    acc_bias: tuple[float, float, float] = field(
        default=(0.0, 0.0, 0.0), metadata=_wrapper("m/s^2", "add it to the accelerometer's reading")
    )
    imu_delay: float = 0.0
    """Seconds, of the IMU's signals beside the encoders'."""
    imu_phase: float = 0.0
    """Share of a held command's step that the acceleration has seen when it is sampled."""
    base_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset of the logged base position, m."""
    base_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset of the logged base orientation as a rotation vector, rad."""
    torque_gain: dict[str, float] = field(default_factory=dict)
    """Joint -> g: logged torque = (1 + g) * true torque."""
    torque_phase: float = 0.0
    """Share of a held command's step that the logged torque has seen when it is sampled (0: as simulated)."""
    back_emf: dict[str, float] = field(default_factory=dict)
    """Joint -> N m s/rad: what a helper adds to the servo before the joint's limit, and damping takes off after it."""
    load_friction: dict[str, float] = field(
        default_factory=dict,
        metadata=_wrapper(
            "ratio", "before each step, set dof_frictionloss to the model's plus ratio * |torque of the drive|"
        ),
    )
    """Joint -> friction as a ratio of the transmitted torque."""
    position_torque: dict[str, list[float]] = field(
        default_factory=dict,
        metadata=_wrapper(
            "N m",
            "before each step, set the joint's qfrc_applied to constant + cos_1 cos(q) + sin_1 sin(q) + cos_2 cos(2 q) "
            "+ sin_2 sin(2 q); the values stand in this order",
        ),
    )
    """Joint -> N m: constant, then cosine and sine of its angle, of twice its angle, ..."""
    pulses: list[Pulse] = field(default_factory=list)
    rotors: dict[str, str] = field(default_factory=dict)
    """Joint -> joint of the motor that drives it through play or a spring."""

    def moves_the_robot(self) -> bool:
        """Whether the simulation itself changes, not only what is read from it."""
        stepwise = self.load_friction or self.position_torque
        return bool(
            self.command_delay or self.actuator_lag or any(self.joint_offset.values()) or stepwise or self.pulses
        )

    def motion(self, in_motion: bool) -> str:
        """All of it that the simulation itself depends on, spelled out; `in_motion`: runs begin as the log reads."""
        offsets = {joint: offset for joint, offset in self.joint_offset.items() if offset}
        begun = (self.observation_delay, self.reading_offset) if in_motion else ()
        laws = (self.load_friction, self.position_torque, self.back_emf)
        return repr((self.command_delay, self.actuator_lag, offsets, laws, self.pulses, begun))


class Edit:
    """A simulator being changed. The spec is copied when it is first touched."""

    def __init__(self, context: Context, spec: MjSpec | None = None, onsets: Mapping[str, float] | None = None) -> None:
        """`spec`: changed in place; if None, a copy of the context's. `onsets`: run -> s at which pulses begin."""
        self.context = context
        self.onsets = dict(onsets or {})
        self.signals = Signals()
        self.bodily: list[Any] = []
        """Settings of the effects that requested the spec."""
        self.later: Edit | None = None
        """The simulator of the later one of two logs, where that differs."""
        self._spec = spec
        self._requests = 0

    @property
    def requests(self) -> int:
        """How often the spec was requested: an effect that does not ask leaves the bodies as they are."""
        return self._requests

    @property
    def touched(self) -> bool:
        """Whether the spec was requested, and so may differ from the nominal one."""
        return self._spec is not None

    @property
    def spec(self) -> MjSpec:
        self._requests += 1
        if self._spec is None:
            self._spec = self.context.spec.copy()
        return self._spec

    def copied(self) -> Edit:
        """The same changes, to add others to."""
        found = copy.copy(self)
        found.signals, found.bodily = copy.deepcopy(self.signals), list(self.bodily)
        found._spec = None if self._spec is None else self._spec.copy()
        return found

    def motor_joint(self, joint: str) -> str:
        """The joint that the motor turns: the joint itself, or its rotor once it has been split off."""
        return self.signals.rotors.get(joint, joint)

    def split_rotor(self, joint: str) -> Any:
        """Give the joint a rotor of its own (armature, friction, actuator move to it); returns a tendon rotor - joint.

        The tendon has length rotor - joint; the caller makes it a spring or limits it.
        """
        import mujoco

        rotor = self.motor_joint(joint)
        if rotor == joint:
            rotor = f"{joint}__rotor"
            link = self.spec.joint(joint)
            body = self.spec.worldbody.add_body(name=rotor)
            body.mass, body.inertia, body.ipos = 1e-6, np.full(3, 1e-9), np.zeros(3)
            body.iquat, body.explicitinertial = np.array([1.0, 0, 0, 0]), 1
            new = body.add_joint(name=rotor, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            new.limited = 0
            new.armature = max(link.armature, 0.2 * self.context.inertia[joint] if link.armature < 1e-6 else 0.0)
            new.frictionloss, new.damping = link.frictionloss, link.damping
            new.solref_friction, new.solimp_friction = link.solref_friction, link.solimp_friction
            new.actfrcrange, new.actfrclimited = link.actfrcrange, link.actfrclimited
            link.actfrcrange, link.actfrclimited = np.zeros(2), 0
            link.armature, link.frictionloss, link.damping = 0.02 * new.armature, 0.0, 0.0 * np.asarray(link.damping)
            for actuator in self.spec.actuators:
                if actuator.target == joint and actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT:
                    actuator.target = rotor
            self.signals.rotors[joint] = rotor
        tendon = self.spec.add_tendon(name=f"{joint}__play{len(self.spec.tendons)}")
        tendon.wrap_joint(rotor, 1.0)
        tendon.wrap_joint(joint, -1.0)
        return tendon

    def scale_drive(self, name: str, ratio: float) -> None:
        """Multiply all that an actuator gives, and the range that it gives it in."""
        actuator = self.spec.actuator(name)
        actuator.gainprm, actuator.biasprm = actuator.gainprm * ratio, actuator.biasprm * ratio
        actuator.forcerange = np.asarray(actuator.forcerange) * ratio

    def limit_drive(self, joint: str, most: float, beyond: bool = False) -> None:
        """Let a joint's actuator give at most this torque (N m at the joint) either way, within the model's range, or
        `beyond` it."""
        drive = self.context.actuator[joint]
        gear, model = abs(self.context.case.gear(joint)), self.context.case.model.actuator(drive)
        ends = most / max(gear, 1e-9) * np.array([-1.0, 1.0])
        actuator = self.spec.actuator(drive)
        actuator.forcerange = np.clip(ends, *model.forcerange) if model.forcelimited[0] and not beyond else ends
        if beyond:
            self.spec.joint(self.motor_joint(joint)).actfrclimited = 0
        actuator.forcelimited = 1

    def add_helper(self, name: str, joint: str, slope: float) -> Any:
        """A motor on a joint that pushes along with its speed, N m s/rad."""
        import mujoco

        actuator = self.spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        # With no gain, MuJoCo's compiler would take a positive velocity term for a damping ratio and turn it into none.
        actuator.gainprm = np.eye(1, len(actuator.gainprm))[0]
        actuator.biasprm = np.zeros_like(actuator.biasprm)
        put(actuator, "biasprm", 2, slope)
        return actuator

    def add_friction(self, joint: str, amount: float) -> None:
        """Dry friction (N m, or N on a slide) of a joint's motor side; negative takes away, down to none.

        MuJoCo's default friction constraint gives way with a time constant of 20 ms, so that a joint under load creeps
        where a real one sticks. Friction that is added is as stiff as the time step bears, in proportion to its share.
        """
        target = self.spec.joint(self.motor_joint(joint))
        before = float(target.frictionloss)
        target.frictionloss = max(before + amount, 0.0)
        if amount > 0:
            self.stiffen_friction(joint, amount / (before + amount))

    def stiffen_friction(self, joint: str, share: float) -> None:
        """Take the time constant of a joint's friction this share of the way (of its logarithm) to the stiffest."""
        target = self.spec.joint(self.motor_joint(joint))
        constant, stiff = float(target.solref_friction[0]), STIFFEST * float(self.context.timestep)
        if stiff < constant:
            target.solref_friction = np.array([constant ** (1 - share) * stiff**share, target.solref_friction[1]])

    def add_force(self, body: str, force: list[float]) -> str:
        """A force in world axes at a body's centre of mass, on while the returned actuator's control is 1."""
        import mujoco

        tag = f"force_{body}_{len(self.signals.pulses)}"
        target = self.spec.body(body)
        target.add_site(name=tag, pos=self.inertia_of(target)[1])
        if not any(s.name == "__world" for s in self.spec.worldbody.sites):
            self.spec.worldbody.add_site(name="__world")
        actuator = self.spec.add_actuator(
            name=tag, target=tag, refsite="__world", trntype=mujoco.mjtTrn.mjTRN_SITE, gear=[*force, 0, 0, 0]
        )
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
        return tag

    def add_spring_joint(
        self, body: Any, name: str, kind: Any, axis: list[int], stiffness: float, damping: float
    ) -> None:
        """A sprung joint at a body's origin."""
        joint = body.add_joint(name=name, type=kind, axis=axis)
        put(joint, "stiffness", 0, stiffness)
        put(joint, "damping", 0, damping)
        joint.limited = 0

    def inertia_of(self, body: Any) -> tuple[float, F64, F64]:
        """(mass, com, 3x3 inertia about com), in the body's frame."""
        import mujoco

        if body.explicitinertial and np.isfinite(np.asarray(body.inertia)).all() and np.any(np.asarray(body.inertia)):
            mass, com = float(body.mass), np.array(body.ipos)
            quat, diagonal = np.array(body.iquat), np.array(body.inertia)
        else:  # from geoms, or a full matrix: the compiled nominal model knows it
            nominal = self.context.case.model.body(body.name)
            mass, com = float(nominal.mass[0]), np.array(nominal.ipos)
            quat, diagonal = np.array(nominal.iquat), np.array(nominal.inertia)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quat / np.linalg.norm(quat))
        R = turn.reshape(3, 3)
        return mass, com, R @ np.diag(diagonal) @ R.T

    def set_inertia(self, body: Any, mass: float, com: F64, inertia: F64) -> None:
        """The reverse of `inertia_of`. What makes up for gravity does so for the mass that the model knows."""
        import mujoco

        if body.gravcomp:
            self._compensate_as_before(body, mass, com)
        values, vectors = np.linalg.eigh(inertia)
        if np.linalg.det(vectors) < 0:
            vectors[:, 2] *= -1
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(vectors).reshape(-1))
        body.mass, body.ipos, body.iquat = mass, com, quat
        body.inertia, body.explicitinertial = np.maximum(values, 1e-12), 1
        body.fullinertia = np.array([np.nan, 0, 0, 0, 0, 0])

    def _compensate_as_before(self, body: Any, mass: float, com: F64) -> None:
        """Let the force against gravity come from a speck where it acts now, if the body is to be another one."""
        known, centre, _ = self.inertia_of(body)
        if mass == known and (com == centre).all():
            return
        speck = body.add_body(name=f"{body.name}{SPECK}", pos=centre, mass=LIGHT * known, explicitinertial=1)
        speck.inertia, speck.ipos, speck.iquat = np.full(3, 1e-12), np.zeros(3), np.array([1.0, 0, 0, 0])
        speck.gravcomp, body.gravcomp = body.gravcomp / LIGHT, 0.0

    def of(self, setup: Setup) -> Edit:
        """The simulator of a run."""
        return self if self.later is None or not setup.later else self.later

    def compiled(self, setup: Setup) -> MjModel:
        """The model of a run.

        Raises:
            GapError: the effects' values do not make a body (negative inertia, say).
        """
        try:
            return self.set_up(setup).compile()
        except ValueError as error:
            raise GapError("the changed model does not compile", found=str(error).splitlines()[0]) from error

    def set_up(self, setup: Setup) -> MjSpec:
        """The spec as it is in a run that is known to differ from model.xml; a copy where it does.

        Gains are taken as ratios on the model's, so that an effect's ratio counts on top of them.
        """
        if not (setup.payload or setup.gains):
            return self.spec
        here = Edit(self.context, self.spec.copy())
        for name, mass, at in setup.payload:
            body = here.spec.body(name)
            here.set_inertia(body, *add_point_mass(*here.inertia_of(body), mass, np.array(at)))
        for name, which, value in setup.gains:
            actuator, nominal = here.spec.actuator(name), self.context.case.model.actuator(name)
            column = 1 if which == "kp" else 2
            ratio = -value / float(nominal.biasprm[column])
            if which == "kp":
                put(actuator, "gainprm", 0, actuator.gainprm[0] * ratio)
            put(actuator, "biasprm", column, actuator.biasprm[column] * ratio)
        return here.spec


def put(part: Any, field: str, index: int, value: float) -> None:
    """Write one number of an array of an MjSpec's element, which hands out copies of its arrays."""
    values = getattr(part, field)
    values[index] = value
    setattr(part, field, values)


def add_point_mass(mass: float, com: F64, inertia: F64, added: float, where: F64) -> tuple[float, F64, F64]:
    """(mass, com, 3x3 inertia about com) of the body with a point mass added; all in the body's frame."""
    total = mass + added
    center = (mass * com + added * where) / total
    result = inertia.copy()
    for m, r in ((mass, com - center), (added, where - center)):
        result = result + m * (r @ r * np.eye(3) - np.outer(r, r))
    return total, center, result
