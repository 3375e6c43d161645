"""Robots that only their controller holds up: made flights of a quadrotor, and a pole balanced on its motor.

    python benchmarks/diagnosis/unstable.py --jobs 2            # makes, diagnoses and scores; what is done stays
    python benchmarks/diagnosis/unstable.py --open-loop  # the same by an engine that replays every run as a whole

The real robot has one error, or none; its noise, phases and goals are drawn by the case's number. The replay in
parts was developed on four other flights of this drone: as modelled, with a payload, weaker rotors, and its centre of
mass 1 cm off; the last one requested parts that also end where the replay leaves the log.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np
import tyro

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import hit
from benchmarks.store import Row, Store
from tests.truths.drone import DRONE, fly
from tests.truths.written import write_case

ROOT = Path(__file__).resolve().parents[2]
KEY = ("case", "engine", "replay")
OPEN_LOOP = "realsim.gap.simulation.anchors:GROWTH=1e99"
POLE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="pole" pos="0 0 1"><joint name="pivot" axis="0 1 0" damping=".02" armature=".004" frictionloss=".02"/>
<inertial pos="0 0 .4" mass=".7" diaginertia=".01 .01 .0005"/></body></worldbody>
<actuator><motor name="drive" joint="pivot"/></actuator></mujoco>"""


@dataclass(frozen=True)
class Error:
    """What the real robot has and the model has not."""

    robot: str
    effect: str = ""
    place: str = ""
    size: float = 0.0


ERRORS = [
    *[Error("drone")] * 4,
    Error("drone", "payload", "drone", 0.1),
    Error("drone", "payload", "drone", 0.25),
    Error("drone", "com_offset", "drone", 0.01),
    Error("drone", "com_offset", "drone", -0.004),
    Error("drone", "command_delay", "", 0.012),
    Error("drone", "command_delay", "", 0.02),
    *[Error("pole")] * 4,
    Error("pole", "coulomb_friction", "pivot", 0.1),
    Error("pole", "coulomb_friction", "pivot", 0.2),
    Error("pole", "viscous_friction", "pivot", 0.1),
    Error("pole", "armature", "pivot", 0.03),
    Error("pole", "motor_gain", "pivot", 0.85),
    Error("pole", "motor_gain", "pivot", 1.2),
    Error("pole", "payload", "pole", 0.2),
    Error("pole", "command_delay", "", 0.015),
    Error("drone", "thrust_gain", "", 0.85),
    Error("drone", "thrust_gain", "", 1.1),
]


@dataclass(frozen=True)
class Options:
    jobs: int = os.cpu_count() or 1
    open_loop: bool = False
    only: Annotated[tuple[int, ...], tyro.conf.arg(help="numbers of cases; all if none")] = ()
    work: Path = Path("out/gap_unstable")
    store: Path = ROOT / "benchmarks" / "results" / "gap_unstable.json"


def main(options: Options) -> None:
    numbers = options.only or range(len(ERRORS))
    for k in numbers:
        if not (options.work / "cases" / f"case_{k:02d}" / "log.json").is_file():
            make(k, options.work / "cases" / f"case_{k:02d}")
    replay = "whole" if options.open_loop else "parts"
    figure = OPEN_LOOP if options.open_loop else ""
    todo = {
        k: Job(options.work / "cases" / f"case_{k:02d}", options.work / replay / f"case_{k:02d}", {}, figure)
        for k in numbers
    }
    diagnose_all(list(todo.values()), options.jobs)
    store = Store(options.store, KEY)
    for k, job in todo.items():
        if found := read(job):
            store.add(scored(k, found) | {"replay": replay})
    print("\n".join(table(store.rows)))


def make(k: int, folder: Path) -> None:
    """Write case k."""
    error, rng = ERRORS[k], np.random.default_rng(1000 + k)
    xml = DRONE if error.robot == "drone" else POLE
    spec = mujoco.MjSpec.from_string(xml)
    _apply(spec, error)
    late = error.size if error.effect == "command_delay" else 0.0
    flying = error.robot == "drone"
    model = spec.compile()
    runs = {f"run_{k}": (fly if flying else balance)(model, rng, late) for k in range(6)}
    write_case(folder, xml, runs, command_kind="torque", imu_site="imu" if flying else None)


