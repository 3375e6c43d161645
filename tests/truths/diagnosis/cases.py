"""Draws cases by stratum, and writes logs in the contract's form here and labels elsewhere."""

import copy
import itertools
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from realsim.core.files import write_text
from tests.truths.diagnosis import causes
from tests.truths.diagnosis.motions import KINDS, motion, sample_times
from tests.truths.diagnosis.plant import Plant, Trace
from tests.truths.diagnosis.robots import ROBOTS, Robot
from tests.truths.diagnosis.truth import Truth
from tests.truths.written import write_case

STRATA = {"none": 0.2, "single": 0.4, "double": 0.15, "outside": 0.125, "confounded": 0.125}
"""Stratum -> share of the cases."""
ROBOT_SHARE = {"pendulum": 0.25, "arm2": 0.27, "arm6": 0.25, "quadruped": 0.15, "g1": 0.08}
VISIBLE = 2.0
"""A cause must change some signal by this many times what sensors and the everyday deviations do (root mean square)."""

SAME = 0.5
"""Two causes leave the same log if they differ by less than this, in the same unit."""


@dataclass(frozen=True)
class Sensors:
    """What the log holds and how well it was measured."""

    rate: float
    velocity: bool
    torque_kind: str
    torque_constant: float
    mocap: bool
    noise: float
    """rad, standard deviation of a joint's reading."""
    bits: int
    """Encoder resolution, bits a turn."""
    louder: float = 1.0
    """Ratio on the noise of all other sensors."""


@dataclass(frozen=True)
class Draw:
    """What a case is to be."""

    stratum: str
    robot: str
    seed: int
    turn: int
    """How many cases of this stratum and robot stand before it: the causes take turns, so that all of them come up."""


def plan(count: int, seed: int) -> list[Draw]:
    """Every case, interleaved so that any prefix is a fair sample."""
    rng = np.random.default_rng(seed)
    strata = _shares(STRATA, count)
    robots = _shares(ROBOT_SHARE, count)
    rng.shuffle(strata)
    rng.shuffle(robots)
    pairs = list(zip(strata, robots, strict=True))
    return [Draw(s, r, seed * 100_003 + i, pairs[:i].count((s, r))) for i, (s, r) in enumerate(pairs)]


def _shares(shares: dict[str, float], count: int) -> list[str]:
    edges = np.round(np.cumsum(list(shares.values())) * count).astype(int)
    names = list(shares)
    return [names[int(np.searchsorted(edges, i, side="right"))] for i in range(count)]


def make_labelled(index: int, draw: Draw, work: Path, deviations: float = 1.0, noise: float = 1.0) -> str:
    """Case number `index` of a benchmark's folder, with its label apart from it; what to say of it.

    One that is labelled is left alone, so that a run goes on where it ended.
    """
    name = f"case_{index:03d}"
    file = work / "labels" / f"{name}.json"
    if file.is_file():
        return f"{name}: made before"
    try:
        label = make_case(draw, work / "cases" / name, deviations=deviations, noise=noise)
    except RuntimeError as error:
        return f"{name}: {error}"
    write_text(file, json.dumps(label, indent=1, default=float) + "\n")
    return f"{name}: {draw.stratum} {draw.robot}"


def read_labels(work: Path) -> dict[str, Any]:
    """Label by name of all cases of a benchmark's folder."""
    return {f.stem: json.loads(f.read_text()) for f in sorted((work / "labels").glob("*.json"))}


