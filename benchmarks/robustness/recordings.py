"""Forty-two recordings of one arm and one leg, written as strangers write them, and read without a hand.

    python -m benchmarks.robustness.recordings --out benchmarks/results/recordings.json

Both robots are simulated under commands of their own for each joint (a common slow swing and a sine each), so that what
was commanded, reached and measured is known. A recording is right if positions, commands and, where there are any,
measured torques of every run are the robot's, joint by joint, in SI units; it may be marked in doubt. `WRONG` is a case
that could be written with a wrong pairing, unit or torque and no mark. Six inputs that no case should come from follow.
"""

import argparse
import io
import json
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.store import Store
from realsim.core.errors import RealsimError
from realsim.core.types import F64
from realsim.gap.recordings import Proposal, load_target, propose, read
from realsim.gap.recordings.arrays import run_arrays
from tests.gap.recordings import writers
from tests.gap.recordings.robots import ARM, Log

LEG = """
<mujoco model="leg"><compiler angle="radian" autolimits="true"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body pos="0 0 1"><joint name="hip_pitch" axis="0 1 0" range="-1.6 2.2" damping="0.4" armature="0.05"/>
<inertial pos="0 0 -0.15" mass="2" diaginertia="0.02 0.02 0.002"/>
<body pos="0 0 -0.3"><joint name="knee_pitch" axis="0 1 0" range="-2.4 0.1" damping="0.3" armature="0.03"/>
<inertial pos="0 0 -0.14" mass="1.2" diaginertia="0.01 0.01 0.001"/>
<body pos="0 0 -0.3"><joint name="ankle_pitch" axis="0 1 0" range="-0.9 0.9" damping="0.1" armature="0.01"/>
<inertial pos="0.05 0 -0.03" mass="0.4" diaginertia="0.002 0.002 0.002"/></body></body></body></worldbody>
<actuator><position name="m_hip" joint="hip_pitch" kp="120" kv="5"/><position name="m_knee" joint="knee_pitch" kp="80"
kv="3"/><position name="m_ankle" joint="ankle_pitch" kp="40" kv="1"/></actuator></mujoco>"""
ROBOTS = {"arm": (ARM, [0.3, 1.0], [0.5, 0.5]), "leg": (LEG, [0.2, -0.9, 0.1], [0.5, 0.6, 0.4])}
NAMES = {"arm": ["shoulder_joint", "elbow_joint"], "leg": ["hip_pitch", "knee_pitch", "ankle_pitch"]}
DEG = 180 / np.pi
NEEDED = 36


def drive(robot: str, seed: int, seconds: float = 5.0, still: bool = False) -> Log:
    """One run at 200 Hz."""
    xml, base, size = ROBOTS[robot]
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[:] = base
    rates, phases = rng.uniform(0.5, 1.3, model.nu), rng.uniform(0, 2 * np.pi, model.nu)
    rows: list[F64] = []
    for i in range(-200, int(seconds / 0.005)):
        t = 0.005 * max(i, 0)
        swing = 0.0 if still else min(t, 1.0) * np.array(size)
        common = np.sin(1.5 * t)
        data.ctrl[:] = base + swing * (0.4 * common + 0.6 * np.sin(2 * np.pi * rates * t + phases))
        if i >= 0:
            mujoco.mj_forward(model, data)
            noise = rng.normal(0, 5e-4, (2, model.nu))
            rows.append(
                np.concatenate([data.ctrl, data.qpos + noise[0], data.qvel + 10 * noise[1], data.actuator_force])
            )
        for _ in range(3 if i % 2 else 2):
            mujoco.mj_step(model, data)
    n, table = model.nu, np.array(rows)
    return Log(0.005 * np.arange(len(table)), *(table[:, k * n : (k + 1) * n] for k in range(4)))


def text(
    path: Path, header: str, *columns: F64, delimiter: str = ",", comma: bool = False, encoding: str = "utf-8"
) -> Path:
    """A table of text."""
    buffer = io.StringIO()
    np.savetxt(buffer, np.column_stack(columns), delimiter=delimiter, fmt="%.15g")
    body = buffer.getvalue().replace(".", ",") if comma else buffer.getvalue()
    path.write_bytes((f"{header}\n" if header else "").encode(encoding) + body.encode())
    return path


