"""What effects need to know about a case: its parts, and how hard the nominal simulator works in these runs."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from realsim.core.types import F64, MjData, MjModel, MjSpec
from realsim.gap.case.case import FILTERS, Case
from realsim.gap.case.model.deviations import Deviations


@dataclass
class Context:
    """Parts of the robot and figures of the nominal simulation. Joints are those that are logged."""

    case: Case
    spec: MjSpec
    """MjSpec with the sensors that the simulator reads; copied for every edit."""
    timestep: float
    driven: list[str]
    """Joints with an actuator of their own."""
    passive: list[str]
    """Joints that others, or tendons, move."""
    actuator: dict[str, str]
    """Joint -> the actuator that drives it."""
    bodies: list[str]
    """Moving bodies that matter (at least 0.1 percent of the mass)."""
    terrain: list[str]
    """Static bodies, other than the world, that can be touched."""
    touches: bool
    """Whether the robot can touch anything static."""
    total_mass: float
    torque_range: dict[str, float]
    """Largest torque of the drive by its own limit or the joint's, N m; the nominal peak where there is none. Of a
    joint without a drive: of what moves it, by its apparent inertia."""
    inertia: dict[str, float]
    """Apparent inertia of the joint in its first pose, kg m^2."""
    peak_torque: dict[str, float] = field(default_factory=dict)
    speed: dict[str, float] = field(default_factory=dict)
    """Peak speed, rad/s."""
    mean_torque: dict[str, float] = field(default_factory=dict)
    mean_speed: dict[str, float] = field(default_factory=dict)
    load_at_speed: dict[str, float] = field(default_factory=dict)
    """Peak of |torque| |velocity| over torque range times peak speed."""
    inertial_share: dict[str, float] = field(default_factory=dict)
    deviations: Deviations = field(default_factory=Deviations)
    """Sizes that the user knows."""
    travels: dict[str, float] = field(default_factory=dict)
    """Joint -> range of its positions in the log, rad or m."""
    sensors: dict[tuple[str, ...], list[int]] = field(default_factory=dict)
    """Columns of MuJoCo's sensors by prefix and names, as they were first requested: no effect changes them."""
    reversals: dict[str, int] = field(default_factory=dict)
    load_reversals: dict[str, int] = field(default_factory=dict)

    def friction(self, joint: str) -> float:
        """Nominal dry friction, N m."""
        return float(self._dof("frictionloss", joint))

    def damping(self, joint: str) -> float:
        """Nominal viscous friction, N m s/rad."""
        return float(self._dof("damping", joint))

    def armature(self, joint: str) -> float:
        return float(self._dof("armature", joint))

    def _dof(self, name: str, joint: str) -> float:
        model = self.case.model
        return float(np.atleast_1d(getattr(model, f"dof_{name}")[model.joint(joint).dofadr[0]])[0])

    def limited(self, joint: str) -> bool:
        """Whether the model limits the drive's torque, at the actuator or at the joint."""
        model = self.case.model
        return bool(
            model.actuator(self.actuator[joint]).forcelimited[0] or model.jnt_actfrclimited[model.joint(joint).id]
        )

    def torque_scale(self, joint: str) -> float:
        """A usual size of the drive's torque (not that of rare peaks), N m."""
        return min(self.peak_torque[joint], 2 * self.mean_torque[joint] + 1e-9)

    def speed_scale(self, joint: str) -> float:
        """A usual size of the speed, rad/s."""
        return max(min(self.speed[joint], 2 * self.mean_speed[joint]), 1e-3)

    def load(self, place: tuple[str, ...]) -> float:
        """Largest share of the torque range that the joints of a place use."""
        return max(self.peak_torque[j] / self.torque_range[j] for j in place)

    def usual_torque(self, place: tuple[str, ...]) -> float:
        """Mean size of the torque at the joints of a place."""
        return sum(self.mean_torque[j] for j in place) / len(place)

    def moved_mass(self, body: str) -> float:
        """Mass of a body and all that it carries, kg."""
        return float(self.case.model.body(body).subtreemass[0])

    def heavy(self, share: float) -> list[str]:
        """Bodies that matter most on a robot of many links: a share of the mass, or the end of a limb."""
        if len(self.bodies) <= 16:
            return self.bodies
        model = self.case.model
        parents = {int(p) for p in model.body_parentid[1:]}
        return [
            b
            for b in self.bodies
            if model.body(b).mass[0] >= share * self.total_mass or model.body(b).id not in parents
        ]

    def travel(self, joint: str) -> float:
        """Range of a joint's positions in the log, rad or m."""
        return self.travels[joint]

    def reach(self, body: str) -> float:
        """Size of a body: distance to its farthest child, site or geom end, m."""
        model = self.case.model
        i = model.body(body).id
        far = [float(np.linalg.norm(model.body_pos[c])) for c in range(model.nbody) if model.body_parentid[c] == i]
        far += [float(np.linalg.norm(model.site_pos[s])) for s in range(model.nsite) if model.site_bodyid[s] == i]
        far += [
            float(np.linalg.norm(model.geom_pos[g]) + model.geom_rbound[g])
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == i
        ]
        far.append(float(np.linalg.norm(model.body_ipos[i])))
        return max(0.03, *far)

    def direction(self, body: str) -> F64 | None:
        """Unit vector from a body's origin to its far end (next body, or last geom), body frame; None without one."""
        model = self.case.model
        i = model.body(body).id
        ends = [model.body_pos[c] for c in range(model.nbody) if model.body_parentid[c] == i]
        if len(ends) > 1:
            return None  # a branching body has no one length
        if not ends:
            ends = [model.geom_pos[g] for g in range(model.ngeom) if model.geom_bodyid[g] == i]
        if not ends:
            return None
        end = max(ends, key=lambda e: float(np.linalg.norm(e)))
        length = float(np.linalg.norm(end))
        return end / length if length > 0.03 else None


