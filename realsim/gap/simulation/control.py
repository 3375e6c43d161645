"""What goes into a simulation step by step, and what is taken out of it: controls, switches, tracks of the signals."""

from collections.abc import Sequence

import numpy as np

from realsim.core.filters import low_passed
from realsim.core.types import F64, Bool, MjModel
from realsim.gap.case.case import Case, Run
from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import Edit
from realsim.gap.simulation.sampling import held_mean
from realsim.gap.simulation.state import Start

LIMIT = 1e4
"""A coordinate or speed beyond this (m, rad, /s) means that the simulation has exploded."""


def controls(
    context: Context,
    model: MjModel,
    run: Run,
    edit: Edit,
    steps: int,
    settle: int,
    start: Start | None = None,
) -> F64:
    """(steps, U) control of every step, the first `settle` of them before the run begins.

    What was commanded before the log began it does not say: its first command, but where a servo stands still
    elsewhere (`start`), that posture. A delayed command, or a delayed reading, needs it.
    """
    case, dt, command, time = context.case, float(model.opt.timestep), run.command, run.time
    if start is not None and start.stands and case.command_kind == "position":
        command, time = np.vstack([_at_posture(case, command[0], start), command]), np.append(time[0] - 1.0, time)
    command = command.copy()
    if case.command_kind == "position":
        for u, name in enumerate(case.actuator_names):
            joint = next((j for j, a in context.actuator.items() if a == name), "")
            command[:, u] -= case.gear(joint) * edit.signals.joint_offset.get(joint, 0.0)
    grid = (np.arange(steps + 1) - settle) * dt
    mean = held_mean(time, command, grid - edit.signals.command_delay)
    control = np.zeros((steps, model.nu))
    for u, name in enumerate(case.actuator_names):
        i = model.actuator(name).id
        control[:, i] = mean[:, u]
        if (lag := case.lags.get(name, 0.0) + edit.signals.actuator_lag) > 0:
            low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
            control[:, i] = lagged(np.clip(control[:, i], low, high), lag, dt)
    for pulse in edit.signals.pulses:
        began = edit.onsets.get(run.name) if pulse.by_onset else 0.0
        if began is not None:
            since = grid[:-1] - began
            control[:, model.actuator(pulse.actuator).id] = (since >= pulse.start) & (since < pulse.end)
    return control


def lagged(values: F64, lag: float, dt: float) -> F64:
    """(N,) mean over each step of the response of a first-order lag to values that are held over steps of dt; at rest
    before the first. Both `lag`, its time constant, and dt in s."""
    keeps = np.exp(-dt / lag)
    at_end = low_passed(values, lag, dt)
    at_begin = np.concatenate([values[:1], at_end[:-1]])
    return np.asarray(values + (at_begin - values) * (1 - keeps) * lag / dt)


def _at_posture(case: Case, first: F64, start: Start) -> F64:
    """(U,) commands under which servos hold the posture of a start."""
    assert start.qpos is not None
    held = first.copy()
    for u, name in enumerate(case.actuator_names):
        joint = next((j for j in case.joint_names if case.actuator_of(j) == name), None)
        if joint is not None:
            held[u] = case.gear(joint) * start.qpos[case.model.joint(joint).qposadr[0]]
    return held


def switched_off(case: Case, model: MjModel, run: Run, edit: Edit, steps: int, settle: int) -> Bool | None:
    """(steps, U) bool of actuators that give no force at a step, or None; before the run as at its first sample."""
    if run.enabled is None:
        return None
    grid = (np.arange(steps) - settle + 0.5) * model.opt.timestep - edit.signals.command_delay
    row = np.clip(np.searchsorted(run.time, grid, side="right") - 1, 0, len(run.time) - 1)
    off = np.zeros((steps, model.nu), bool)
    for u, name in enumerate(case.actuator_names):
        off[:, model.actuator(name).id] = ~run.enabled[row, u]
    return off


def tracks_of(context: Context, model: MjModel, sensors: F64, settle: int, edit: Edit) -> dict[str, F64]:
    """Signals on the simulator's grid, from the first settling step; NaN after a failure. `sensors`: (N, S)."""
    case = context.case

    def take(prefix: str, names: Sequence[str], width: int = 1) -> F64:
        key = prefix, *names
        if key not in context.sensors:
            context.sensors[key] = [model.sensor(prefix + n).adr[0] + k for n in names for k in range(width)]
        return sensors[:, context.sensors[key]]

    pos, vel = take("rs_pos_", case.joint_names), take("rs_vel_", case.joint_names)
    force = take("rs_force_", case.actuator_names)
    torque = np.zeros_like(pos)
    for j, joint in enumerate(case.joint_names):
        if joint in context.passive:
            torque[:, j] = take("rs_push_", [joint])[:, 0]
        else:
            u = case.actuator_names.index(context.actuator[joint])
            torque[:, j] = case.gear(joint) * force[:, u]
            motor = model.joint(edit.motor_joint(joint)).id
            if model.jnt_actfrclimited[motor]:  # the sensor reads what the actuator gives, before the joint's limit
                back = edit.signals.back_emf.get(joint, 0.0) * vel[:, j]
                torque[:, j] = np.clip(torque[:, j] + back, *model.jnt_actfrcrange[motor]) - back
    tracks = {"pos": pos, "vel": vel, "torque": torque}
    if case.floating:
        tracks["base_pos"], tracks["base_quat"] = take("rs_base_pos", [""], 3), take("rs_base_quat", [""], 4)
    if case.imu_site:
        tracks["gyro"], tracks["acc"] = take("rs_gyro", [""], 3), take("rs_acc", [""], 3)
    bad = ~np.isfinite(sensors).all(axis=1) | (np.abs(vel) > LIMIT).any(axis=1)
    if bad.any():
        for name in tracks:
            tracks[name] = tracks[name].copy()
            tracks[name][int(np.argmax(bad)) :] = np.nan
    tracks["settle"] = np.array([settle * model.opt.timestep, model.opt.timestep])
    return tracks
