"""One run: in one go, or step by step for laws that change the model as it moves (friction that goes with the load)."""

import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from realsim.core.types import F64, Bool, MjData, MjModel


@dataclass(frozen=True)
class Gear:
    """A joint whose dry friction is that of the model, and a ratio of the torque that its drive delivers."""

    dof: int
    """Of the motor's side."""
    actuator: int
    ratio: float
    """N m of friction for 1 N m of the actuator's force."""
    limit: tuple[float, float] = (-np.inf, np.inf)
    """Of the actuator's force, N m: what the joint's own limit lets through."""


def gears(model: MjModel, load_friction: Mapping[str, float], drives: Mapping[str, tuple[str, str]]) -> list[Gear]:
    """`load_friction`: joint -> ratio. `drives`: joint -> (joint on the motor's side, actuator)."""
    found = []
    for joint, ratio in load_friction.items():
        motor, actuator = drives[joint]
        u, j = model.actuator(actuator), model.joint(motor)
        turn, limit = float(u.gear[0]), (-np.inf, np.inf)
        if model.jnt_actfrclimited[j.id] and turn:
            low, high = sorted(float(end) / turn for end in model.jnt_actfrcrange[j.id])
            limit = (low, high)
        found.append(Gear(int(j.dofadr[0]), int(u.id), ratio * abs(turn), limit))
    return found


@dataclass(frozen=True)
class Waves:
    """Torques of R joints that go with their positions."""

    address: npt.NDArray[np.int64]
    """(R,) of the joints' positions."""
    dof: npt.NDArray[np.int64]
    """(R,)"""
    constant: F64
    """(R,) N m"""
    cosine: F64
    """(R, H) N m, of the angle and its multiples."""
    sine: F64
    """(R, H)"""

    def at(self, qpos: F64) -> F64:
        """(R,) N m"""
        angle = qpos[self.address][:, None] * np.arange(1, self.cosine.shape[1] + 1)
        return self.constant + (self.cosine * np.cos(angle) + self.sine * np.sin(angle)).sum(axis=1)


def waves(model: MjModel, position_torque: Mapping[str, Sequence[float]]) -> Waves | None:
    """`position_torque`: joint -> constant, cosine, sine, cosine of twice the angle, ... None of none."""
    if not position_torque:
        return None
    joints = [model.joint(name) for name in position_torque]
    series = np.array(list(position_torque.values()), float)
    address, dof = ([int(getattr(j, k)[0]) for j in joints] for k in ("qposadr", "dofadr"))
    return Waves(np.array(address), np.array(dof), series[:, 0], series[:, 1::2], series[:, 2::2])


def spare(model: MjModel) -> None:
    """Take from the model what costs time at every step and cannot change one: a sixth of an arm's, in place.

    A sweep for contacts where no two shapes may touch, and the sorting into islands of what is one tree anyway.
    """
    import mujoco

    idle = mujoco.mjtDisableBit.mjDSBL_CONTACT if not _may_touch(model) else 0
    idle |= mujoco.mjtDisableBit.mjDSBL_ISLAND if model.ntree == 1 else 0
    model.opt.disableflags |= int(idle)


def _may_touch(model: MjModel) -> bool:
    moving = model.body_weldid[model.geom_bodyid] != 0
    types, affinities = model.geom_contype, model.geom_conaffinity
    all_of = np.bitwise_or.reduce
    ours = all_of(types[moving]) & all_of(affinities) | all_of(types) & all_of(affinities[moving])
    return bool(model.npair or model.nflex or ours)


_HERE = threading.local()


def fresh(model: MjModel) -> MjData:
    """The calling thread's MjData of a model, as new. Python's side of one is many arrays, which take longer to make
    than hundreds of a small robot's steps."""
    import mujoco

    if getattr(_HERE, "model", None) is not model:
        _HERE.model, _HERE.data = model, mujoco.MjData(model)
    mujoco.mj_resetData(model, _HERE.data)
    return _HERE.data


Roller = Callable[[Any, F64, F64], tuple[F64, F64]]
"""(model, (X,) full physics state to begin in, (T, U) control) -> ((T, S) sensors, (X,) state at the end)."""


def switched(step: Roller, model: MjModel, state: F64, control: F64, off: Bool | None = None) -> F64:
    """(T, S) sensors of a run whose actuators give no force where `off` (T, U) is true: piece by piece."""
    if off is None or not off.any():
        return step(model, state, control)[0]
    edges = [0, *(np.flatnonzero((np.diff(off, axis=0)).any(axis=1)) + 1), len(off)]
    parts = []
    for begin, end in pairwise(edges):
        piece = model
        if off[begin].any():
            piece = copy.copy(model)
            piece.actuator_gainprm[off[begin]] = 0.0
            piece.actuator_biasprm[off[begin]] = 0.0
        sensors, state = step(piece, state, control[begin:end])
        parts.append(sensors)
        if not np.isfinite(state).all():
            parts.append(np.full((len(off) - end, sensors.shape[1]), np.nan))
            break
    return np.concatenate(parts)


def rolled(model: MjModel, state: F64, control: F64) -> tuple[F64, F64]:
    """A run of T steps in one go: a `Roller`.

    Args:
        state: (X,) full physics state to begin in.
        control: (T, U).
    """
    from mujoco import rollout

    with rollout.Rollout(nthread=0) as here:
        states, sensors = here.rollout(model, [fresh(model)], state[None], control[None])
    return np.asarray(sensors[0]), np.asarray(states[0, -1])


def stepped(
    laws: Sequence[Gear], model: MjModel, state: F64, control: F64, waves: Waves | None = None
) -> tuple[F64, F64]:
    """The same under laws of friction that go with the torque of the step before, and torques that go with positions.

    NaN from where MuJoCo gives it up.
    """
    import mujoco

    data = fresh(model)
    model = copy.copy(model)  # its friction changes on the way, and other threads step it too
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    friction, force, sensors = model.dof_frictionloss, data.actuator_force, data.sensordata
    least = [friction.item(law.dof) for law in laws]
    rows = np.empty((len(control), model.nsensordata))
    last, now, step = data.time, data.ctrl, mujoco.mj_step
    now[:] = control[0]
    mujoco.mj_forward(model, data)
    for k, ctrl in enumerate(control):
        for law, own in zip(laws, least, strict=True):  # few: Python's numbers are quicker than NumPy's arrays of them
            low, high = law.limit
            passed = min(max(force.item(law.actuator), low), high)
            friction[law.dof] = max(own + law.ratio * abs(passed), 0.0)
        now[:] = ctrl
        if waves is not None:
            data.qfrc_applied[waves.dof] = waves.at(data.qpos)
        step(model, data)
        if data.time <= last:  # the state was no number, and MuJoCo has begun anew
            rows[k:] = np.nan
            break
        rows[k], last = sensors, data.time
    end = np.full(len(state), np.nan)
    if np.isfinite(rows[-1]).all():
        mujoco.mj_getState(model, data, end, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return rows, end
