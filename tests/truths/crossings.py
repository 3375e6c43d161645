"""A quadruped that crawls over stakes in MuJoCo, and what it logs: cases for the survey of footholds and of the camera.

The true terrain differs from the scanned one by what is requested and, as every scan does, a little everywhere; the
robot, its sensors and the estimate of its base err as real ones do. Nothing here uses `realsim.gap`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from realsim.core.geometry import R_to_quat, exp_so3, quat_to_R
from realsim.robots.quadruped import CALF_M, FOOT_RADIUS_M, HIP_AT, LEGS, THIGH_M, THIGH_OFFSET_M, quadruped
from tests.truths.written import write_case

SPACING = 2 * HIP_AT[0] / 3
"""m between stakes along the way: the hind feet stand three stakes behind the front ones."""
COLUMNS = 9
SIDE = HIP_AT[1] + THIGH_OFFSET_M
HALF = (0.048, 0.07)
STANCE = 0.31
"""m of the base above the mean of the tops."""
SHIFT_S, SWING_S, LIFT, REACH_DOWN = 0.45, 0.45, 0.04, 0.05
KP, KD = 400.0, 10.0
RATE = 100
DEPTH_HZ, DEPTH_SHAPE, DEPTH_FAR = 10, (24, 32), 3.0
ORDER = ("RL", "FL", "RR", "FR")


@dataclass(frozen=True)
class Truth:
    """How the world and the camera differ from what the scan and the log say; the maps go by stake (`stake_L3`)."""

    height: dict[str, float] = field(default_factory=dict)
    """m"""
    tilt: dict[str, tuple[float, float]] = field(default_factory=dict)
    """rad about x and y"""
    friction: dict[str, float] = field(default_factory=dict)
    """sliding friction; 0.9 elsewhere"""
    sinks: dict[str, float] = field(default_factory=dict)
    """N/m of a vertical spring"""
    rocks: dict[str, float] = field(default_factory=dict)
    """N m/rad of springs about x and y at the stake's foot"""
    camera_delay: float = 0.0
    camera_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """rad, a rotation vector in the camera's axes (x right, y down, z forward)"""
    camera_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m in the camera's axes"""
    depth_noise: float = 1.0
    """ratio on the noise that log.json says"""
    everyday: float = 1.0
    """How large the deviations are that every scan, robot and sensor has."""


def stakes(seed: int) -> dict[str, tuple[float, float, float]]:
    """Stake -> x, y and height of its top, m."""
    rng = np.random.default_rng(seed)
    return {
        f"stake_{side}{k}": (-HIP_AT[0] + SPACING * k, sign * SIDE, 0.2 + float(rng.uniform(-0.015, 0.015)))
        for side, sign in (("L", 1), ("R", -1))
        for k in range(COLUMNS)
    }


def scene_xml(seed: int) -> str:
    """The scan: boxes on a floor."""
    spec = mujoco.MjSpec()
    spec.modelname = "scene"
    _floor(spec)
    for name, (x, y, top) in stakes(seed).items():
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, top / 2],
            size=[*HALF, top / 2],
            friction=[0.9, 0.005, 0.0001],
        )
    spec.compile()
    return spec.to_xml()


def robot_spec() -> Any:
    """The nominal robot on a floor, its servos stiff enough to stand still."""
    spec = quadruped().spec
    for key in list(spec.keys):
        spec.delete(key)
    for actuator in spec.actuators:
        actuator.gainprm[0] = KP
        actuator.biasprm[:3] = [0, -KP, -KD]
        actuator.forcerange = [-80, 80]
    spec.option.timestep = 0.002
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 20.0  # feet that hold do not creep
    return spec


def _floor(spec: Any) -> None:
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])


def _world(truth: Truth, seed: int, rng: np.random.Generator) -> Any:
    spec = robot_spec()
    _floor(spec)
    for body in spec.bodies:
        if body.mass > 0:
            body.mass *= 1 + truth.everyday * 0.01 * rng.normal()
    for name, (x, y, top) in stakes(seed).items():
        top += truth.height.get(name, 0.0) + truth.everyday * 0.0015 * rng.normal()
        turn = exp_so3([*truth.tilt.get(name, (0.0, 0.0)), 0.0])
        body = spec.worldbody.add_body(name=name, pos=[x, y, top], quat=R_to_quat(turn), gravcomp=1.0)
        body.mass, body.inertia, body.explicitinertial = 1.0, np.full(3, 0.01), True
        if name in truth.sinks:
            k = truth.sinks[name]
            body.add_joint(
                type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], stiffness=[k, 0, 0], damping=[0.03 * k, 0, 0]
            )
        if name in truth.rocks:
            k = truth.rocks[name]
            for axis in ([1, 0, 0], [0, 1, 0]):
                body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, pos=[0, 0, -0.2], stiffness=[k, 0, 0],
                               damping=[0.03 * k, 0, 0])  # fmt: skip
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0, 0, -0.08], size=[*HALF, 0.08], priority=1,
            friction=[truth.friction.get(name, 0.9), 0.005, 0.0001],
        )  # fmt: skip
    return spec.compile()


