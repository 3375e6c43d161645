"""The true robot: its own physics, drives that close their loop at 1 kHz on motor-side encoders, and its sensors.

Nothing here uses MuJoCo's actuators: torque is computed by this servo loop, friction beyond the model's own by a
bristle law (Canudas de Wit et al. 1995, "A new model for control of systems with friction"), play and elasticity of a
gear by a second mass behind the motor, delays in continuous time.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tests.truths.diagnosis.mjspec import first, set_first
from tests.truths.diagnosis.robots import Robot
from tests.truths.diagnosis.truth import Truth

STEP = 0.0005
CONTROL = 2
"""Physics steps a control step (1 kHz)."""
PRESLIDING = 0.0015
"""rad that a bristle bends before it slips."""


@dataclass(frozen=True)
class Trace:
    """What happened, at 1 kHz from the first command on; (K, ...) arrays without any sensor in between."""

    time: np.ndarray
    q: np.ndarray
    """(K, J) link side."""
    v: np.ndarray
    torque: np.ndarray
    """(K, J) N m, the drive's torque before gear friction."""
    base: np.ndarray | None
    """(K, 7) position and quaternion."""
    gyro: np.ndarray | None
    acc: np.ndarray | None
    contact: np.ndarray | None
    qpos0: np.ndarray
    """Of the nominal model's layout, at the first sample."""
    upright: bool


