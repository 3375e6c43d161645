"""Small logs of robots that development never had, each with one plain mistake of a user in its model.

    python -m benchmarks.diagnosis.strangers --jobs 2                    # all, some 25 minutes of two cores
    python -m benchmarks.diagnosis.strangers --only scara_gain crane_none --store rows.json

Robots are MuJoCo's at a finer step, with everyday deviations, coarse encoders, slow logs, filtered speeds or none. What
this engine has answered is not diagnosed again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.diagnosis.pool import Job
from benchmarks.diagnosis.put_in import answer_all, options
from benchmarks.store import Store
from realsim.gap.provenance import engine
from tests.truths.small_robots import (
    CARTPOLE,
    CRANE,
    DIRECT,
    ELASTIC,
    GANTRY,
    GRIPPER,
    HEXAPOD,
    ROVER,
    SCARA,
    TURRET,
    WRIST,
)
from tests.truths.written import write_case

RESULTS = Path(__file__).parents[1] / "results" / "gap_strangers.json"
FINE = 5e-4
"""s of the true robot's step."""
RUNS = ("sines", "steps", "slow", "sines")
Array = np.ndarray
Change = Callable[[Any], None]
"""Edits the true robot's MjSpec."""


@dataclass(frozen=True)
class Robot:
    """A model that its user believes in, and how the robot is driven."""

    xml: str
    home: tuple[float, ...]
    """Of each driven joint, rad or m."""
    reach: tuple[float, ...]
    """Largest excursion from there."""
    kind: str = "position"
    pd: tuple[float, float] = (0.0, 0.0)
    """Of robots driven by torque, or by speed (whose second is 0): gains of the controller that wants the motion."""
    base: str = "fixed"


@dataclass(frozen=True)
class Log:
    """What the robot's computer writes."""

    rate: float = 100.0
    tick: float = 0.0015
    """rad or m of an encoder's step."""
    speed: str = "none"
    """`none`, or `filtered`: the encoder's differences through a low-pass of 20 ms."""
    seconds: float = 5.0
    gaps: tuple[float, ...] = ()
    """Moments, s, from which 0.16 s of each run were not logged."""
    dropped: float = 0.0
    """Share of rows that were lost."""
    pairs: bool = False
    """Whether the bus hands over samples by twos, under one stamp."""


@dataclass(frozen=True)
class Mistake:
    """How the robot differs from its model."""

    robot: str
    effect: str = ""
    """Of the library; empty where nothing was put in, or `outside` where the library has nothing like it."""
    change: Change = field(default=lambda spec: None)
    alike: tuple[str, ...] = ()
    """Effects at the same place that move this robot nearly as much alike."""
    joints: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    delay: float = 0.0
    offset: tuple[tuple[str, float], ...] = ()
    """(joint, rad) that its encoder reads too much."""
    log: Log = field(default_factory=Log)

    @property
    def label(self) -> dict[str, Any]:
        places = {"joints": list(self.joints) or None, "bodies": list(self.bodies) or None}
        effects = [{"effect": self.effect, **places}] if self.effect not in ("", "outside") else []
        cls = {"": "none", "outside": "outside"}.get(self.effect, "single")
        alike = [[{"effect": a, "joints": None, "bodies": None} for a in self.alike]] if effects else []
        return {"effects": effects, "alike": alike, "visibility": [], "cls": cls, "visible": True,
                "log": self.robot, "part": "strangers"}  # fmt: skip


# ---------------------------------------------------------------- robots


ROBOTS = {
    "scara": Robot(SCARA, (0.2, -0.4, -0.05, 0), (0.7, 0.8, 0.06, 0.9)),
    "gripper": Robot(GRIPPER, (0.02,), (0.015,)),
    "hexapod": Robot(HEXAPOD, (0, -0.3, 1.2), (0.5, 0.5, 0.5)),
    "cartpole": Robot(CARTPOLE, (0,), (0.12,), "torque", (60, 12)),
    "gantry": Robot(GANTRY, (0, 0, 0), (0.25, 0.2, 0.12)),
    "elastic": Robot(ELASTIC, (0.3,), (0.7,)),
    "turret": Robot(TURRET, (0, 0), (0.9, 0.5), "velocity", (2.0, 0)),
    "direct": Robot(DIRECT, (0.4, -0.8), (0.5, 0.6), "torque", (35, 1.2)),
    "crane": Robot(CRANE, (0, 0.1), (0.6, 0.25)),
    "rover": Robot(ROVER, (0, 0), (3, 3), "velocity", (1.0, 0), "floating"),
    "wrist": Robot(WRIST, (0, 0.2, 0), (0.8, 0.6, 1.0)),
}