def many(folder: Path, robot: str, write: Callable[[Path, Log], Any], runs: int = 3) -> Path:
    """A folder of runs."""
    folder.mkdir(parents=True)
    for k in range(runs):
        write(folder / f"run_{k}", drive(robot, k))
    return folder


def jittered(log: Log, scale: float = 1.0, start: float = 7.0) -> F64:
    """A clock that no loop keeps exactly."""
    return scale * (log.time + start + np.random.default_rng(1).uniform(0, 5e-4, len(log.time)))


def swap(values: F64) -> F64:
    return values[:, ::-1]


# ---------------------------------------------------------------- the forty


Write = Callable[[Path, Log], Any]
"""One run to a file whose suffix is still to be set."""


def csv(header: str, columns: Callable[[Log], Sequence[F64]], suffix: str = ".csv", **more: Any) -> Write:
    return lambda path, log: text(path.with_suffix(suffix), header, *columns(log), **more)


def lines(suffix: str, rows: Callable[[Log], Sequence[str]]) -> Write:
    return lambda path, log: path.with_suffix(suffix).write_text("\n".join(rows(log)))


def table(suffix: str, header: str, row: Callable[[float, Log, int], str]) -> Write:
    """A table of text, a row a sample: (time, run, sample) -> its cells."""
    return lines(suffix, lambda log: [header, *(row(t, log, i) for i, t in enumerate(log.time.tolist()))])


def jsons(suffix: str, items: Callable[[Log], Sequence[Any]]) -> Write:
    return lines(suffix, lambda log: [json.dumps(item) for item in items(log)])


def npz(arrays: Callable[[Log], dict[str, Any]]) -> Write:
    return lambda path, log: np.savez(path, **arrays(log))


def parquet(columns: Callable[[Log], dict[str, Any]]) -> Write:
    def write(path: Path, log: Log) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(columns(log)), path.with_suffix(".parquet"))

    return write


def mcap(messages: Callable[[Log], list[Any]]) -> Write:
    return lambda path, log: _mcap(path, messages(log))


def _mcap(path: Path, messages: list[Any]) -> Path:
    return writers.mcap_ros2(path.with_suffix(".mcap"), sorted(messages, key=lambda m: m[3]))


