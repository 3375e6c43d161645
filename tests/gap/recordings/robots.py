"""Two small robots driven in MuJoCo, and what their drivers would log."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder_joint" axis="0 1 0" damping="0.3" armature="0.08" range="-2 2.5" limited="true"/>
      <inertial pos="0 0 -0.2" mass="2.5" diaginertia="0.035 0.035 0.001"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name="elbow_joint" axis="0 1 0" damping="0.12" armature="0.03" range="-0.2 2.4" limited="true"/>
        <inertial pos="0 0 -0.17" mass="1.6" diaginertia="0.018 0.018 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder_servo" joint="shoulder_joint" kp="150" kv="8" forcerange="-45 45"/>
    <position name="elbow_servo" joint="elbow_joint" kp="60" kv="2.6" forcerange="-24 24"/>
  </actuator>
</mujoco>"""


def _leg(name: str, x: float, y: float) -> str:
    side = np.sign(y)
    return f"""
      <body name="{name}_hip" pos="{x} {0.05 * side} 0">
        <joint name="{name}_hip_joint" axis="1 0 0" range="-1 1"/><geom type="sphere" size="0.04" mass="0.6"/>
        <body name="{name}_thigh" pos="0 {0.08 * side} 0">
          <joint name="{name}_thigh_joint" axis="0 1 0" range="-1.5 3.4"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="1"/>
          <body name="{name}_calf" pos="0 0 -0.2">
            <joint name="{name}_calf_joint" axis="0 1 0" range="-2.7 -0.8"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2"/>
            <geom name="{name}_foot" type="sphere" size="0.02" pos="0 0 -0.2" mass="0.05"/>
          </body>
        </body>
      </body>"""


PLACES = {"FL": (0.2, 0.05), "FR": (0.2, -0.05), "RL": (-0.2, 0.05), "RR": (-0.2, -0.05)}
STAND = np.tile([0.0, 0.8, -1.6], 4)
QUADRUPED = f"""
<mujoco model="quadruped">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint armature="0.01" damping="0.1"/></default>
  <worldbody>
    <geom type="plane" size="0 0 0.1"/>
    <body name="trunk" pos="0 0 0.3"><freejoint name="root"/><geom type="box" size="0.25 0.08 0.05" mass="8"/>
      <site name="imu"/>{"".join(_leg(n, *at) for n, at in PLACES.items())}
    </body>
  </worldbody>
  <actuator>{
    "".join(
        f'<position name="{n}_{j}_servo" joint="{n}_{j}_joint" kp="40" kv="1.5"/>'
        for n in PLACES
        for j in ("hip", "thigh", "calf")
    )
}</actuator>
  <sensor><accelerometer name="acc" site="imu"/><gyro name="gyro" site="imu"/></sensor>
</mujoco>"""


@dataclass(frozen=True)
class Log:
    """One run (T samples at 200 Hz, joints in the model's order)."""

    time: np.ndarray
    command: np.ndarray
    pos: np.ndarray
    vel: np.ndarray
    torque: np.ndarray
    acc: np.ndarray | None = None
    gyro: np.ndarray | None = None
    quat: np.ndarray | None = None
    place: np.ndarray | None = None
    force: np.ndarray | None = None


def drive(xml: str, seconds: float = 4.0, seed: int = 0) -> Log:
    """The robot follows slow sines of its joints, each its own; a quadruped squats and leans on its feet."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    floating = bool((model.jnt_type == 0).any())
    base = STAND if floating else np.array([0.3, 1.0])
    data.qpos[-model.nu :] = base
    size = 0.12 if floating else 0.5
    rates, phases = rng.uniform(0.5, 1.3, model.nu), rng.uniform(0, 2 * np.pi, model.nu)
    every = 2 if model.nu < 12 else 5  # 4 or 10 ms... of 2 ms steps
    rows: dict[str, list[np.ndarray]] = {k: [] for k in ("command", "pos", "vel", "torque", "acc", "gyro", "quat",
                                                         "place", "force")}  # fmt: skip
    steps = int(seconds / model.opt.timestep)
    for i in range(-300, steps):
        t = max(i, 0) * model.opt.timestep
        if i % every == 0:
            data.ctrl[:] = base + size * min(t, 1.0) * np.sin(2 * np.pi * rates * t + phases)
            if i >= 0:
                mujoco.mj_forward(model, data)
                rows["command"].append(data.ctrl.copy())
                rows["pos"].append(data.qpos[-model.nu :].copy())
                rows["vel"].append(data.qvel[-model.nu :].copy())
                rows["torque"].append(data.actuator_force.copy())
                if floating:
                    rows["acc"].append(data.sensordata[:3].copy())
                    rows["gyro"].append(data.sensordata[3:6].copy())
                    rows["quat"].append(data.qpos[3:7].copy())
                    rows["place"].append(data.qpos[:3].copy())
                    rows["force"].append(_feet(model, data))
        mujoco.mj_step(model, data)
    time = np.arange(len(rows["pos"])) * every * model.opt.timestep
    full = {k: np.array(v) if v else None for k, v in rows.items()}
    return Log(time, **full)  # type: ignore[arg-type]


def _feet(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(4,) N on the feet, in the model's order."""
    out, wrench = np.zeros(4), np.zeros(6)
    ids = [model.geom(f"{n}_foot").id for n in PLACES]
    for c in range(data.ncon):
        for geom in data.contact[c].geom:
            if geom in ids:
                mujoco.mj_contactForce(model, data, c, wrench)
                out[ids.index(geom)] += wrench[0]
    return out


def save(folder: Path, xml: str) -> Path:
    path = folder / "robot.xml"
    path.write_text(xml)
    return path