# ---------------------------------------------------------------- mistakes


def _drive(actuator: str, kp: float = 1.0, kd: float = 1.0) -> Change:
    """Stiffness and damping of a servo times these; a torque's or a speed's gain times `kp`."""

    def change(spec: Any) -> None:
        a = spec.actuator(actuator)
        speed_servo = a.biasprm[1] == 0 and a.biasprm[2] != 0
        a.gainprm = a.gainprm * kp
        a.biasprm = a.biasprm * np.array([1, kp, kp if speed_servo else kd, *[1] * 7])

    return change


def _joints(names: Sequence[str], **more: float) -> Change:
    def change(spec: Any) -> None:
        for joint in (spec.joint(n) for n in names):
            for key, by in more.items():
                if key == "damping":
                    joint.damping = np.asarray(joint.damping) + np.array([by, *[0] * (np.size(joint.damping) - 1)])
                else:
                    setattr(joint, key, getattr(joint, key) + by)

    return change


def _limit(actuator: str, force: float) -> Change:
    def change(spec: Any) -> None:
        spec.actuator(actuator).forcerange = [-force, force]

    return change


def _body(name: str, mass: float = 0.0, at: Sequence[float] = (0, 0, 0), com: Sequence[float] = (0, 0, 0),
          inertia: float = 1.0) -> Change:  # fmt: skip
    def change(spec: Any) -> None:
        body = spec.body(name)
        body.ipos, body.inertia = body.ipos + np.array(com), body.inertia * inertia
        if mass:
            load = body.add_body(pos=at, mass=mass, inertia=np.full(3, 1e-5 * mass), explicitinertial=1)
            load.ipos, load.iquat = np.zeros(3), np.array([1.0, 0, 0, 0])

    return change


def _play(joint: str, width: float) -> Change:
    """A rotor behind play of this width, which the servo turns; the log is of the link."""

    def change(spec: Any) -> None:
        link = spec.joint(joint)
        body = spec.worldbody.add_body(mass=1e-4, inertia=np.full(3, 1e-8), explicitinertial=1)
        body.ipos, body.iquat = np.zeros(3), np.array([1.0, 0, 0, 0])
        rotor = body.add_joint(name="rotor", axis=[0, 0, 1], armature=link.armature, frictionloss=link.frictionloss)
        rotor.damping, link.damping = link.damping, np.zeros(np.size(link.damping))
        link.frictionloss, link.armature = 0.0, 1e-4
        gear = spec.add_tendon(limited=1, range=[-width / 2, width / 2], solref_limit=[0.003, 1])
        gear.wrap_joint("rotor", 1.0)
        gear.wrap_joint(joint, -1.0)
        spec.actuator(f"m_{joint}").target = "rotor"

    return change


def _weightless(spec: Any) -> None:
    """The user's model has no gravity compensation, the robot's controller has."""
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0