def build_context(case: Case) -> Context:
    """Parts of the robot; the figures of the nominal simulation are filled in by `measure`."""
    import mujoco

    model = case.model
    actuator = {joint: name for joint in case.joint_names if (name := case.actuator_of(joint)) is not None}
    moves = model.body_weldid != 0
    moving = [i for i in range(1, model.nbody) if moves[i]]
    total = float(sum(model.body_mass[i] for i in moving))
    bodies = [model.body(i).name for i in moving if model.body_mass[i] >= 0.001 * total and model.body(i).name]
    types, affinities, ours = model.geom_contype, model.geom_conaffinity, moves[model.geom_bodyid]
    solid = set(model.geom_bodyid[(types | affinities) > 0].tolist())
    terrain = [model.body(i).name for i in sorted(solid) if i and not moves[i] and model.body(i).name]
    meet = types[ours] & affinities[~ours][:, None] | types[~ours][:, None] & affinities[ours]
    touches = bool(case.floating and meet.any())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    _full_mass(model, data, full)
    inertia, limit = {}, dict.fromkeys(case.joint_names, 0.0)
    for joint in case.joint_names:
        dof = model.joint(joint).dofadr[0]
        inertia[joint] = float(max(full[dof, dof], 1e-9))
    for joint, name in actuator.items():
        i = model.actuator(name).id
        tops = [abs(case.gear(joint)) * model.actuator_forcerange[i]] if model.actuator_forcelimited[i] else []
        if model.jnt_actfrclimited[model.joint(joint).id]:
            tops.append(model.jnt_actfrcrange[model.joint(joint).id])
        limit[joint] = min((t for t in (float(np.abs(ends).max()) for ends in tops) if t > 0), default=0.0)
    passive = [j for j in case.joint_names if j not in actuator]
    return Context(
        case, instrumented(case), float(model.opt.timestep), list(actuator), passive, actuator, bodies,
        terrain if touches else [], touches, total, limit, inertia,
    )  # fmt: skip


