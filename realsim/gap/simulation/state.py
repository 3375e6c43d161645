"""The state that a run begins in, or goes on from: what it is, and how a changed model takes it over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64, MjData, MjModel
from realsim.gap.case.case import Case, Run
from realsim.gap.case.model.edit import Edit
from realsim.gap.simulation.stepping import fresh

AT_REST = 0.05
"""rad/s or m/s: slower than this is at rest."""


@dataclass(frozen=True)
class Anchor:
    """A state of the log from which a replay goes on."""

    time: float
    """s in the run."""
    qpos: F64
    """(nq,) of the nominal model."""
    qvel: F64
    """(nv,)"""


@dataclass(frozen=True)
class Start:
    """How one run begins."""

    kind: str = "rest"
    """`rest`: the first command was held until the robot stood still. `given`: init_qpos and init_qvel. `log`: the
    first samples."""
    qpos: F64 | None = None
    """(nq,) of the nominal model; None at rest."""
    qvel: F64 | None = None
    """(nv,)"""
    encoders: bool = True
    """Joint positions are encoder readings: an encoder's offset and delay are in them too."""
    reason: str = "the robot stands still"
    anchors: tuple[Anchor, ...] = ()
    """Where the replay goes on from the log's state; see realsim.gap.simulation.anchors."""

    @property
    def moving(self) -> bool:
        return self.qpos is not None

    @property
    def stands(self) -> bool:
        """Whether it begins in a posture of the log, and without motion."""
        return self.qpos is not None and (self.qvel is None or float(np.abs(self.qvel).max(initial=0.0)) < AT_REST)

    @property
    def reads_the_log(self) -> bool:
        """Whether what the sensors do changes a state that the simulator is in."""
        return self.moving or bool(self.anchors)

    def part(self, k: int) -> Start:
        """How part k of the run begins."""
        return replace(self, anchors=()) if k == 0 else Start("log", self.anchors[k - 1].qpos, self.anchors[k - 1].qvel)


def initial_state(case: Case, model: MjModel, run: Run, edit: Edit, start: Start | None = None) -> F64:
    """(S,) full physics state of a changed model at the first sample: `start`'s, or the logged pose without motion."""
    import mujoco

    data = fresh(model)
    nominal = case.model
    qpos = start.qpos if start and start.qpos is not None else run.init_qpos
    if qpos is not None:
        for j in range(nominal.njnt):
            width = 7 if nominal.jnt_type[j] == 0 else 4 if nominal.jnt_type[j] == 1 else 1
            a, b = nominal.jnt_qposadr[j], model.jnt_qposadr[_counterpart(nominal, model, j)]
            data.qpos[b : b + width] = qpos[a : a + width]
    elif case.floating and "base_pos" in run.signals:
        adr = int(model.joint(int(np.flatnonzero(model.jnt_type == 0)[0])).qposadr[0])
        data.qpos[adr : adr + 3] = first_rows(run.signals["base_pos"])
        if "base_quat" in run.signals:
            quat = first_rows(run.signals["base_quat"])
            data.qpos[adr + 3 : adr + 7] = quat / max(float(np.linalg.norm(quat)), 1e-9)
    moved = start.qpos if start else None
    read = first_rows(run.signals["joint_pos"]) if moved is None else np.zeros(len(case.joint_names))
    for j, name in enumerate(case.joint_names):
        true = read[j] if moved is None else moved[nominal.joint(name).qposadr[0]]
        if start is None or start.encoders:
            true = true - edit.signals.joint_offset.get(name, 0.0) - edit.signals.reading_offset.get(name, 0.0)
        data.qpos[model.joint(name).qposadr[0]] = true
        if name in edit.signals.rotors:
            data.qpos[model.joint(edit.signals.rotors[name]).qposadr[0]] = true
    if start is not None and start.qvel is not None:
        _set_speeds(nominal, model, data, edit, start.qvel)
    mujoco.mj_forward(model, data)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def _set_speeds(nominal: MjModel, model: MjModel, data: MjData, edit: Edit, qvel: F64) -> None:
    """A rotor behind play or a spring moves with its joint."""
    for j in range(nominal.njnt):
        name = nominal.joint(j).name
        width = {0: 6, 1: 3}.get(int(nominal.jnt_type[j]), 1)
        a, b = nominal.jnt_dofadr[j], model.jnt_dofadr[_counterpart(nominal, model, j)]
        data.qvel[b : b + width] = qvel[a : a + width]
        if name in edit.signals.rotors:
            data.qvel[model.joint(edit.signals.rotors[name]).dofadr[0]] = qvel[a]


def _counterpart(nominal: MjModel, model: MjModel, joint: int) -> int:
    """Index of a nominal joint in a changed model. Effects add only joints with names, so nameless ones keep order."""
    name = nominal.joint(joint).name
    if name:
        return int(model.joint(name).id)
    before = sum(not nominal.joint(k).name for k in range(joint))
    return [k for k in range(model.njnt) if not model.joint(k).name][before]


def first_rows(values: F64, count: int = 5) -> F64:
    """Median of the first finite rows: the pose at rest, without the encoder's noise."""
    good = values[:0]
    for end in (2 * count, len(values)):  # hardly ever are all looked at
        if len(good) < count:
            good = values[:end][np.isfinite(values[:end]).all(axis=1)][:count]
    if not len(good):
        raise GapError("a signal has no complete sample")
    return np.asarray(np.median(good, axis=0))