HOBBY = Log(rate=30, tick=0.0051)
FILTERED = Log(rate=200, tick=0.0006, speed="filtered")
SLIDES = Log(rate=125, tick=5e-5)
CASES = {
    "scara_none": Mistake("scara", log=FILTERED),
    "scara_kp": Mistake("scara", "stiffness_gain", _drive("m_j2", kp=0.7), ("motor_gain",), ("j2",), log=FILTERED),
    "scara_mass": Mistake("scara", "payload", _body("tool", 0.7), ("link_inertia", "com_offset"),
                          bodies=("tool", "quill")),
    "scara_friction": Mistake("scara", "coulomb_friction", _joints(["z"], frictionloss=9), joints=("z",), log=FILTERED),
    "gripper_friction": Mistake("gripper", "coulomb_friction", _joints(["left_slide", "right_slide"], frictionloss=1.2),
                                joints=("left_slide", "right_slide"), log=SLIDES),
    "gripper_gain": Mistake("gripper", "tendon_gain", _drive("grip", 0.6, 0.6), log=SLIDES),
    "hexapod_none": Mistake("hexapod", log=HOBBY),
    "hexapod_backlash": Mistake("hexapod", "backlash", _play("tibia_pitch", 0.05), joints=("tibia_pitch",), log=HOBBY),
    "hexapod_late": Mistake("hexapod", "command_delay", alike=("observation_delay", "actuator_lag"), delay=0.06,
                            log=HOBBY),
    "cartpole_none": Mistake("cartpole", log=Log(rate=100, tick=0.0004)),
    "cartpole_viscous": Mistake("cartpole", "viscous_friction", _joints(["rail"], damping=7), joints=("rail",),
                                log=Log(tick=0.0004)),
    "cartpole_gain": Mistake("cartpole", "motor_gain", _drive("belt", 0.75), joints=("rail",), log=Log(tick=0.0004)),
    "cartpole_pole": Mistake("cartpole", "com_offset", _body("pole", com=(0, 0, -0.06)),
                             ("link_geometry", "payload", "link_inertia"), bodies=("pole",), log=Log(tick=0.0008)),
    "gantry_limit": Mistake("gantry", "torque_limit", _limit("m_x", 75), joints=("x",), log=SLIDES),
    "gantry_mass": Mistake("gantry", "payload", _body("ram", 1.6), ("external_force",), bodies=("ram",), log=SLIDES),
    "gantry_gaps": Mistake("gantry", "coulomb_friction", _joints(["y"], frictionloss=60), joints=("y",),
                           log=Log(rate=125, tick=5e-5, gaps=(1.7, 3.3))),
    "elastic_none": Mistake("elastic"),
    "elastic_armature": Mistake("elastic", "armature", _joints(["motor"], armature=0.09), joints=("motor",)),
    "elastic_mass": Mistake("elastic", "payload", _body("arm", 0.35, (0, 0, -0.35)), ("link_inertia", "com_offset"),
                            bodies=("arm",), log=Log(dropped=0.05)),
    "turret_gain": Mistake("turret", "motor_gain", _drive("m_tilt", 0.5), ("damping_gain",), ("tilt",), log=FILTERED),
    "turret_com": Mistake("turret", "com_offset", _body("cradle", com=(0.04, 0, 0)), ("payload", "external_force"),
                          bodies=("cradle",)),
    "turret_late": Mistake("turret", "command_delay", alike=("observation_delay", "actuator_lag"), delay=0.05,
                           log=Log(pairs=True)),
    "direct_none": Mistake("direct", log=FILTERED),
    "direct_friction": Mistake("direct", "coulomb_friction", _joints(["knee"], frictionloss=0.35), joints=("knee",),
                               log=FILTERED),
    "direct_gain": Mistake("direct", "motor_gain", _drive("m_hip", 0.8), joints=("hip",), log=FILTERED),
    "direct_armature": Mistake("direct", "armature", _joints(["hip", "knee"], armature=0.02), ("link_inertia",),
                               ("hip", "knee"), log=Log(rate=200, tick=0.0006)),
    "crane_none": Mistake("crane", log=Log(rate=50, tick=0.001)),
    "crane_damping": Mistake("crane", "damping_gain", _drive("m_slew", kd=0.4), ("viscous_friction",), ("slew",),
                             log=Log(rate=50, tick=0.001)),
    "crane_load": Mistake("crane", "payload", _body("load", 0.6, (0, 0, -0.5)), ("link_inertia",), bodies=("load",),
                          log=Log(rate=50, tick=0.001)),
    "rover_none": Mistake("rover"),
    "rover_gain": Mistake("rover", "motor_gain", _drive("m_left", 0.5), ("damping_gain",), ("left",)),
    "rover_friction": Mistake("rover", "coulomb_friction", _joints(["left", "right"], frictionloss=0.7),
                              joints=("left", "right"), log=Log(rate=50)),
    "wrist_gravity": Mistake("wrist", "outside", _weightless),
    "wrist_kp": Mistake("wrist", "stiffness_gain", _drive("m_pitch", kp=0.6), ("motor_gain",), ("pitch",),
                        log=Log(gaps=(1.4, 3.0))),
    "wrist_com": Mistake("wrist", "com_offset", _body("flange", com=(0, 0, 0.04)), ("payload",), bodies=("flange",)),
    "wrist_viscous": Mistake("wrist", "viscous_friction", _joints(["roll"], damping=0.7), ("damping_gain",), ("roll",),
                             log=HOBBY),
}  # fmt: skip