def instrumented(case: Case) -> MjSpec:
    """The nominal spec with the sensors that the comparison needs, and nothing that could reset it silently."""
    import mujoco

    spec = case.spec.copy()
    for key in list(spec.keys):
        spec.delete(key)  # a keyframe has the old number of coordinates once an effect adds a joint
    spec.option.disableflags = int(spec.option.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for actuator in spec.actuators:
        if int(actuator.dyntype) in FILTERS:  # the controls lag instead: a run may then go on from any state of a log
            actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj
    for joint in case.joint_names:
        spec.add_sensor(name=f"rs_pos_{joint}", type=kind.mjSENS_JOINTPOS, objtype=obj.mjOBJ_JOINT, objname=joint)
        spec.add_sensor(name=f"rs_vel_{joint}", type=kind.mjSENS_JOINTVEL, objtype=obj.mjOBJ_JOINT, objname=joint)
        if case.actuator_of(joint) is None:  # a tendon may move it
            spec.add_sensor(
                name=f"rs_push_{joint}", type=kind.mjSENS_JOINTACTFRC, objtype=obj.mjOBJ_JOINT, objname=joint
            )
    for name in case.actuator_names:
        spec.add_sensor(name=f"rs_force_{name}", type=kind.mjSENS_ACTUATORFRC, objtype=obj.mjOBJ_ACTUATOR, objname=name)
    if case.floating:
        root = case.model.body(base_body(case)).name
        for label, sensor in (("rs_base_pos", kind.mjSENS_FRAMEPOS), ("rs_base_quat", kind.mjSENS_FRAMEQUAT)):
            spec.add_sensor(name=label, type=sensor, objtype=obj.mjOBJ_XBODY, objname=root)
    if case.imu_site:
        for label, sensor in (("rs_gyro", kind.mjSENS_GYRO), ("rs_acc", kind.mjSENS_ACCELEROMETER)):
            spec.add_sensor(name=label, type=sensor, objtype=obj.mjOBJ_SITE, objname=case.imu_site)
    return spec


def base_body(case: Case) -> int:
    """Id of the body that the free joint moves."""
    joint = int(np.flatnonzero(case.model.jnt_type == 0)[0])
    return int(case.model.jnt_bodyid[joint])


def measure(context: Context, tracks: list[dict[str, F64]]) -> None:
    """Fill in how hard the nominal simulator works. `tracks`: a dict a run with pos, vel, torque of (T, J)."""
    for j, joint in enumerate(context.case.joint_names):
        vel = np.concatenate([t["vel"][:, j] for t in tracks])
        tau = np.concatenate([t["torque"][:, j] for t in tracks])
        if joint in context.passive:
            steps = [np.gradient(t["vel"][:, j], context.timestep) for t in tracks]
            tau = np.abs(tau) + context.inertia[joint] * np.abs(np.concatenate(steps))
        good = np.isfinite(vel) & np.isfinite(tau)
        vel, tau = vel[good], tau[good]
        peak = float(np.abs(tau).max(initial=1e-9))
        speed = float(np.abs(vel).max(initial=1e-6))
        if context.torque_range[joint] <= 0:
            context.torque_range[joint] = peak
        context.peak_torque[joint], context.speed[joint] = max(peak, 1e-9), max(speed, 1e-6)
        context.mean_torque[joint] = float(np.abs(tau).mean()) if len(tau) else 0.0
        context.mean_speed[joint] = float(np.abs(vel).mean()) if len(vel) else 0.0
        context.load_at_speed[joint] = float(np.abs(tau * vel).max(initial=0)) / (context.torque_range[joint] * speed)
        step = np.diff(vel) / context.timestep
        context.inertial_share[joint] = context.inertia[joint] * float(np.std(step)) / peak if len(step) else 0.0
        context.reversals[joint] = _turns(vel, 0.03 * speed)
        context.load_reversals[joint] = _turns(tau, 0.02 * peak)


def _turns(values: F64, threshold: float) -> int:
    """Sign changes of a signal that count: beyond a threshold on both sides."""
    signs = np.sign(values[np.abs(values) > threshold])
    return int((np.diff(signs) != 0).sum())


def _full_mass(model: MjModel, data: MjData, out: F64) -> None:
    import mujoco

    try:
        mujoco.mj_fullM(model, out, data.qM)
    except (TypeError, AttributeError):  # newer bindings take the data
        mujoco.mj_fullM(model, data, out)


SIDES = re.compile(r"(^|[_\-. ])(left|right|l|r|fl|fr|hl|hr|rl|rr|lf|rf|lh|rh|front|hind|rear|back)(?=[_\-. ]|$)", re.I)


def kind_of(joint: str) -> str:
    """The joint's name without its side or leg: left_knee_joint and right_knee_joint are of one kind."""
    return SIDES.sub(r"\1", joint).strip("_-. ").lower()


def like_joints(joints: Sequence[str]) -> list[tuple[str, ...]]:
    """Groups of two or more joints that may share a cause: of one kind, of one leg, all."""
    by_kind, by_leg = defaultdict(list), defaultdict(list)
    for joint in joints:
        by_kind[kind_of(joint)].append(joint)
        found = SIDES.search(joint)
        leg = found.group(2).lower() if found else None
        if leg:
            by_leg[leg].append(joint)
    groups = [tuple(g) for g in [*by_kind.values(), *by_leg.values(), list(joints)] if len(g) > 1]
    return list(dict.fromkeys(groups))