def mcap_json(names: Sequence[str]) -> Write:
    def write(path: Path, log: Log) -> None:
        from mcap.writer import Writer

        with path.with_suffix(".mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("joints", "jsonschema", b'{"type": "object"}')
            state, sent = (writer.register_channel(t, "json", schema) for t in ("/joint_states", "/joint_targets"))
            for i, t in enumerate(log.time):
                nanoseconds = round(1e9 * (t + 1.7e9))
                for channel, key, row in ((state, "position", log.pos[i]), (sent, "position", log.command[i])):
                    data = json.dumps({"name": list(names), key: row.tolist()}).encode()
                    writer.add_message(channel, log_time=nanoseconds, publish_time=nanoseconds, data=data)
            writer.finish()

    return write


def ros1(names: Sequence[str]) -> Write:
    return lambda path, log: writers.bag(path.with_suffix(".bag"), log, names, 1)


def servo_ulog(path: Path, log: Log) -> None:
    sides = (("position", log.pos), ("position_setpoint", log.command))
    columns = {f"{side}_{k}": values[:, k] for side, values in sides for k in range(2)}
    writers.ulog(path.with_suffix(".ulg"), log.time + 3, "servo_status", columns)


def rostopic(p: Path) -> Path:
    """`rostopic echo -p`: a file for each topic."""
    p.mkdir(parents=True)
    log = drive("leg", 0)
    stamp = np.round(1e9 * (log.time + 1.7e9))
    columns = [f"field.{s}{k}" for s in ("position", "velocity", "effort") for k in range(3)]
    text(p / "joint_states.csv", "%time," + ",".join(columns), stamp, log.pos, log.vel, log.torque)
    text(p / "joint_commands.csv", "%time," + ",".join(f"field.data{k}" for k in range(3)), stamp, log.command)
    return p


def file_a_side(p: Path) -> Path:
    """A folder for each run, a file for each side."""
    for k in range(2):
        (p / f"motion_{k}").mkdir(parents=True)
        log = drive("leg", k)
        for name, values in (("control", [log.command]), ("state_motor", [log.pos, log.vel])):
            lists = [
                ",".join(f'"[{", ".join(f"{v:.6f}" for v in row)}]"' for row in rows)
                for rows in zip(*values, strict=True)
            ]
            head = "timestamp,positions" + (",velocities" if len(values) > 1 else "")
            rows = [head, *(f"{1e6 * t:.0f},{cells}" for t, cells in zip(log.time, lists, strict=True))]
            (p / f"motion_{k}" / f"{name}.csv").write_text("\n".join(rows))
    return p


def command_alone(log: Log, order: Sequence[int] | None = None) -> Log:
    """A run whose state is another's command, or whose commands are in another order."""
    if order is None:
        return Log(log.time, log.command, log.command, 0 * log.vel, 0 * log.torque)
    return Log(log.time, log.command[:, order], log.pos, log.vel, log.torque)


def topics_apart(log: Log) -> list[Any]:
    return [item for i, t in enumerate(log.time.tolist()) for item in (
        {"topic": "/target", "ts": 1e3 * t, "q": log.command[i].tolist()},
        {"topic": "/feedback", "ts": 1e3 * t + 1, "q": log.pos[i].tolist()})]  # fmt: skip


def columns_of(log: Log) -> dict[str, Any]:
    sides = {"ref": log.command, "fbk": log.pos}
    named = {f"{j}_{s}": v[:, k].tolist() for k, j in enumerate(("hip", "knee", "ankle")) for s, v in sides.items()}
    return {"uptime_ms": (1e3 * log.time).tolist(), **named}


ARMS, LEGS, TICK = NAMES["arm"], NAMES["leg"], 4096 / (2 * np.pi)
RUNS: dict[str, dict[str, Write]] = {
    "arm": {
        "csv_german": csv(
            "millis,Ellbogen_soll [deg],Schulter_soll [deg],Ellbogen_ist [deg],Schulter_ist [deg],temp_C",
            lambda g: (jittered(g, 1e3), DEG * swap(g.command), DEG * swap(g.pos), g.time)),
        "csv_french": csv(
            "temps (s);consigne épaule (rad);consigne coude (rad);mesure épaule (rad);mesure coude (rad)",
            lambda g: (g.time, g.command, g.pos), delimiter=";", comma=True),
        "csv_plotjuggler": csv(
            "__time," + ",".join(f"/joint_states/{n}/{s}" for s in ("position", "velocity", "effort") for n in ARMS)
            + ",/position_controller/commands/data[0],/position_controller/commands/data[1]",
            lambda g: (g.time + 1.7e9, g.pos, g.vel, g.torque, g.command)),
        "csv_arduino": csv(
            "micros,target1,target2,actual1,actual2,pwm1,pwm2",
            lambda g: (jittered(g, 1e6), DEG * g.command, DEG * g.pos, 10 * g.torque)),
        "csv_torques": csv(
            "time,pos_meas1,pos_meas2,pos_filt1,pos_filt2,tau_con1,tau_con2,tau_fric1,tau_fric2,tau_meas1,tau_meas2,"
            "pos_des1,pos_des2",
            lambda g: (g.time, g.pos, 0.97 * g.pos, 1.3 * g.torque + 1, 0.2 * np.sign(g.vel), g.torque, g.command)),
        "csv_pandas": table(
            ".csv", ",TimeStamp,shoulder_target,elbow_target,shoulder_angle,elbow_angle",
            lambda t, g, i: f"{i},2026-11-10 12:30:{t:09.6f},"
            + ",".join(f"{DEG * v:.5f}" for v in (*g.command[i], *g.pos[i]))),
        "csv_lists": table(
            ".csv", "timestamp,action,state",
            lambda t, g, i: f'{t:.4f},"{g.command[i].tolist()}","{g.pos[i].tolist()}"'),
        "csv_chinese": csv(
            "时间,肘目标角度,肩目标角度,肘实际角度,肩实际角度", lambda g: (g.time, swap(g.command), swap(g.pos))),
        "txt_savetxt": csv(
            "# t q1 q2 qd1 qd2 tau1 tau2 qref1 qref2",
            lambda g: (g.time, g.pos, g.vel, g.torque, g.command), ".txt", delimiter=" "),
        "tsv_mixed_units": csv(
            "elapsed_ms\tq_cmd_0 (deg)\tq_cmd_1 (deg)\tq_0 (rad)\tq_1 (rad)\tdq_0 (rpm)\tdq_1 (rpm)",
            lambda g: (1e3 * g.time, DEG * g.command, g.pos, 30 / np.pi * g.vel), ".tsv", delimiter="\t"),
        # JointState in alphabetical order, the controller's commands in that of its yaml:
        "mcap_other_order": mcap(
            lambda g: writers.joint_states(g, ARMS, order=[1, 0])
            + writers.float_commands(g, topic="/forward_position_controller/commands")),
        "mcap_named_commands": mcap(
            lambda g: writers.joint_states(g, ARMS)
            + writers.joint_states(command_alone(g), ARMS, topic="/joint_commands", order=[1, 0])),
        "mcap_json_arm": mcap_json(ARMS),
        "bag_ros1_arm": ros1(ARMS),
        "npz_short": npz(lambda g: {"t": g.time, "q": g.pos, "qd": g.vel, "q_des": g.command, "tau": g.torque}),
        "npz_table": npz(
            lambda g: {"data": np.column_stack([1e6 * g.time, g.pos, g.command]),
                       "cols": np.array(["timestamp_us", "pos0", "pos1", "ref0", "ref1"])}),
        "parquet_wide": parquet(
            lambda g: {"log_time": g.time, "elbow.goal": DEG * g.command[:, 1], "shoulder.goal": DEG * g.command[:, 0],
                       "elbow.pos": DEG * g.pos[:, 1], "shoulder.pos": DEG * g.pos[:, 0]}),
        "parquet_italian": parquet(
            lambda g: {"Tempo": g.time, "Gomito riferimento": g.command[:, 1], "Spalla riferimento": g.command[:, 0],
                       "Gomito misurato": g.pos[:, 1], "Spalla misurato": g.pos[:, 0]}),
        "jsonl_nested": jsons(".jsonl", lambda g: [
            {"t": t, "joints": {n: {"pos": g.pos[i, k], "cmd": g.command[i, k]} for k, n in enumerate(ARMS)}}
            for i, t in enumerate(g.time.tolist())]),
        "json_entries": jsons(".json", lambda g: [{"kp": 32, "entries": [
            {"timestamp": t, "goal_position": g.command[i].tolist(), "position": g.pos[i].tolist(),
             "speed": g.vel[i].tolist()} for i, t in enumerate(g.time.tolist())]}]),
        "ulog_servo": servo_ulog,
    },
    "leg": {
        "csv_shuffled": csv(
            "time,knee_cmd,hip_cmd,ankle_cmd,ankle_pos,hip_pos,knee_pos",
            lambda g: (g.time, g.command[:, [1, 0, 2]], g.pos[:, [2, 0, 1]])),
        "csv_headless": csv("", lambda g: (g.time, g.pos, g.vel, g.command)),
        "csv_units_row": csv(
            "Prüfstand A;2026-11-10\n\nZeit;Hüfte Soll;Knie Soll;Sprunggelenk Soll;"
            "Hüfte Ist;Knie Ist;Sprunggelenk Ist\nms;°;°;°;°;°;°",
            lambda g: (1e3 * g.time, DEG * g.command, DEG * g.pos), delimiter=";", encoding="cp1252"),
        "csv_ticks": csv(
            "timestamp," + ",".join(f"id{k}_{s}" for s in ("goal_position", "present_position") for k in (1, 2, 3)),
            lambda g: (g.time, np.round(2048 + TICK * g.command), np.round(2048 + TICK * g.pos))),
        "csv_spanish": csv(
            "Tiempo [s];Rodilla deseada [°];Cadera deseada [°];Tobillo deseada [°];"
            "Rodilla medida [°];Cadera medida [°];Tobillo medida [°]",
            lambda g: (g.time, DEG * g.command[:, [1, 0, 2]], DEG * g.pos[:, [1, 0, 2]]), delimiter=";"),
        "tsv_labview": csv(
            "Zeit [s]\t" + "\t".join(
                f"{j} {s} [°]" for s in ("Sollwinkel", "Istwinkel") for j in ("Knöchel", "Knie", "Hüfte")),
            lambda g: (g.time, DEG * swap(g.command), DEG * swap(g.pos)), ".tsv", delimiter="\t"),
        "mcap_leg_order": mcap(
            lambda g: writers.joint_states(g, LEGS) + writers.float_commands(command_alone(g, [2, 0, 1]))),
        "mcap_boot_clock": mcap(
            lambda g: writers.joint_states(g, LEGS, offset=1.69e9, drift=5e-5)
            + writers.float_commands(g, offset=1.69e9)),
        "mcap_json_leg": mcap_json(LEGS),
        "bag_ros1_leg": ros1(LEGS),
        "npz_isaac": npz(
            lambda g: {"time": g.time, "dof_pos": g.pos, "dof_vel": g.vel, "dof_pos_target": g.command,
                       "joint_names": np.array(LEGS)}),
        # qd is the desired position here, dq the velocity:
        "npz_desired_qd": npz(lambda g: {"t": g.time, "q": g.pos, "dq": g.vel, "qd": g.command}),
        "parquet_lists": parquet(
            lambda g: {"timestamp": g.time, "observation.state": g.pos.tolist(), "action": g.command.tolist()}),
        "jsonl_topics": jsons(".jsonl", topics_apart),
        "json_columns": jsons(".json", lambda g: [columns_of(g)]),
    },
}  # fmt: skip
"""Robot -> recording -> what writes each of its three runs."""
FORTY: dict[str, tuple[str, Callable[[Path], Path]]] = {
    **{n: (robot, partial(many, robot=robot, write=w)) for robot, made in RUNS.items() for n, w in made.items()},
    "bag_ros2_arm": ("arm", lambda p: writers.bag(p, drive("arm", 0), ARMS, 2)),
    "bag_ros2_leg": ("leg", lambda p: writers.bag(p, drive("leg", 0), LEGS, 2)),
    "lerobot_arm": ("arm", lambda p: writers.lerobot(p, [drive("arm", k) for k in range(3)], ["shoulder", "elbow"])),
    "lerobot_leg": ("leg", lambda p: writers.lerobot(p, [drive("leg", k) for k in range(3)], LEGS)),
    "csv_rostopic": ("leg", rostopic),
    "csv_files": ("leg", file_a_side),
}


# ---------------------------------------------------------------- what came of them


def judge(proposal: Proposal, robot: str) -> tuple[bool, str]:
    """(whether every array of the first run is the robot's, what is wrong)."""
    target = load_target_of(robot)
    truth = drive(robot, 0)
    arrays = run_arrays(proposal, proposal.recordings[0]).arrays
    driven = dict(zip(target.actuators, target.driven, strict=True))
    for role, real in (("joint_pos", truth.pos), ("command", truth.command), ("joint_torque", truth.torque)):
        if role not in proposal.assignments:
            if role != "joint_torque":
                return False, f"no {role}"
            continue
        found = proposal.assignments[role].targets
        names = [driven.get(n, n) for n in found]
        if role != "joint_torque" and sorted(names) != sorted(NAMES[robot]):
            return False, f"{role} of {', '.join(names) or 'nothing'}"
        for k, name in enumerate(names):
            off = _apart(arrays["time"], arrays[role][:, k], truth.time, real[:, NAMES[robot].index(name)])
            if off > 0.15:
                return False, f"{role} of {name} is off by {off:.0%}"
    return True, ""


def load_target_of(robot: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        path.write_text(ROBOTS[robot][0])
        return load_target(path)


def _apart(time: F64, values: F64, true_time: F64, real: F64) -> float:
    """Error (rms) against the spread of what it should be, at the best of a few offsets of the clock's start."""
    good = np.isfinite(values)
    errors = [np.std(values[good] - np.interp(time[good] + d, true_time, real)) for d in np.arange(-0.01, 0.011, 0.005)]
    mean = abs(np.mean(values[good]) - np.mean(real))
    return float(max(min(errors), mean) / np.std(real))


def attempt(name: str, robot: str, write: Callable[[Path], Path], folder: Path) -> dict[str, Any]:
    """One recording written, read and judged."""
    source, doubt = write(folder / name), list[str]()
    try:
        proposal = propose(read(source), load_target_of(robot))
        doubt += [r for r, a in proposal.assignments.items() if a.doubtful]
        if not proposal.complete:
            return {"name": name, "outcome": "not found", "why": "; ".join(proposal.missing[:2]), "doubt": doubt}
        right, why = judge(proposal, robot)
    except RealsimError as error:
        return {"name": name, "outcome": "refused", "why": error.message, "doubt": doubt}
    outcome = "right" if right else "wrong, in doubt" if doubt else "WRONG"
    return {"name": name, "outcome": outcome, "why": why, "doubt": doubt}


# ---------------------------------------------------------------- bad input


def two_robots(p: Path) -> Path:
    logs = [drive("arm", k) for k in range(2)]
    both = [m for k, log in enumerate(logs) for m in (
        writers.joint_states(log, NAMES["arm"], topic=f"/robot{k}/joint_states")
        + writers.float_commands(log, topic=f"/robot{k}/commands"))]  # fmt: skip
    return _mcap(p, both)


def cut_off(p: Path) -> Path:
    log = drive("arm", 0)
    path = _mcap(p, writers.joint_states(log, NAMES["arm"]) + writers.float_commands(log))
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    return path


def an_hour_still(p: Path) -> Path:
    log = drive("arm", 0, still=True)
    time = np.arange(0, 3600, 0.05)
    rows = np.arange(len(time)) % len(log.time)
    return text(p.with_suffix(".csv"), "time,q1,q2,q1_cmd,q2_cmd", time, log.pos[rows], log.command[rows])


def two_rates(p: Path) -> Path:
    log = drive("arm", 0)
    slow = Log(log.time[::20], log.command[::20], log.pos[::20], log.vel[::20], log.torque[::20])
    return _mcap(p, writers.joint_states(log, NAMES["arm"]) + writers.float_commands(slow))


def clock_backwards(p: Path) -> Path:
    log = drive("arm", 0)
    return text(p.with_suffix(".csv"), "time,q1,q2,q1_cmd,q2_cmd", log.time[::-1], log.pos, log.command)


def noise_column(p: Path) -> Path:
    log = drive("arm", 0)
    noise = np.random.default_rng(3).normal(0, 1, (len(log.time), 1))
    return text(p.with_suffix(".csv"), "time,q1,q2,q1_cmd,q2_cmd,velocity1,velocity2", log.time, log.pos, log.command,
                log.vel[:, :1], noise)  # fmt: skip


BAD = (two_robots, cut_off, an_hour_still, two_rates, clock_backwards, noise_column)


def spoil(write: Callable[[Path], Path], folder: Path) -> dict[str, Any]:
    """What is said of an input that no case, or a marked one, should come from."""
    source = write(folder / write.__name__)
    try:
        proposal = propose(read(source), load_target_of("arm"))
        if not proposal.complete:
            return {"name": write.__name__, "outcome": "not found", "why": "; ".join(proposal.missing[:2]), "doubt": []}
        run_arrays(proposal, proposal.recordings[0])
    except RealsimError as error:
        outcome = "refused" + (" with a way out" if error.hint else "")
        return {"name": write.__name__, "outcome": outcome, "why": error.message, "doubt": []}
    doubt = [r for r, a in proposal.assignments.items() if a.doubtful]
    marked = bool(doubt or proposal.warnings)
    said = "; ".join([*proposal.warnings, *(f"{r} in doubt" for r in doubt)])
    return {"name": write.__name__, "outcome": "marked" if marked else "SILENT", "why": said[:300], "doubt": doubt}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", default="", help="recordings whose names hold this")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (robot, write) in FORTY.items():
            if options.only in name:
                rows.append(attempt(name, robot, write, Path(folder)) | {"part": "forty"})
        for bad in BAD:
            if options.only in bad.__name__:
                rows.append(spoil(bad, Path(folder)) | {"part": "bad input"})
    for row in rows:
        print(f"{row['outcome']:22} {row['name']:22} {', '.join(row['doubt']):24} {row['why'][:150]}")
    forty = [r for r in rows if r["part"] == "forty"]
    summary = {
        "right": sum(r["outcome"] == "right" for r in forty), "of": len(forty), "needed": NEEDED,
        "right_without_doubt": sum(r["outcome"] == "right" and not r["doubt"] for r in forty),
        "wrong_and_unmarked": sum(r["outcome"] == "WRONG" for r in forty),
        "bad_input_silent": sum(r["outcome"] == "SILENT" for r in rows),
    }  # fmt: skip
    print(json.dumps(summary))
    if options.out:
        store = Store(options.out, ("part", "name"))
        store.rows = []
        store.facts = {"summary": summary}
        for row in rows:
            store.add(row)


if __name__ == "__main__":
    main()