# ---------------------------------------------------------------- logs


def make(name: str, folder: Path) -> Path:
    """Write the case of a mistake; the same whenever it is made."""
    case = CASES[name]
    robot, rng = ROBOTS[case.robot], np.random.default_rng(sum(map(ord, name)))
    spec = mujoco.MjSpec.from_string(robot.xml)
    nominal = spec.copy().compile()
    joints = [nominal.joint(i).name for i in range(nominal.njnt) if nominal.jnt_type[i] in (2, 3)]
    _scatter(spec, rng)
    case.change(spec)
    spec.option.timestep = FINE
    real = spec.compile()
    runs = {
        f"run_{k + 1}": _run(real, robot, case, joints, _wanted(kind, robot, case.log.seconds, rng), rng)
        for k, kind in enumerate(RUNS)
    }
    return write_case(folder, robot.xml, runs, command_kind=robot.kind, base=robot.base)


def _scatter(spec: Any, rng: np.random.Generator) -> None:
    """What robots of one kind differ by."""
    for joint in spec.joints:
        joint.frictionloss *= 1 + 0.04 * rng.normal()
        joint.damping = np.asarray(joint.damping) * (1 + 0.04 * rng.normal())
        joint.armature *= 1 + 0.02 * rng.normal()
    for body in spec.bodies[1:]:
        scale = 1 + 0.01 * rng.normal()
        body.mass, body.inertia, body.ipos = body.mass * scale, body.inertia * scale, body.ipos + rng.normal(0, 5e-4, 3)
    for actuator in spec.actuators:
        scale = 1 + 0.01 * rng.normal()
        actuator.gainprm, actuator.biasprm = actuator.gainprm * scale, actuator.biasprm * scale


def _wanted(kind: str, robot: Robot, seconds: float, rng: np.random.Generator) -> Callable[[float], Array]:
    """Where the driven joints should be at a moment."""
    size, home = np.array(robot.reach), np.array(robot.home)
    f, phase, level = rng.uniform(0.25, 1.2, (2, len(size))), rng.uniform(0, 6, (2, len(size))), rng.uniform(-1, 1, 99)

    def at(t: float) -> Array:
        ramp = np.clip((t - 0.4) / 0.4, 0, 1)
        if kind == "sines":
            y = np.sin(2 * np.pi * f * t + phase).sum(axis=0) / 2
        elif kind == "steps":
            y = np.array([level[(int(t / 0.8) + 7 * u) % 99] for u in range(len(size))])
        else:
            y = 2 * np.abs(2 * ((t / 3.0 + phase[0] / 6) % 1) - 1) - 1
        return np.asarray(home + ramp * size * y)

    return at


