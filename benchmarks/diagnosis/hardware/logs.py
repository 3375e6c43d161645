"""Real robots' logs as cases of the contract: a folder with model, runs and log.json each.

Long runs are cut into windows, so that there are enough runs to fit a baseline on some and to diagnose the others. What
is known of a robot (its data sheet, its authors' description) stands in its model; what is not is fitted later.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from tests.truths.small_robots import SERVO
from tests.truths.written import write_case

# T-Motor AK80-6 with a half-metre rod and a bob; figures of the test bench's own description.
PENDULUM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="rod" pos="0 0 1"><joint name="swing" axis="0 1 0" armature="0.0022" damping="0.01"/>
    <inertial pos="0 0 -0.45" mass="0.676" diaginertia="0.006 0.006 0.0005"/></body></worldbody>
  <actuator><motor name="swing_motor" joint="swing"/></actuator>
</mujoco>"""
WINDOW = 3.0
"""Seconds of a window: several periods of the slowest motion in these logs."""
UNSTABLE = 1.0
"""The same where a small error grows: a pendulum that is driven by its torque alone falls either way."""

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Log:
    """A real log that can be made a case of."""

    make: Callable[[Path, Path], Path]
    """(folder of the logs, folder to write) -> the case."""
    part: str
    """`development`, or `report`: development never looks at these."""
    about: str


def windows(arrays: Mapping[str, np.ndarray], seconds: float = WINDOW) -> list[Arrays]:
    """Equal parts of a run of about `seconds` each, every one with time from 0; at least one."""
    time = arrays["time"]
    count = max(1, round(float(time[-1] - time[0]) / seconds))
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1))
    edges[-1] = len(time)
    parts = [{k: v[a:b] for k, v in arrays.items()} for a, b in pairwise(edges)]
    return [part | {"time": part["time"] - part["time"][0]} for part in parts]


def pendulum(names: tuple[str, ...], seconds: float) -> Callable[[Path, Path], Path]:
    """Runs driven by the measured torque, the first `seconds` of each, in short windows: nothing holds it up there."""

    def make(logs: Path, folder: Path) -> Path:
        runs: dict[str, Arrays] = {}
        for name in names:
            with np.load(logs / "dfki_simple_pendulum" / f"{name}.npz") as file:
                time, position, velocity, torque = file["data"].T
            new = np.concatenate([[True], np.diff(time) > 0]) & (time <= seconds)
            columns = {"command": torque, "joint_pos": position, "joint_vel": velocity}
            run = {"time": time[new]} | {k: v[new, None] for k, v in columns.items()}
            runs |= windows_of(name, run, UNSTABLE)
        return write_case(folder, PENDULUM, runs, command_kind="torque")

    return make


def servo(logs: Path, folder: Path) -> Path:
    """A hobby servo; where it was switched off, the command is missing and `enabled` is 0."""
    runs: dict[str, Arrays] = {}
    for path in sorted((logs / "bam_sts3250").glob("*.npz")):
        with np.load(path) as file:
            column = dict(zip(file["cols"].tolist(), file["data"].T, strict=True))
        new = np.concatenate([[True], np.diff(column["timestamp"]) > 0])
        names = {"command": "goal_position", "joint_pos": "position", "joint_vel": "speed", "enabled": "torque_enable"}
        run = {"time": column["timestamp"][new]} | {k: column[v][new, None] for k, v in names.items()}
        runs |= windows_of(path.stem, run)
    return write_case(folder, SERVO, runs)


def leg(name: str) -> Callable[[Path, Path], Path]:
    """One leg of a quadruped whose trunk is held in the air."""

    def make(logs: Path, folder: Path) -> Path:
        text = (logs / "iit_go2" / "go2.xml").read_text()
        text = re.sub(
            r"<mesh [^>]*/>|<geom [^>]*mesh=[^>]*/>|<freejoint[^>]*/>|<(motor|key|light|camera)\b[^>]*/>", "", text
        )
        spec = mujoco.MjSpec.from_string(text)
        spec.option.timestep = 0.002
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)  # it hangs in the air
        with np.load(logs / "iit_go2" / "traj_0.npz") as file:
            data = {k: file[k] for k in file.files}
        for other in {"FL", "FR", "RL", "RR"} - {name}:
            spec.delete(spec.body(f"{other}_hip"))
        columns = [i for i, j in enumerate(data["joints"]) if str(j).startswith(name)]
        joints = [str(data["joints"][i]) for i in columns]
        for joint in joints:
            actuator = spec.add_actuator(name=f"{joint}_servo", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.set_to_position(kp=float(data["kp"]), kv=float(data["kd"]))
        spec.compile()
        arrays = {"command": data["des_dof_pos"][:, columns], "joint_pos": data["dof_pos"][:, columns]}
        runs = windows_of("sweep", {"time": data["time"].astype(float)} | arrays)
        return write_case(folder, spec.to_xml(), runs, joint_names=joints)

    return make


def windows_of(name: str, arrays: Arrays, seconds: float = WINDOW) -> dict[str, Arrays]:
    """The windows of a long run, each a run with a number behind the name."""
    return {f"{name}_{i:02d}": part for i, part in enumerate(windows(arrays, seconds))}


LEGS = {"FL": "development", "FR": "report", "RL": "report", "RR": "report"}
"""FL was a report log until its misses were looked at."""

LOGS: dict[str, Log] = {
    "servo": Log(servo, "development", "Feetech STS3250, 1.13 kg at 0.12 m, 47 Hz, four motions"),
    "swing_up_feedback": Log(
        pendulum(("energy_shaping_nominal", "sac"), 12.0),
        "development",
        "T-Motor AK80-6 pendulum, swing-ups with feedback, replayed by the measured torque",
    ),
    "swing_up_planned": Log(
        pendulum(("ddp", "dircol", "ilqr"), 9.0),
        "report",
        "the same pendulum, planned trajectories, replayed by the measured torque",
    ),
    **{f"leg_{n}": Log(leg(n), p, f"Unitree Go2, leg {n}, trunk held") for n, p in LEGS.items()},
}
