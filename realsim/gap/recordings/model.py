"""Model that a log is compared with: the joints, ranges, servos, sites and feet of a MuJoCo model, and its dynamics."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import check_size
from realsim.core.models import load_mjcf
from realsim.core.types import F64, MjModel, MjSpec
from realsim.gap.recordings.vocabulary import english
from realsim.robots.base import add_servo

MAX_MODEL_BYTES = 64 * 2**20
MODELS_ORDER = "the model's order"
ALPHABETICAL = "alphabetical"
UNLIMITED = 1e6
"""N m of a servo at a joint without a limit of torque: beyond any motor, so that it never clips."""
FOOT_HEIGHT = 0.05
"""m above the lowest leaf body in the reference pose up to which a leaf is taken for a foot."""


NO_SERVOS = "--servos KP KD (N m/rad, N m s/rad) gives each joint one; a URDF has none"
"""What to do about a model without actuators."""


@dataclass(frozen=True)
class Target:
    """A model, by joints (J hinge and slide joints in its order) and actuators (U)."""

    path: Path
    spec: MjSpec = field(repr=False)
    model: MjModel = field(repr=False)
    joints: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    driven: tuple[str, ...] = ()
    """Joint of each actuator, or an empty name."""

    @property
    def floating(self) -> bool:
        return bool(self.model.njnt and (self.model.jnt_type == 0).any())

    @cached_property
    def ranges(self) -> F64:
        """(J, 2) rad or m; infinite where the joint has no limits."""
        found = np.full((len(self.joints), 2), [-np.inf, np.inf])
        for i, name in enumerate(self.joints):
            joint = self.model.joint(name)
            if self.model.jnt_limited[joint.id]:
                found[i] = joint.range
        return found

    @cached_property
    def addresses(self) -> tuple[list[int], list[int]]:
        """(indices into qpos, into qvel) of the joints."""
        ids = [self.model.joint(n).id for n in self.joints]
        return [int(self.model.jnt_qposadr[i]) for i in ids], [int(self.model.jnt_dofadr[i]) for i in ids]

    @cached_property
    def gains(self) -> F64:
        """(U, 2) kp, kd at the joint of position servos; NaN for others."""
        m, found = self.model, np.full((len(self.actuators), 2), np.nan)
        for u in range(len(self.actuators)):
            if m.actuator_biasprm[u, 1] < 0:
                gear = float(m.actuator_gear[u, 0])
                found[u] = m.actuator_gainprm[u, 0] * gear**2, -m.actuator_biasprm[u, 2] * gear**2
        return found

    @cached_property
    def command_kind(self) -> str:
        """What the actuators take: `position`, `velocity` or `torque`; the kind of most."""
        m = self.model
        kinds = [
            "position" if m.actuator_biasprm[u, 1] < 0 else "velocity" if m.actuator_biasprm[u, 2] < 0 else "torque"
            for u in range(m.nu)
        ]
        return max(sorted(set(kinds)), key=kinds.count) if kinds else ""

    @cached_property
    def imu_site(self) -> str:
        """The site of the model's accelerometer or gyroscope, else one named for an IMU, else nothing."""
        m = self.model
        for i in range(m.nsensor):
            if int(m.sensor_type[i]) in (1, 3):  # mjSENS_ACCELEROMETER, mjSENS_GYRO
                return str(m.site(int(m.sensor_objid[i])).name)
        named = [m.site(i).name for i in range(m.nsite) if "imu" in english(m.site(i).name)]
        return str(named[0]) if len(named) == 1 else ""

    @cached_property
    def reference(self) -> F64:
        """(nq,) the pose of the first keyframe, else the model's own."""
        return np.array(self.model.key_qpos[0] if self.model.nkey else self.model.qpos0)

    @cached_property
    def leaves(self) -> list[int]:
        """Bodies without children that move."""
        parents = set(self.model.body_parentid[1:].tolist())
        return [b for b in range(1, self.model.nbody) if b not in parents and self.model.body_weldid[b] != 0]

    @cached_property
    def feet(self) -> list[int]:
        """Of a floating robot: the leaf bodies that are lowest in the reference pose."""
        if not self.floating:
            return []
        import mujoco

        data = mujoco.MjData(self.model)
        data.qpos[:] = self.reference
        mujoco.mj_kinematics(self.model, data)
        heights = {b: float(data.xpos[b, 2]) for b in self.leaves}
        lowest = min(heights.values(), default=0.0)
        return [b for b, z in heights.items() if z < lowest + FOOT_HEIGHT]

    def orders(self, width: int) -> dict[str, dict[int, str]]:
        """Name of an order -> column -> joint, for this many unnamed columns, in orders that controllers use."""
        from realsim.gap.recordings.names import MOTOR_TABLES, match_joints

        joints, driven = list(self.joints), [j for j in self.driven if j]
        lists: dict[str, list[str]] = {}
        if width == len(joints):
            lists[MODELS_ORDER] = joints
            lists["the order of the model's actuators"] = driven
            lists["breadth first (Isaac)"] = self._breadth_first()
            lists[ALPHABETICAL] = sorted(joints)
        elif width == len(driven):
            lists["the order of the model's actuators"] = driven
        elif width > len(joints):
            lists["the model's order, then idle columns"] = joints
        found = {n: dict(enumerate(o)) for n, o in lists.items() if o and len(set(o)) == len(o)}
        for name, table in MOTOR_TABLES.items():
            at = match_joints(table, joints)
            if len(at) == sum(map(bool, table)) and len(table) <= width:
                # Where a table and another order are the same, the table's name says more.
                found = {f"the motors of {name}": at, **found}
        unique: dict[tuple[tuple[int, str], ...], str] = {}
        for name, order in found.items():
            unique.setdefault(tuple(order.items()), name)
        return {name: dict(order) for order, name in unique.items()}

    def _breadth_first(self) -> list[str]:
        depth: dict[str, int] = {}
        for name in self.joints:
            body, steps = int(self.model.joint(name).bodyid[0]), 0
            while body:
                body, steps = int(self.model.body_parentid[body]), steps + 1
            depth[name] = steps
        return sorted(self.joints, key=lambda n: (depth[n], self.joints.index(n)))

    def inverse(self, joints: tuple[str, ...], position: F64, velocity: F64, acceleration: F64) -> F64:
        """(T, K) N m that the motors of a robot with a fixed base need for a motion (T, K) of these joints.

        Friction and damping of the model are counted; joints that are not given rest at their reference.
        """
        import mujoco

        m, data = self.model, mujoco.MjData(self.model)
        qadr, dadr = self.addresses
        at = [self.joints.index(j) for j in joints]
        out = np.zeros_like(position)
        disabled = int(m.opt.disableflags)
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        try:
            for t in range(len(position)):
                data.qpos[:] = self.reference
                data.qvel[:] = 0
                data.qacc[:] = 0
                for k, i in enumerate(at):
                    data.qpos[qadr[i]] = position[t, k]
                    data.qvel[dadr[i]] = velocity[t, k]
                    data.qacc[dadr[i]] = acceleration[t, k]
                mujoco.mj_inverse(m, data)
                out[t] = [data.qfrc_inverse[dadr[i]] for i in at]
        finally:
            m.opt.disableflags = disabled
        return out

    def foot_heights(self, joints: tuple[str, ...], position: F64, up: F64) -> F64:
        """(T, F) m of the feet along `up` (T, 3, base frame) in these postures (T, K)."""
        import mujoco

        data = mujoco.MjData(self.model)
        qadr, _ = self.addresses
        root = next(j for j in range(self.model.njnt) if self.model.jnt_type[j] == 0)
        base = int(self.model.jnt_qposadr[root])
        heights = np.zeros((len(position), len(self.feet)))
        for t in range(len(position)):
            data.qpos[:] = self.reference
            data.qpos[base : base + 7] = [0, 0, 0, 1, 0, 0, 0]
            for k, j in enumerate(joints):
                data.qpos[qadr[self.joints.index(j)]] = position[t, k]
            mujoco.mj_kinematics(self.model, data)
            heights[t] = data.xpos[self.feet] @ up[t]
        return heights