class Plant:
    """A true robot that can be driven; one object a case."""

    def __init__(self, robot: Robot, truth: Truth) -> None:
        self.robot, self.truth = robot, truth
        spec = mujoco.MjSpec.from_string(robot.xml)
        nominal = spec.compile()
        ids = [nominal.actuator(a).id for a in robot.actuators]
        self.kp = nominal.actuator_gainprm[ids, 0] * truth.kp
        self.kv = -nominal.actuator_biasprm[ids, 2] * truth.kd
        force = nominal.actuator_forcerange[ids, 1].copy()
        force[force <= 0] = np.inf
        self.limit = np.minimum(force, truth.torque_limit)
        self.slows = bool(np.isfinite(truth.no_load_speed).any())
        self.rubs = bool(truth.coulomb.any() or truth.load_friction.any() or truth.stribeck.any())
        self.nothing = np.zeros(len(robot.joints))
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        self._edit(spec, nominal)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        joint = [self.model.joint(n) for n in robot.joints]
        self.qadr = np.array([j.qposadr[0] for j in joint])
        self.dadr = np.array([j.dofadr[0] for j in joint])
        outer = [mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, f"{n}__link") for n in robot.joints]
        self.outer = np.flatnonzero(np.array(outer) >= 0)
        self.outer_q = self.model.jnt_qposadr[np.array(outer)[self.outer]] if len(self.outer) else np.zeros(0, int)
        self.outer_v = self.model.jnt_dofadr[np.array(outer)[self.outer]] if len(self.outer) else np.zeros(0, int)
        free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        self.base_q = int(self.model.jnt_qposadr[free[0]]) if len(free) else -1
        """Not 0: a support that wobbles has coordinates of its own before the base's."""
        self.feet = np.array([self.model.body(b).id for b in robot.contact_bodies])[:, None]
        sensed = ("gyro", "acc") if robot.imu_site else ()
        self.sensors = {name: self.data.sensor(name).data for name in sensed}  # looked up once: they are views

    # ------------------------------------------------------------ building

    def _edit(self, spec: mujoco.MjSpec, nominal: mujoco.MjModel) -> None:
        t = self.truth
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
        elliptic = spec.option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL if elliptic else mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 2.0
        for name, ratio in t.mass_ratio.items():
            spec.body(name).mass *= ratio
        for name, ratio in t.inertia_ratio.items():
            spec.body(name).inertia = spec.body(name).inertia * ratio
        for name, shift in t.com.items():
            spec.body(name).ipos = spec.body(name).ipos + shift
        for name, metres in t.lengthen.items():
            self._lengthen(spec.body(name), metres)
        for i, name in enumerate(self.robot.joints):
            self._gear(spec.joint(name), i)
        for name, (mass, at) in t.payload.items():
            load = spec.body(name).add_body(name=f"{name}__load", pos=at)
            load.mass, load.inertia, load.explicitinertial = mass, np.full(3, 1e-5 + 2e-4 * mass), True
            load.ipos = np.zeros(3)  # left out, MuJoCo would take the body's own offset once more
        self._ground(spec)
        if self.robot.imu_site:
            for kind, label in ((mujoco.mjtSensor.mjSENS_GYRO, "gyro"), (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "acc")):
                spec.add_sensor(name=label, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=self.robot.imu_site)

    def _gear(self, joint: mujoco.MjsJoint, i: int) -> None:
        """The motor keeps the joint's name, its rotor the armature; the link hangs behind it on a joint of its own."""
        t = self.truth
        joint.armature += t.armature[i]
        set_first(joint, "damping", first(joint, "damping") + t.viscous[i])
        if t.backlash[i] == 0 and np.isinf(t.compliance[i]):
            return
        link = joint.parent.add_joint(
            name=f"{joint.name}__link", type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=joint.pos, armature=1e-5
        )
        if t.backlash[i] > 0:
            link.limited, link.range = True, np.array([-0.5, 0.5]) * t.backlash[i]
            link.solref_limit, link.solimp_limit = np.array([0.003, 1.0]), np.array([0.95, 0.99, 1e-4, 0.5, 2.0])
            set_first(link, "damping", 0.002)
        else:
            link.limited = False
            set_first(link, "stiffness", float(t.compliance[i]))
            set_first(link, "damping", 0.003 * float(t.compliance[i]))

    @staticmethod
    def _lengthen(body: mujoco.MjsBody, metres: float) -> None:
        """Push everything that hangs at the far end of a body farther out along its direction."""
        for child in body.bodies:
            direction = child.pos / max(np.linalg.norm(child.pos), 1e-9)
            child.pos = child.pos + metres * direction
        for geom in body.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE:
                geom.pos = geom.pos + metres * geom.pos / max(np.linalg.norm(geom.pos), 1e-9)

    def _ground(self, spec: mujoco.MjSpec) -> None:
        t = self.truth
        if not self.robot.supports:
            return
        angle = float(np.linalg.norm(t.tilt))
        quat = np.array([1.0, 0, 0, 0])
        if angle > 0:
            quat[0], quat[1:3] = np.cos(angle / 2), np.sin(angle / 2) * t.tilt / angle
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, quat)
        for body in [spec.worldbody, *(spec.body(s) for s in self.robot.supports)]:
            if body.name in self.robot.supports:
                body.pos = R.reshape(3, 3) @ (t.scale * body.pos + np.array([0, 0, t.raised.get(body.name, 0.0)]))
                body.quat = quat
                if body.name in t.wobble:
                    stiffness, damping = t.wobble[body.name]
                    slide = body.add_joint(
                        name=f"{body.name}__wobble", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1]
                    )
                    set_first(slide, "stiffness", stiffness)
                    set_first(slide, "damping", damping)
                    body.gravcomp = 1.0
            for geom in body.geoms:
                if body.name not in self.robot.supports:
                    geom.quat = quat
                else:
                    geom.size = t.scale * geom.size
                geom.friction = geom.friction * np.array([t.friction_ratio, 1.0, 1.0])
                geom.solref = geom.solref + np.array([t.contact_time, 0.0])

    # ------------------------------------------------------------ driving

    def drive(self, times: np.ndarray, commands: np.ndarray, settle: float = 1.2) -> Trace:
        """Send `commands` (T, J) at `times` (T,) s, held in between, after the robot has settled on the first one."""
        t, m, d = self.truth, self.model, self.data
        mujoco.mj_resetData(m, d)
        home_q = self.data.qpos
        home_q[self.qadr] = commands[0] - t.encoder_zero
        n = len(self.robot.joints)
        self._bristle = np.zeros(n)
        dt = STEP * CONTROL
        steps = int(np.ceil((settle + times[-1] - times[0]) / dt))
        rows: dict[str, list[np.ndarray]] = {
            k: [] for k in ("time", "q", "v", "torque", "base", "gyro", "acc", "contact")
        }
        start = times[0] - settle
        now = start + dt * np.arange(steps + 1)
        current = np.maximum(np.searchsorted(times, now - t.command_delay + 1e-9, side="right") - 1, 0)
        applied = d.qfrc_applied
        qpos0, upright = np.zeros(0), True
        changes = self.rubs or t.strange or t.force
        parts = CONTROL if changes else 1  # in which torque is computed anew, of a control step
        for at, command in zip(now.tolist(), commands[current], strict=True):
            delivered = self._servo(at - times[0], command)
            if at >= times[0] - 1e-9:
                if not rows["time"]:
                    qpos0 = self._nominal_qpos()
                self._note(rows, at, delivered)
            applied[self.dadr] = delivered
            for _ in range(parts):
                if changes:
                    applied[self.dadr] = delivered + self._friction(delivered) + self._strange(at - times[0], delivered)
                    self._push(at - times[0])
                mujoco.mj_step(m, d, CONTROL // parts)
        if self.robot.base == "floating":
            up = np.array([np.zeros(9)])
            base = self._base()
            mujoco.mju_quat2Mat(up[0], base[3:])
            upright = bool(up[0, 8] > 0.8 and base[2] > 0.5 * qpos0[2])
        arrays: dict[str, Any] = {k: np.array(v) if v else None for k, v in rows.items()}
        finite = bool(np.isfinite(arrays["q"]).all())
        return Trace(**arrays, qpos0=qpos0, upright=upright and finite)

    def _servo(self, now: float, command: np.ndarray) -> np.ndarray:
        t = self.truth
        q, v = self.data.qpos[self.qadr], self.data.qvel[self.dadr]
        read = q + t.encoder_zero
        if t.encoder_ripple is not None:
            j, amplitude, periods = t.encoder_ripple
            read[j] += amplitude * np.sin(periods * q[j])
        asked = self.kp * (command - read) - self.kv * v
        limit = self.limit
        if self.slows:
            slope = np.maximum(1 - np.abs(v) / t.no_load_speed, 0.0)
            limit = np.where((asked * v > 0) & np.isfinite(limit), limit * slope, limit)
        delivered = t.motor_gain * np.minimum(np.maximum(asked, -limit), limit)
        if t.dropout is not None:
            j, period, length = t.dropout
            if now % period < length:
                delivered[j] = 0.0
        return delivered

    def _friction(self, delivered: np.ndarray) -> np.ndarray:
        """Bristle friction on the motor side, advanced by one physics step (implicit in the bristle's own equation)."""
        t = self.truth
        if not self.rubs:
            return self.nothing
        slide = t.coulomb + t.load_friction * np.abs(delivered)
        v = self.data.qvel[self.dadr]
        level = slide + t.stribeck * np.exp(-((v / t.stribeck_speed) ** 2)) + 1e-9
        stiffness = (slide + t.stribeck) / PRESLIDING + 1e-9
        self._bristle = (self._bristle + v * STEP) / (1 + stiffness * np.abs(v) * STEP / level)
        return -np.minimum(np.maximum(stiffness * self._bristle, -level), level) * (level > 1e-8)

    def _strange(self, now: float, delivered: np.ndarray) -> np.ndarray:
        if not self.truth.strange:
            return self.nothing
        extra = np.zeros_like(delivered)
        q, v = self.data.qpos[self.qadr], self.data.qvel[self.dadr]
        for law in self.truth.strange:
            extra += law(now, q, v, delivered)
        return extra

    def _push(self, now: float) -> None:
        for name, (newton, begin, end) in self.truth.force.items():
            self.data.body(name).xfrc_applied[:3] = newton if begin <= now < end else 0.0

    # ------------------------------------------------------------ reading

    def _nominal_qpos(self) -> np.ndarray:
        q = self._link_q()
        return np.concatenate([self._base(), q]) if self.robot.base == "floating" else q

    def _base(self) -> np.ndarray:
        """(7,) position and orientation."""
        return np.array(self.data.qpos[self.base_q : self.base_q + 7])

    def _link_q(self) -> np.ndarray:
        q = self.data.qpos[self.qadr].copy()
        q[self.outer] += self.data.qpos[self.outer_q]
        return q

    def _note(self, rows: dict[str, list[np.ndarray]], now: float, delivered: np.ndarray) -> None:
        d = self.data
        v = d.qvel[self.dadr].copy()
        v[self.outer] += d.qvel[self.outer_v]
        rows["time"].append(np.array(now))
        rows["q"].append(self._link_q())
        rows["v"].append(v)
        rows["torque"].append(delivered.copy())
        if self.robot.base == "floating":
            rows["base"].append(self._base())
        for name, values in self.sensors.items():
            rows[name].append(values.copy())
        if len(self.feet):
            bodies = self.model.geom_bodyid[d.contact.geom[: d.ncon].ravel()]
            rows["contact"].append((self.feet == bodies).any(axis=1).astype(float))
