"""Cases made of logs of real robots: a torque-driven pendulum, a quadruped's legs in the air, a hobby servo as CSV."""

import json
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tests.truths.small_robots import SERVO
from tests.truths.written import write_case

# T-Motor AK80-6 with a half-metre rod and a bob; figures of the test bench's own description.
PENDULUM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="rod" pos="0 0 1"><joint name="swing" axis="0 1 0" armature="0.0022"/>
    <inertial pos="0 0 -0.45" mass="0.676" diaginertia="0.006 0.006 0.0005"/></body></worldbody>
  <actuator><motor name="swing_motor" joint="swing"/></actuator>
</mujoco>"""


def pendulum(logs: Path, folder: Path, names: list[str]) -> Path:
    """Runs driven by the measured torque."""
    runs = {}
    for name in names:
        with np.load(logs / "dfki_simple_pendulum" / f"{name}.npz") as file:
            data = file["data"][:2400]
        time, position, velocity, torque = data.T
        new = np.concatenate([[True], np.diff(time) > 0])
        columns = {"command": torque, "joint_pos": position, "joint_vel": velocity, "joint_torque": torque}
        runs[name] = {"time": time[new]} | {k: v[new, None] for k, v in columns.items()}
    return write_case(folder, PENDULUM, runs, command_kind="torque", torque_kind="measured")


def servo(logs: Path, folder: Path) -> Path:
    """CSV with the servo's own column names, and a map."""
    case = write_case(folder, SERVO, {})
    for path in sorted((logs / "bam_sts3250").glob("*.npz")):
        with np.load(path) as file:
            rows = [",".join(file["cols"]), *(",".join(repr(float(v)) for v in row) for row in file["data"])]
        (case / "runs" / f"{path.stem}.csv").write_text("\n".join(rows))
    columns: dict[str, Any] = {"time": "timestamp", "command": ["goal_position"], "joint_pos": ["position"]}
    (case / "columns.json").write_text(json.dumps(columns | {"joint_vel": ["speed"]}))
    return case


def legs(logs: Path, folder: Path, contacts: bool = False) -> Path:
    """The quadruped without its pictures, its trunk held in the air, its gains as position servos."""
    text = (logs / "iit_go2" / "go2.xml").read_text()
    text = re.sub(
        r"<mesh [^>]*/>|<geom [^>]*mesh=[^>]*/>|<freejoint[^>]*/>|<(motor|key|light|camera)\b[^>]*/>", "", text
    )
    with np.load(logs / "iit_go2" / "traj_0.npz") as file:
        data = {k: file[k] for k in file.files}
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = 0.002
    if not contacts:  # a trunk that is fixed to the world would push its own hips away
        spec.option.disableflags = int(spec.option.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    names = [str(j) for j in data["joints"]]
    for name in names:
        servo = spec.add_actuator(name=f"{name}_servo", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=float(data["kp"]), kv=float(data["kd"]))
    spec.compile()
    columns = {"time": data["time"].astype(float), "command": data["des_dof_pos"], "joint_pos": data["dof_pos"]}
    run = {k: v[:1200] for k, v in columns.items()}
    return write_case(folder, spec.to_xml(), {"sweep": run}, joint_names=names)