def load_target(path: Path, servos: tuple[float, float] | None = None) -> Target:
    """A model file (MJCF or URDF) as what logs are held against.

    Args:
        servos: kp in N m/rad and kd in N m s/rad of a position servo at each hinge and slide, of a model without
            actuators, as URDFs are.

    Raises:
        GapError: the model does not compile, or has actuators beside these servos.
    """
    import mujoco

    path = Path(path)
    check_size(path, MAX_MODEL_BYTES)
    spec, model, _ = load_mjcf(path, prepare=lambda spec: _add_servos(spec, path, servos) if servos else None)
    spec.compile()  # so that it can be written as XML
    joints = tuple(model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] in (2, 3))
    free = any(model.jnt_type == 0)
    if not all(joints) or not (joints or (free and model.nu)):
        raise GapError(
            "the model has no joints, or joints without a name", file=path,
            expected="named hinges and slides, or a free body with actuators",
        )  # fmt: skip
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    driven = tuple(
        model.joint(int(model.actuator_trnid[i, 0])).name
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT else ""
        for i in range(model.nu)
    )  # fmt: skip
    return Target(path, spec, model, joints, actuators, driven)


def _add_servos(spec: MjSpec, path: Path, servos: tuple[float, float]) -> None:
    import mujoco

    if spec.actuators:
        found = f"{len(spec.actuators)} actuators"
        raise GapError("the model has servos of its own", file=path, expected="none, with --servos", found=found)
    kp, kd = servos
    if not (0 < kp < np.inf and 0 <= kd < np.inf):
        raise GapError("--servos are no gains", expected="KP above 0, KD of 0 or more", found=f"{kp:g} {kd:g}")
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # damping of a servo that is large for its link
    for joint in spec.joints:
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            effort = joint.actfrcrange[1] if joint.actfrcrange[0] < joint.actfrcrange[1] else UNLIMITED
            add_servo(spec, joint.name, kp, kd, effort)