def make_case(draw: Draw, folder: Path, runs: int = 6, deviations: float = 1.0, noise: float = 1.0) -> dict[str, Any]:
    """Write one case below `folder`; its label is returned, not written there.

    A draw whose robot falls over or whose cause leaves no trace beyond the nuisances' is drawn again: three times with
    the same causes, then with the next ones. `deviations` and `noise` are ratios on the everyday deviations and on the
    sensors' noise: the draw is judged without them, so that cases of several ratios differ in nothing else.
    """
    for attempt in range(15):
        rng = np.random.default_rng([draw.seed, attempt])
        robot = ROBOTS[draw.robot](rng)
        model = mujoco.MjModel.from_xml_string(robot.xml)
        sensors = _sensors(robot, draw.stratum, rng)
        site = site_of(robot, model, draw.seed + attempt)
        again = copy.deepcopy(rng)
        truths, labels, strength = _truth(draw, site, sensors, rng, attempt // 3)
        if causes.one_by_physics(labels, site):
            continue
        commands = _commands(robot, sensors, runs, rng)
        traces = _drive(robot, truths[-1], commands)
        if traces is None:
            continue
        alike = (
            []
            if draw.stratum in ("none", "outside")
            else causes.equivalents(labels, site, torque_logged=sensors.torque_kind != "none")
        )
        alike = [a for a in alike if same_log(a, robot, sensors, site, truths, commands)]
        if draw.stratum == "confounded" and not alike:
            continue
        seen = visibility(robot, sensors, truths, commands[:2])
        if not all(v >= VISIBLE for v in seen):
            continue
        if deviations != 1.0:
            truths, _, _ = _truth(draw, site, sensors, again, attempt // 3, deviations)
            traces = _drive(robot, truths[-1], commands)
            if traces is None:
                raise RuntimeError(f"{draw.robot} falls over with {deviations:g} times the everyday deviations: {draw}")
        louder = replace(sensors, noise=sensors.noise * noise, louder=noise)
        write_log(folder, robot, louder, truths[-1], commands, traces, rng)
        return {
            "deviations": deviations,
            "noise": noise,
            "cls": draw.stratum,
            "robot": draw.robot,
            "verdict": {"none": "no_gap", "outside": "unexplained", "confounded": "ambiguous"}.get(
                draw.stratum, "identified"
            ),
            "effects": labels,
            "equivalents": alike,
            "strength": strength,
            "visibility": seen,
            "seed": draw.seed,
            "attempt": attempt,
        }
    raise RuntimeError(f"no usable draw for {draw}")


def visibility(
    robot: Robot, sensors: Sensors, truths: list[Truth], commands: list[tuple[np.ndarray, np.ndarray]]
) -> list[float]:
    """How much each further truth changes the signals that are logged, in units of sensors and everyday deviations.

    `truths[0]` has the everyday deviations only, each next one a cause more. The largest ratio over the signals counts;
    0 where a robot falls.
    """
    if len(truths) == 1:
        return []
    nominal = _signals(robot, sensors, Truth(len(robot.joints)), commands)
    drawn = [_signals(robot, sensors, t, commands) for t in truths]
    seen = [s for s in drawn if s is not None]
    if nominal is None or len(seen) < len(drawn):
        return [0.0] * (len(truths) - 1)
    floor = {k: np.hypot(_rms(seen[0][k][0] - v), noise) for k, (v, noise) in nominal.items()}
    return [
        max(float(np.max(_rms(after[k][0] - before[k][0]) / floor[k])) for k in floor)
        for before, after in itertools.pairwise(seen)
    ]


def same_log(
    label: list[dict[str, Any]],
    robot: Robot,
    sensors: Sensors,
    site: causes.Site,
    truths: list[Truth],
    commands: list[tuple[np.ndarray, np.ndarray]],
) -> bool:
    """Whether the other causes, simulated, would have left the same log: a drive in saturation may tell them apart, and
    one run with it is enough.

    Late commands and late readings are the same up to a tick of the drive's clock, which is not simulated for both.
    """
    if all(one["effect"] in ("command_delay", "observation_delay") for one in label):
        return True
    other = copy.deepcopy(truths[0])
    for one in label:
        causes.enact(one, other, site)
    pair = [truths[0], truths[-1], other]
    return all(visibility(robot, sensors, pair, [command])[1] < SAME for command in commands)


def _rms(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _signals(
    robot: Robot, sensors: Sensors, truth: Truth, commands: list[tuple[np.ndarray, np.ndarray]]
) -> dict[str, tuple[np.ndarray, float]] | None:
    """Signal -> ((K, n) true values, one sensor's standard deviation)."""
    traces = _drive(robot, truth, commands)
    if traces is None:
        return None
    late = round(truth.observation_delay * 1000)
    parts: dict[str, tuple[list[np.ndarray], float]] = {
        "joint_pos": ([_held(t.q, late) + truth.encoder_zero for t in traces], sensors.noise)
    }
    if sensors.velocity:
        parts["joint_vel"] = ([_held(t.v, late) for t in traces], 25 * sensors.noise)
    if sensors.torque_kind != "none":
        peak = float(np.abs(np.concatenate([t.torque for t in traces])).max())
        parts["joint_torque"] = ([_held(t.torque, late) for t in traces], 0.01 * peak)
    if sensors.mocap and traces[0].base is not None:
        parts["base"] = ([t.base for t in traces if t.base is not None], 4e-4)
    if traces[0].gyro is not None:
        parts["gyro"] = ([t.gyro + truth.gyro_bias for t in traces if t.gyro is not None], 0.004)
        parts["acc"] = ([t.acc + truth.acc_bias for t in traces if t.acc is not None], 0.05)
    return {k: (np.concatenate(v), noise) for k, (v, noise) in parts.items()}


def _held(values: np.ndarray, late: int) -> np.ndarray:
    return values[np.maximum(np.arange(len(values)) - late, 0)]


# ---------------------------------------------------------------- draws


def _sensors(robot: Robot, stratum: str, rng: np.random.Generator) -> Sensors:
    kind = str(rng.choice(["none", "none", "measured", "current_times_constant"]))
    return Sensors(
        rate=100.0 if robot.name in ("quadruped", "g1") else float(rng.choice([125.0, 200.0])),
        velocity=bool(rng.random() < 0.7),
        torque_kind="none" if stratum == "confounded" else kind,
        torque_constant=float(rng.uniform(0.8, 1.2)) if kind == "current_times_constant" else 1.0,
        mocap=bool(rng.random() < 0.7),
        noise=float(rng.uniform(1.0e-4, 4.0e-4)),
        bits=int(rng.choice([14, 16])),
    )


def site_of(robot: Robot, model: mujoco.MjModel, seed: int) -> causes.Site:
    """Typical torque and speed of the nominal robot in these motions."""
    rng = np.random.default_rng(seed)
    plant = Plant(robot, Truth(len(robot.joints)))
    times = sample_times(rng, 100.0, 4.0)
    trace = plant.drive(times, motion(robot, rng, times, KINDS[robot.base][0]))
    effort = np.percentile(np.abs(trace.torque), 90, axis=0)
    return causes.Site(robot, model, effort, np.percentile(np.abs(trace.v), 90, axis=0))


def _truth(
    draw: Draw, site: causes.Site, sensors: Sensors, rng: np.random.Generator, further: int, deviations: float = 1.0
) -> tuple[list[Truth], list[dict[str, Any]], list[float]]:
    """Truths with 0, 1, ... causes, the labels of the causes and their strengths."""
    truth = Truth(len(site.robot.joints))
    _nuisances(truth, site, rng, deviations)
    known, number = causes.available(site.robot), 1
    if draw.stratum == "none":
        return [truth], [], []
    names = list(known)
    if draw.stratum == "outside":
        names, known = list(causes.OUTSIDE), causes.OUTSIDE
    elif draw.stratum == "confounded":
        names, known = list(causes.CONFOUNDED[site.robot.name]), known | causes.JOINT_CAUSES
    elif draw.stratum == "double":
        number = 2
    # The turns start elsewhere for every robot and stratum; a draw that came to nothing moves on from where it is.
    np.random.default_rng([len(names), len(site.robot.joints), number]).shuffle(names)
    chosen = [names[(draw.turn * number + i + further * 7) % len(names)] for i in range(number)]
    truths, labels, strengths = [truth], [], []
    for name in chosen:
        truth = copy.deepcopy(truth)
        strengths.append(float(rng.uniform(0.25, 1.0)))
        labels.append(known[name](truth, site, rng, strengths[-1]))
        truths.append(truth)
    return truths, labels, strengths


def _nuisances(truth: Truth, site: causes.Site, rng: np.random.Generator, k: float = 1.0) -> None:
    """A per cent here and there, `k` times: present in every robot, and no gap."""
    model, robot = site.model, site.robot
    truth.kp *= rng.normal(1, 0.01 * k, truth.joints)
    truth.kd *= rng.normal(1, 0.02 * k, truth.joints)
    truth.encoder_zero += rng.normal(0, 0.0008 * k, truth.joints)
    for name in robot.joints:
        body = model.body(model.joint(name).bodyid[0]).name
        truth.mass_ratio[body] = float(rng.normal(1, 0.01 * k))
        truth.inertia_ratio[body] = float(rng.normal(1, 0.01 * k))
        truth.com[body] = rng.normal(0, 0.001 * k, 3)
    for i, name in enumerate(robot.joints):
        dof = model.joint(name).dofadr[0]
        truth.viscous[i] += float(model.dof_damping[dof]) * float(rng.normal(0, 0.04 * k))
        truth.coulomb[i] += abs(float(model.dof_frictionloss[dof]) * float(rng.normal(0, 0.04 * k)))
        truth.armature[i] += float(model.dof_armature[dof]) * float(rng.normal(0, 0.015 * k))
    truth.friction_ratio = float(rng.normal(1, 0.05 * k))


def _commands(
    robot: Robot, sensors: Sensors, runs: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(times, commands) of every run; the last one repeats the first one's commands."""
    kinds = KINDS[robot.base]
    out = []
    for i in range(runs - 1):
        times = sample_times(rng, sensors.rate, float(rng.uniform(5.0, 7.0)))
        out.append((times, motion(robot, rng, times, kinds[i % len(kinds)])))
    first = out[0]
    again = sample_times(rng, sensors.rate, len(first[0]) / sensors.rate)
    return [*out, (again[: len(first[0])], first[1][: len(again)])]


def _drive(robot: Robot, truth: Truth, commands: list[tuple[np.ndarray, np.ndarray]]) -> list[Trace] | None:
    plant = Plant(robot, truth)
    traces = []
    for times, command in commands:
        trace = plant.drive(times, command)
        if not trace.upright:
            return None
        traces.append(trace)
    return traces


# ---------------------------------------------------------------- logs


def write_log(
    folder: Path,
    robot: Robot,
    sensors: Sensors,
    truth: Truth,
    commands: list[tuple[np.ndarray, np.ndarray]],
    traces: list[Trace],
    rng: np.random.Generator,
) -> None:
    """Traces as a log in the contract's form."""
    runs = {
        f"run_{i + 1:02d}": _record(robot, sensors, truth, times, command, trace, rng)
        for i, ((times, command), trace) in enumerate(zip(commands, traces, strict=True))
    }
    write_case(
        folder, robot.xml, runs, joint_names=robot.joints, actuator_names=robot.actuators, base=robot.base,
        torque_kind=sensors.torque_kind, imu_site=robot.imu_site, contact_bodies=robot.contact_bodies,
        notes="Drives close their loop at 1 kHz on motor-side encoders; joint_pos is the link side. "
        "joint_torque, where given, is the drive's torque before gear friction.",
    )  # fmt: skip


def _record(
    robot: Robot,
    sensors: Sensors,
    truth: Truth,
    times: np.ndarray,
    command: np.ndarray,
    trace: Trace,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    def at(values: np.ndarray, delay: float = 0.0) -> np.ndarray:
        t = np.clip(times - delay, trace.time[0], trace.time[-1])
        return np.column_stack([np.interp(t, trace.time, values[:, k]) for k in range(values.shape[1])])

    late, n = truth.observation_delay, truth.joints
    step = 2 * np.pi / 2**sensors.bits
    read = at(trace.q, late) + truth.encoder_zero + rng.normal(0, sensors.noise, (len(times), n))
    out = {"time": times, "command": command, "joint_pos": np.round(read / step) * step}
    if sensors.velocity:
        out["joint_vel"] = at(trace.v, late) + rng.normal(0, 25 * sensors.noise, (len(times), n))
    if sensors.torque_kind != "none":
        level = sensors.louder * (0.01 * np.abs(trace.torque).max(0) + 1e-3)
        out["joint_torque"] = sensors.torque_constant * at(trace.torque, late) + rng.normal(0, level, (len(times), n))
    if trace.base is not None and sensors.mocap:
        out["base_pos"] = at(trace.base[:, :3]) + rng.normal(0, 3e-4 * sensors.louder, (len(times), 3))
        quat = at(trace.base[:, 3:]) + rng.normal(0, 4e-4 * sensors.louder, (len(times), 4))
        out["base_quat"] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    if trace.base is not None:
        out["init_qpos"], out["init_qvel"] = trace.qpos0, np.zeros(len(trace.qpos0) - 1)
    if trace.gyro is not None and trace.acc is not None:
        out["imu_gyro"] = at(trace.gyro) + truth.gyro_bias + rng.normal(0, 0.004 * sensors.louder, (len(times), 3))
        out["imu_acc"] = at(trace.acc) + truth.acc_bias + rng.normal(0, 0.05 * sensors.louder, (len(times), 3))
    if trace.contact is not None:
        out["contact"] = (at(trace.contact) > 0.5).astype(np.float64)
    lost = rng.random(len(times)) < 0.005
    lost[0] = False
    for name in ("joint_pos", "joint_vel", "joint_torque"):
        if name in out:
            out[name][lost] = np.nan
    return {k: v.astype(np.float64 if k == "time" else np.float32) for k, v in out.items()}