def leg_angles(leg: str, foot: np.ndarray) -> np.ndarray:
    """(3,) rad that bring the foot's centre to a place relative to the trunk, m."""
    front, left = LEGS[leg]
    x, y, z = foot - np.array([front * HIP_AT[0], left * HIP_AT[1], 0.0])
    d = left * THIGH_OFFSET_M
    down = np.sqrt(max(y * y + z * z - d * d, 1e-4))
    hip = np.arctan2(z, y) - np.arctan2(-down, d)
    hip = (hip + np.pi) % (2 * np.pi) - np.pi
    cosine = np.clip((x * x + down * down - THIGH_M**2 - CALF_M**2) / (2 * THIGH_M * CALF_M), -1, 1)
    knee = -np.arccos(cosine)
    thigh = np.arctan2(-x, down) - np.arctan2(CALF_M * np.sin(knee), THIGH_M + CALF_M * np.cos(knee))
    return np.array([hip, thigh, knee])


def _touches(model: Any, data: Any, body: int) -> bool:
    return any(body in model.geom_bodyid[data.contact[c].geom] for c in range(data.ncon))


def _smooth(share: float) -> float:
    share = min(max(share, 0.0), 1.0)
    return share * share * (3 - 2 * share)


def cross(
    folder: Path, name: str, truth: Truth, terrain_seed: int, seed: int, cycles: int = 5, depth: bool = False
) -> dict[str, Any]:
    """Crawl once over the stakes and write the run to `folder`/runs/NAME.npz."""
    world = np.random.default_rng(1000 + terrain_seed)  # one terrain and one robot for all crossings
    model = _world(truth, terrain_seed, world)
    zero = truth.everyday * 0.003 * world.normal(size=12)
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    tops = stakes(terrain_seed)
    legs = list(LEGS)
    at = {leg: (0 if leg[0] == "R" else 3) for leg in legs}
    side = {leg: leg[1] for leg in legs}

    def place(leg: str, column: int) -> np.ndarray:
        x, y, top = tops[f"stake_{side[leg]}{column}"]
        aim = rng.uniform(-1, 1, 2) * [0.02, 0.03]  # nobody steps on the same spot twice
        return np.array([x + aim[0], y + aim[1], top + FOOT_RADIUS_M])

    body = np.array([0.0, 0.0, 0.2 + STANCE])
    first = {leg: place(leg, at[leg]) for leg in legs}
    base = slice(int(model.jnt_qposadr[np.flatnonzero(model.jnt_type == 0)[0]]), None)
    base = slice(base.start, base.start + 7)
    joints = [model.joint(model.actuator(i).name) for i in range(model.nu)]
    qadr = np.array([j.qposadr[0] for j in joints])
    data.qpos[base] = [*body, 1, 0, 0, 0]
    data.qpos[qadr] = np.concatenate([leg_angles(leg, first[leg] - body) for leg in legs])
    mujoco.mj_forward(model, data)
    log = _Log(model, qadr, zero, truth, rng, _Eye(model, truth, rng) if depth else None)
    ids = [model.body(f"{leg}_foot").id for leg in legs]
    hold = round(1 / RATE / model.opt.timestep)
    command = data.qpos[qadr].copy()
    logged = False

    def step() -> None:
        data.ctrl[:] = command - zero  # the servo believes its encoder
        for _ in range(hold):
            mujoco.mj_step(model, data)
        if logged:
            log.note(data, command, ids)

    def run(seconds: float, swing: str = "", target: np.ndarray | None = None) -> None:
        """Move the trunk over the middle of the feet that stand, level, from where the robot really is; or one foot."""
        nonlocal command
        begin, R0 = data.qpos[base][:3].copy(), quat_to_R(data.qpos[base][3:7])
        stand = {leg: data.xpos[i].copy() for leg, i in zip(legs, ids, strict=True) if leg != swing}
        sag = command - data.qpos[qadr]  # what the servos give way under the load
        support = [foot for leg, foot in stand.items() if leg != lifts]
        middle = np.mean(support, axis=0)
        goal = begin if swing else np.array([*(0.1 * begin[:2] + 0.9 * middle[:2]), middle[2] - FOOT_RADIUS_M + STANCE])
        tilted = Rotation.from_matrix(R0).as_rotvec()
        lean = 0.5 * tilted
        start = data.xpos[ids[legs.index(swing)]].copy() if swing else np.zeros(3)
        steps = round(seconds * RATE)
        for i in range(steps):
            share = (i + 1) / steps
            trunk = begin + _smooth(share) * (goal - begin)
            R = exp_so3(tilted - _smooth(share) * lean)
            wanted = {leg: leg_angles(leg, R.T @ (foot - trunk)) + sag[3 * k : 3 * k + 3]
                      for k, leg in enumerate(legs) if (foot := stand.get(leg)) is not None}  # fmt: skip
            if swing and target is not None:
                over = start + _smooth((share - 0.2) / 0.45) * (target - start)
                high = max(start[2], target[2]) + LIFT
                down = _smooth((share - 0.6) / 0.4)
                z = (
                    start[2] + _smooth(share / 0.3) * (high - start[2])
                    if share < 0.6
                    else high + down * (target[2] - high)
                )
                now, turn = data.qpos[base][:3], quat_to_R(data.qpos[base][3:7])
                wanted[swing] = leg_angles(swing, turn.T @ (np.array([over[0], over[1], z]) - now))
            command = np.concatenate([wanted[leg] for leg in legs])
            step()
            if swing and share > 0.75 and _touches(model, data, ids[legs.index(swing)]):
                return
        for _ in range(int(REACH_DOWN / 0.002) if swing and target is not None else 0):
            # What stands lower than scanned is felt for.
            if _touches(model, data, ids[legs.index(swing)]):
                return
            target = target - [0, 0, 0.002]
            now, turn = data.qpos[base][:3], quat_to_R(data.qpos[base][3:7])
            k = legs.index(swing)
            command[3 * k : 3 * k + 3] = leg_angles(swing, turn.T @ (target - now))
            step()

    lifts = ""
    for _ in range(4):
        run(0.3)
    logged = True
    run(0.4)
    for _ in range(cycles):
        for leg in ORDER:
            lifts = leg
            run(SHIFT_S)
            at[leg] += 1
            run(SWING_S, leg, place(leg, at[leg]))
    lifts = ""
    run(0.5)
    arrays = log.arrays()
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "runs" / f"{name}.npz", **arrays)
    return {"upright": bool(quat_to_R(data.qpos[base][3:7])[2, 2] > 0.9), "x": float(data.qpos[base][0])}


