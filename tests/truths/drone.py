"""A made quadrotor whose controller alone holds it up."""

from typing import Any

import mujoco
import numpy as np

ROTORS = [(0.15, 0.15), (-0.15, 0.15), (-0.15, -0.15), (0.15, -0.15)]
DRAG = 0.02
"""m: torque about a rotor's axis for each newton of its thrust."""
INERTIA = np.array([0.008, 0.008, 0.014])
GUST = 0.5
"""s within which a gust is forgotten."""
SITES = "".join(f'<site name="r{i}" pos="{x} {y} 0"/>' for i, (x, y) in enumerate(ROTORS))
MOTORS = "".join(
    f'<motor name="rotor{i}" site="r{i}" gear="0 0 1 0 0 {DRAG if i % 2 == 0 else -DRAG}"/>' for i in range(4)
)
DRONE = f"""<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="drone" pos="0 0 1"><freejoint/><site name="imu"/>{SITES}
<inertial pos="0 0 0" mass="1" diaginertia="{INERTIA[0]} {INERTIA[1]} {INERTIA[2]}"/>
<body name="camera" pos="0 0 -.03"><joint name="tilt" axis="0 1 0" damping=".01"/>
<inertial pos="0 0 -.03" mass=".05" diaginertia="2e-5 2e-5 2e-5"/></body></body></worldbody>
<actuator>{MOTORS}</actuator></mujoco>"""
MIX = np.linalg.inv([[1.0] * 4, [y for _, y in ROTORS], [-x for x, _ in ROTORS], [DRAG * (-1) ** i for i in range(4)]])


def fly(
    model: Any, rng: np.random.Generator, late: float = 0.0, seconds: float = 5.0, gusts: float = 0.0
) -> dict[str, np.ndarray]:
    """A flight about a point, 250 Hz; `gusts`: standard deviation of torques that come and go within half a second,
    rad/s2."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    speed, phase = rng.uniform(0.2, 0.6, 3), rng.uniform(0, 6, 3)
    push, drift, rows, sent = np.zeros(3), np.zeros(3), [], [np.full(4, 1.05 * 9.81 / 4)] * (round(late / dt) + 1)
    for step in range(int(seconds / dt)):
        if step % 2 == 0:
            wave = np.sin(2 * np.pi * speed * step * dt + phase) - np.sin(phase)
            away = [0, 0, 1] + [0.5, 0.5, 0.2] * wave - data.qpos[:3]
            drift += 2 * dt * away
            command = np.clip(MIX @ _wrench(data, 6 * away - 4 * data.qvel[:3] + 3 * drift), 0, 8)
            seen = np.concatenate([data.qpos[7:], data.qpos[:7], data.qvel[3:6]])
            rows.append(np.concatenate([[step * dt], command, seen + rng.normal(0, [1e-3, *[5e-4] * 7, *[1e-2] * 3])]))
        sent.append(command)
        data.ctrl = sent[-1 - round(late / dt)]
        if gusts:
            push += np.sqrt(2 * dt / GUST) * rng.normal(0, gusts * INERTIA) - dt / GUST * push
            data.qfrc_applied[3:6] = push
        mujoco.mj_step(model, data)
    time, command, joint, place, quat, gyro = np.split(np.array(rows), [1, 5, 6, 9, 13], axis=1)
    arrays = {"time": time[:, 0], "command": command, "joint_pos": joint, "base_pos": place, "base_quat": quat}
    return arrays | {"imu_gyro": gyro}


def _wrench(data: Any, wanted: np.ndarray) -> np.ndarray:
    """(thrust, three torques) that a drone of 1.05 kg needs for an acceleration."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:7])
    axes = turn.reshape(3, 3)
    up = wanted + np.array([0, 0, 9.81])
    lean = axes.T @ np.cross(axes[:, 2], up / np.linalg.norm(up))
    yaw = np.arctan2(axes[1, 0], axes[0, 0])
    torque = INERTIA * (120 * np.array([lean[0], lean[1], -0.2 * yaw]) - 20 * data.qvel[3:6])
    return np.array([1.05 * up @ axes[:, 2], *torque])