def _run(
    real: Any, robot: Robot, case: Mistake, joints: Sequence[str], wanted: Callable[[float], Array],
    rng: np.random.Generator,
) -> dict[str, Array]:  # fmt: skip
    """One run: the computer reads, commands, and writes both down, `rate` times a second."""
    log, data = case.log, mujoco.MjData(real)
    rows = [real.joint(j).qposadr[0] for j in joints]
    driven = _driven(robot)
    at = [joints.index(j) for j in driven]
    offset = np.array([dict(case.offset).get(j, 0.0) for j in joints])
    data.qpos[[rows[k] for k in at]] = wanted(0.0)[: len(driven)]
    if "rotor" in (real.joint(i).name for i in range(real.njnt)):
        data.qpos[real.joint("rotor").qposadr[0]] = wanted(0.0)[-1]
    shift = np.array([dict(case.offset).get(j, 0.0) for j in driven])[: real.nu]
    every, settle = round(1 / log.rate / FINE), round(0.8 / FINE)
    late, sent = round(case.delay / FINE), list[Array]()
    kept: dict[str, list[Array]] = {"time": [], "command": [], "joint_pos": []}
    before = np.zeros(len(joints))
    command = wanted(0.0) if robot.kind == "position" else np.zeros(real.nu)
    for k in range(settle + int(log.seconds / FINE)):
        now = (k - settle) * FINE
        if k % every == settle % every:
            read = np.round((data.qpos[rows] + offset) / log.tick) * log.tick
            command = _command(robot, wanted, max(now, 0.0), read[at], (read - before)[at] * log.rate)
            before = read
            if k >= settle:
                stamp = now + abs(rng.normal(0, 1e-4))
                for name, value in (("time", stamp), ("command", command), ("joint_pos", read)):
                    kept[name].append(np.asarray(value))
                if robot.base == "floating":  # by cameras
                    kept.setdefault("base_pos", []).append(data.qpos[:3] + rng.normal(0, 1e-3, 3))
                    kept.setdefault("base_quat", []).append(data.qpos[3:7] + rng.normal(0, 1e-3, 4))
        sent.append(command)
        data.ctrl[:] = sent[max(k - late, 0)] - (shift if robot.kind == "position" else 0.0)
        mujoco.mj_step(real, data)
    found = {name: np.array(values) for name, values in kept.items()}
    if log.speed == "filtered":
        rate, speed = np.gradient(found["joint_pos"], 1 / log.rate, axis=0), np.zeros(len(joints))
        keep = np.exp(-1 / log.rate / 0.02)
        found["joint_vel"] = np.array([speed := keep * speed + (1 - keep) * r for r in rate])
    return _written(found, log, rng)


def _driven(robot: Robot) -> list[str]:
    """Joints with a drive, in the order of the actuators."""
    model = mujoco.MjModel.from_xml_string(robot.xml)
    if model.ntendon:
        return [model.joint(i).name for i in range(model.njnt)][:1]
    return [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]


def _command(robot: Robot, wanted: Callable[[float], Array], now: float, read: Array, speed: Array) -> Array:
    """(U,) what a computer sends that wants the robot there, and reads where it is."""
    there = wanted(now)
    if robot.kind == "position":
        return there
    ahead = (wanted(now + 0.01) - there) / 0.01
    if robot.kind == "velocity":
        return np.clip(ahead + robot.pd[0] * (there - read), -3, 3)
    return robot.pd[0] * (there - read) + robot.pd[1] * np.clip(ahead - speed, -5, 5)


def _written(found: dict[str, Array], log: Log, rng: np.random.Generator) -> dict[str, Array]:
    """What of it reaches the file."""
    time = found["time"]
    keep = rng.random(len(time)) >= log.dropped
    for begin in log.gaps:
        keep &= (time < begin) | (time > begin + 0.16)
    found = {name: values[keep] for name, values in found.items()}
    if log.pairs:
        found["time"] = np.repeat(found["time"][1::2], 2)[: len(found["time"])]
        found = {name: values[: len(found["time"])] for name, values in found.items()}
    return found


# ---------------------------------------------------------------- figures


def judged(label: dict[str, Any], row: dict[str, Any]) -> str:
    """As for errors put in; what the library has nothing like is right where something stays unexplained."""
    if label["cls"] != "outside":
        return str(row["judged"])
    return "outside, said" if row["verdict"] in ("unexplained", "partly_explained", "refused") else "outside, named"


def main() -> int:
    parser = options(__doc__, "out/gap_strangers")
    parser.set_defaults(store=RESULTS)
    parser.add_argument("--seconds", type=int, default=240, help="CPU time of a case; then it counts as crashed")
    args = parser.parse_args()
    names = args.only or list(CASES)
    made = {n: make(n, args.work / "cases" / n) for n in names}
    jobs = {n: Job(case, args.work / engine() / n, seconds=args.seconds) for n, case in made.items()}

    def kept(name: str, row: dict[str, Any]) -> dict[str, Any]:
        label = CASES[name].label
        row = row | {"judged": judged(label, row), "truth": row["truth"] or [label["cls"]]}
        return {k: v for k, v in row.items() if k not in ("settings", "said", "alike")}

    answer_all(args, jobs, {n: CASES[n].label for n in names}, Store(args.store, ("case",)), kept)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