def _apply(spec: Any, error: Error) -> None:
    if error.effect == "payload":  # at the body's centre of mass
        spec.body(error.place).mass += error.size
    elif error.effect == "com_offset":
        spec.body(error.place).ipos = [error.size, 0.0, 0.0]
    elif error.effect == "coulomb_friction":
        spec.joint(error.place).frictionloss += error.size
    elif error.effect == "viscous_friction":
        spec.joint(error.place).damping = spec.joint(error.place).damping + np.array([error.size, 0, 0])
    elif error.effect == "armature":
        spec.joint(error.place).armature += error.size
    elif error.effect in ("motor_gain", "thrust_gain"):
        for actuator in spec.actuators:
            actuator.gainprm = actuator.gainprm * error.size


def balance(model: Any, rng: np.random.Generator, late: float = 0.0, seconds: float = 5.0) -> dict[str, np.ndarray]:
    """A pole that leans to and fro about its upright position, 250 Hz."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    speed, phase, size = rng.uniform(0.3, 0.9), rng.uniform(0, 6), rng.uniform(0.2, 0.5)
    rows, sent = [], [np.zeros(1)] * (round(late / dt) + 1)
    for step in range(int(seconds / dt)):
        if step % 2 == 0:
            goal = size * (np.sin(2 * np.pi * speed * step * dt + phase) - np.sin(phase))
            command = 12 * (goal - data.qpos) - 1.5 * data.qvel
            seen = np.array([data.qpos[0] + rng.normal(0, 3e-4), data.qvel[0] + rng.normal(0, 1e-2)])
            rows.append([step * dt, command[0], *seen])
        sent.append(command)
        data.ctrl = sent[-1 - round(late / dt)]
        mujoco.mj_step(model, data)
    time, command, place, rate = np.array(rows).T
    return {"time": time, "command": command[:, None], "joint_pos": place[:, None], "joint_vel": rate[:, None]}


def scored(k: int, found: dict[str, Any]) -> Row:
    """The row of case k."""
    error = ERRORS[k]
    label = {"effect": error.effect, "joints": [error.place], "bodies": [error.place]}
    named = found["causes"] if found["verdict"] in ("identified", "ambiguous", "partly_explained") else []
    first = named[0] if named else None
    value = next(iter(first["parameters"].values()))["value"] if first else None
    others = [c for s in found["equivalent"] if named for c in s]
    return {
        "case": k,
        "engine": found["provenance"]["engine"],
        "robot": error.robot,
        "truth": f"{error.effect} {error.size:g}" if error.effect else "none",
        "verdict": found["verdict"],
        "first": f"{first['effect']} {value:.3g}" if first else "",
        "right": not named if not error.effect else bool(first and hit(first, label)),
        "among": not named if not error.effect else any(hit(c, label) for c in [*named[:1], *others]),
        "check": found.get("shrinkage", {}).get("fraction"),
        "cpu_seconds": found.get("cost", {}).get("cpu_seconds"),
    }


def table(rows: Sequence[Row]) -> list[str]:
    """A line a case: whole replay beside parts; and sums."""
    engine = rows[-1]["engine"]
    by = {(r["case"], r["replay"]): r for r in rows if r["engine"] == engine}
    lines = ["| robot | in the robot | replayed as a whole | in parts |", "|---" * 4 + "|"]
    for k in sorted({case for case, _ in by}):
        cells = [_cell(by.get((k, replay))) for replay in ("whole", "parts")]
        one = next(r for (case, _), r in by.items() if case == k)
        lines.append(f"| {one['robot']} | {one['truth']} | {' | '.join(cells)} |")
    for replay in ("whole", "parts"):
        of = [r for (_, p), r in by.items() if p == replay]
        made = [r for r in of if r["truth"] != "none"]
        nulls = [r for r in of if r["truth"] == "none"]
        lines.append(
            f"\n{replay}: right cause first {sum(r['right'] for r in made)} of {len(made)}, with equivalents "
            f"{sum(r['among'] for r in made)}; nothing named {sum(r['right'] for r in nulls)} of {len(nulls)}"
        )
    return lines


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    mark = "" if row["right"] else " (among equivalents)" if row["among"] else " (wrong)" if row["first"] else ""
    return f"`{row['verdict']}` {row['first']}{mark}".strip()


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