class _Log:
    """Readings with noise, offsets that stay for the run, and an estimate of the base that drifts."""

    def __init__(
        self, model: Any, qadr: np.ndarray, zero: np.ndarray, truth: Truth, rng: np.random.Generator, eye: Any
    ) -> None:
        self.model, self.qadr, self.zero, self.rng, self.eye = model, qadr, zero, rng, eye
        e = truth.everyday
        self.offset = e * rng.normal(size=3) * [0.004, 0.004, 0.02]
        self.drift = e * rng.normal(size=3) * [0.001, 0.001, 0.001]
        self.tilt = exp_so3(e * rng.normal(size=3) * [0.005, 0.005, 0.003])
        self.rows: dict[str, list[np.ndarray]] = {
            k: [] for k in ("command", "joint_pos", "joint_torque", "base_pos", "base_quat", "contact")
        }

    def note(self, data: Any, command: np.ndarray, feet: list[int]) -> None:
        rng, t = self.rng, len(self.rows["command"]) / RATE
        free = int(self.model.jnt_qposadr[np.flatnonzero(self.model.jnt_type == 0)[0]])
        force = np.zeros((len(feet), 6))
        for c in range(data.ncon):
            for geom in data.contact[c].geom:
                body = int(self.model.geom_bodyid[geom])
                if body in feet:
                    wrench = np.zeros(6)
                    mujoco.mj_contactForce(self.model, data, c, wrench)
                    force[feet.index(body)] += wrench
        self.rows["command"].append(command)
        self.rows["joint_pos"].append(data.qpos[self.qadr] + self.zero + 0.0005 * rng.normal(size=len(self.qadr)))
        self.rows["joint_torque"].append(
            data.actuator_force * (1 + 0.03 * rng.normal(size=len(self.qadr))) + 0.05 * rng.normal(size=len(self.qadr))
        )
        self.rows["base_pos"].append(
            data.qpos[free : free + 3] + self.offset + self.drift * t + 0.001 * rng.normal(size=3)
        )
        R = self.tilt @ quat_to_R(data.qpos[free + 3 : free + 7]) @ exp_so3(0.001 * rng.normal(size=3))
        self.rows["base_quat"].append(R_to_quat(R))
        self.rows["contact"].append((force[:, 0] > 3.0).astype(float))
        if self.eye is not None:
            self.eye.note(data, t)

    def arrays(self) -> dict[str, np.ndarray]:
        found = {k: np.array(v) for k, v in self.rows.items()}
        found["time"] = np.arange(len(found["command"])) / RATE
        return found | (self.eye.arrays() if self.eye is not None else {})


