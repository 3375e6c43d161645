"""Draws cases by stratum, and writes logs in the contract's form here and labels elsewhere."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.gap_truth import causes
from benchmarks.gap_truth.motions import KINDS, motion, sample_times
from benchmarks.gap_truth.plant import Plant, Trace
from benchmarks.gap_truth.robots import ROBOTS, Robot
from benchmarks.gap_truth.truth import Truth

STRATA = {"none": 0.2, "single": 0.4, "double": 0.15, "outside": 0.125, "confounded": 0.125}
"""Stratum -> share of the cases."""
ROBOT_SHARE = {"pendulum": 0.25, "arm2": 0.27, "arm6": 0.25, "quadruped": 0.15, "g1": 0.08}


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


def plan(count: int, seed: int) -> list[tuple[str, str, int]]:
    """(stratum, robot, seed) of every case, interleaved so that any prefix is a fair sample."""
    rng = np.random.default_rng(seed)
    strata = _shares(STRATA, count)
    robots = _shares(ROBOT_SHARE, count)
    rng.shuffle(strata)
    rng.shuffle(robots)
    return [(s, r, seed * 100_003 + i) for i, (s, r) in enumerate(zip(strata, robots, strict=True))]


def _shares(shares: dict[str, float], count: int) -> list[str]:
    edges = np.round(np.cumsum(list(shares.values())) * count).astype(int)
    names = list(shares)
    return [names[int(np.searchsorted(edges, i, side="right"))] for i in range(count)]


def make_case(stratum: str, robot_name: str, seed: int, folder: Path, runs: int = 6) -> dict[str, Any]:
    """Write one case below `folder`; its label is returned, not written there.

    A draw whose robot falls over or whose cause leaves no trace beyond the nuisances' is drawn again.
    """
    for attempt in range(8):
        rng = np.random.default_rng([seed, attempt])
        robot = ROBOTS[robot_name](rng)
        model = mujoco.MjModel.from_xml_string(robot.xml)
        sensors = _sensors(robot, stratum, rng)
        site = _site(robot, model, seed + attempt)
        truth, labels, strength = _truth(stratum, site, sensors, rng)
        commands = _commands(robot, sensors, runs, rng)
        traces = _drive(robot, truth, commands)
        if traces is None:
            continue
        alike = (
            []
            if stratum in ("none", "outside")
            else causes.equivalents(labels, site, torque_logged=sensors.torque_kind != "none")
        )
        if stratum == "confounded" and not alike:
            continue
        _write(folder, robot, sensors, truth, commands, traces, rng)
        return {
            "cls": stratum,
            "robot": robot_name,
            "verdict": {"none": "no_gap", "outside": "unexplained", "confounded": "ambiguous"}.get(
                stratum, "identified"
            ),
            "effects": labels,
            "equivalents": alike,
            "strength": strength,
            "seed": seed,
        }
    raise RuntimeError(f"no usable draw for {stratum} {robot_name} {seed}")


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


def _site(robot: Robot, model: mujoco.MjModel, seed: int) -> causes.Site:
    """Typical torque and speed of the nominal robot in these motions."""
    rng = np.random.default_rng(seed)
    plant = Plant(robot, Truth(len(robot.joints)))
    times = sample_times(rng, 100.0, 4.0)
    trace = plant.drive(times, motion(robot, rng, times, KINDS[robot.base][0]))
    effort = np.percentile(np.abs(trace.torque), 90, axis=0)
    return causes.Site(robot, model, effort, np.percentile(np.abs(trace.v), 90, axis=0))


def _truth(
    stratum: str, site: causes.Site, sensors: Sensors, rng: np.random.Generator
) -> tuple[Truth, list[dict[str, Any]], list[float]]:
    truth = Truth(len(site.robot.joints))
    _nuisances(truth, site, rng)
    known = causes.available(site.robot)
    number = {"none": 0, "double": 2}.get(stratum, 1)
    if stratum == "outside":
        names = [str(rng.choice(list(causes.OUTSIDE)))]
        known = causes.OUTSIDE
    elif stratum == "confounded":
        names = [str(rng.choice(causes.CONFOUNDED[site.robot.name]))]
        known = known | causes.JOINT_CAUSES
    else:
        names = [str(n) for n in rng.choice(list(known), number, replace=False)]
    strengths = [float(rng.uniform(0.25, 1.0)) for _ in names]
    return truth, [known[n](truth, site, rng, k) for n, k in zip(names, strengths, strict=True)], strengths


def _nuisances(truth: Truth, site: causes.Site, rng: np.random.Generator) -> None:
    """A per cent here and there: present in every robot, and no gap."""
    model, robot = site.model, site.robot
    truth.kp *= rng.normal(1, 0.01, truth.joints)
    truth.kd *= rng.normal(1, 0.02, truth.joints)
    truth.encoder_zero += rng.normal(0, 0.0008, truth.joints)
    for name in robot.joints:
        body = model.body(model.joint(name).bodyid[0]).name
        truth.mass_ratio[body] = float(rng.normal(1, 0.01))
        truth.inertia_ratio[body] = float(rng.normal(1, 0.01))
        truth.com[body] = rng.normal(0, 0.001, 3)
    for i, name in enumerate(robot.joints):
        dof = model.joint(name).dofadr[0]
        truth.viscous[i] += float(model.dof_damping[dof]) * float(rng.normal(0, 0.04))
        truth.coulomb[i] += abs(float(model.dof_frictionloss[dof]) * float(rng.normal(0, 0.04)))
        truth.armature[i] += float(model.dof_armature[dof]) * float(rng.normal(0, 0.015))
    truth.friction_ratio = float(rng.normal(1, 0.05))


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


def _write(
    folder: Path,
    robot: Robot,
    sensors: Sensors,
    truth: Truth,
    commands: list[tuple[np.ndarray, np.ndarray]],
    traces: list[Trace],
    rng: np.random.Generator,
) -> None:
    (folder / "runs").mkdir(parents=True)
    (folder / "model.xml").write_text(robot.xml)
    log = {
        "joint_names": robot.joints,
        "actuator_names": robot.actuators,
        "command_kind": "position",
        "command_hold": "zoh",
        "base": robot.base,
        "torque_kind": sensors.torque_kind,
        "imu_site": robot.imu_site,
        "contact_bodies": robot.contact_bodies,
        "notes": "Drives close their loop at 1 kHz on motor-side encoders; joint_pos is the link side. "
        "joint_torque, where given, is the drive's torque before gear friction.",
    }
    (folder / "log.json").write_text(json.dumps(log, indent=1) + "\n")
    for i, ((times, command), trace) in enumerate(zip(commands, traces, strict=True)):
        np.savez_compressed(
            folder / "runs" / f"run_{i + 1:02d}.npz", **_record(robot, sensors, truth, times, command, trace, rng)
        )


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
        level = 0.01 * np.abs(trace.torque).max(0) + 1e-3
        out["joint_torque"] = sensors.torque_constant * at(trace.torque, late) + rng.normal(0, level, (len(times), n))
    if trace.base is not None and sensors.mocap:
        out["base_pos"] = at(trace.base[:, :3]) + rng.normal(0, 3e-4, (len(times), 3))
        quat = at(trace.base[:, 3:]) + rng.normal(0, 4e-4, (len(times), 4))
        out["base_quat"] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    if trace.base is not None:
        out["init_qpos"], out["init_qvel"] = trace.qpos0, np.zeros(len(trace.qpos0) - 1)
    if trace.gyro is not None and trace.acc is not None:
        out["imu_gyro"] = at(trace.gyro) + truth.gyro_bias + rng.normal(0, 0.004, (len(times), 3))
        out["imu_acc"] = at(trace.acc) + truth.acc_bias + rng.normal(0, 0.05, (len(times), 3))
    if trace.contact is not None:
        out["contact"] = (at(trace.contact) > 0.5).astype(np.float64)
    lost = rng.random(len(times)) < 0.005
    lost[0] = False
    for name in ("joint_pos", "joint_vel", "joint_torque"):
        if name in out:
            out[name][lost] = np.nan
    return {k: v.astype(np.float64 if k == "time" else np.float32) for k, v in out.items()}