class _Eye:
    """The depth camera as it truly is; filled in by `note`, a frame every 1/DEPTH_HZ s."""

    def __init__(self, model: Any, truth: Truth, rng: np.random.Generator) -> None:
        self.model, self.truth, self.rng = model, truth, rng
        self.past: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.frames: list[np.ndarray] = []
        self.times: list[float] = []
        self.seen = model.geom_group.copy()
        rows, columns = np.mgrid[: DEPTH_SHAPE[0], : DEPTH_SHAPE[1]]
        fx, cx, cy = focal(model), (DEPTH_SHAPE[1] - 1) / 2, (DEPTH_SHAPE[0] - 1) / 2
        self.rays = np.stack([(columns - cx) / fx, (rows - cy) / fx, np.ones(DEPTH_SHAPE)], -1).reshape(-1, 3)

    def note(self, data: Any, t: float) -> None:
        camera = self.model.camera("head").id
        mujoco.mj_kinematics(self.model, data)  # a step leaves places as they were before it
        mujoco.mj_camlight(self.model, data)
        R = data.cam_xmat[camera].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's axes to OpenCV's
        R, place = R @ exp_so3(self.truth.camera_turn), data.cam_xpos[camera] + R @ np.array(self.truth.camera_shift)
        self.past.append((t, R.copy(), place.copy()))
        if round(t * RATE) % (RATE // DEPTH_HZ) == 0:
            when = t - self.truth.camera_delay
            taken = min(self.past, key=lambda item: abs(item[0] - when))
            if abs(taken[0] - when) < 0.5 / RATE + 1e-9:
                self.frames.append(self._image(data, taken[1], taken[2]))
                self.times.append(t)

    def _image(self, data: Any, R: np.ndarray, place: np.ndarray) -> np.ndarray:
        still = [self.model.body_weldid[b] == 0 or self.model.body(int(b)).name.startswith("stake")
                 for b in self.model.geom_bodyid]  # fmt: skip
        self.model.geom_group[:] = np.where(still, 0, 5)
        only, count = np.array([1, 0, 0, 0, 0, 0], np.uint8), len(self.rays)
        geom, along = np.zeros(count, np.int32), np.zeros(count)
        mujoco.mj_multiRay(
            self.model, data, place, (self.rays @ R.T).ravel(), only, 1, -1, geom, along, None, count, 1e3
        )
        self.model.geom_group[:] = self.seen
        z = along + self.truth.depth_noise * noise_of(along) * self.rng.normal(size=len(along))
        z[(along <= 0) | (along > DEPTH_FAR) | (self.rng.random(len(z)) < 0.01)] = 0.0
        return z.reshape(DEPTH_SHAPE).astype(np.float32)

    def arrays(self) -> dict[str, np.ndarray]:
        return {"depth_time": np.array(self.times), "depth": np.array(self.frames)}


def focal(model: Any) -> float:
    """Pixels."""
    fovy = float(model.cam_fovy[model.camera("head").id])
    return DEPTH_SHAPE[0] / 2 / np.tan(np.radians(fovy) / 2)


def noise_of(z: np.ndarray) -> np.ndarray:
    """m, standard deviation of a healthy camera at a distance."""
    return 0.002 + 0.002 * z**2


def make_case(
    folder: Path,
    truth: Truth,
    *,
    crossings: int = 10,
    terrain_seed: int = 0,
    seed: int = 0,
    depth: bool = False,
    cycles: int = 5,
) -> Path:
    """Write `folder`/case and `folder`/scene.xml; returns the case's folder."""
    case = folder / "case"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.xml").write_text(scene_xml(terrain_seed))
    spec = robot_spec()
    _floor(spec)
    model = spec.compile()
    names = [model.actuator(i).name for i in range(model.nu)]
    said: dict[str, Any] = {}
    if depth:
        f = focal(model)
        said["depth_camera"] = {
            "camera": "head", "fx": f, "fy": f, "cx": (DEPTH_SHAPE[1] - 1) / 2, "cy": (DEPTH_SHAPE[0] - 1) / 2,
            "noise": [0.002, 0.0, 0.002], "far": DEPTH_FAR,
        }  # fmt: skip
    feet = [f"{leg}_foot" for leg in LEGS]
    write_case(case, spec.to_xml(), {}, joint_names=names, torque_kind="measured", contact_bodies=feet, **said)
    for i in range(crossings):
        end = cross(case, f"crossing_{i + 1:02d}", truth, terrain_seed, 100 * seed + i, cycles, depth)
        if not end["upright"]:
            raise RuntimeError(f"the robot fell on crossing {i + 1}: {end}")
    return case
