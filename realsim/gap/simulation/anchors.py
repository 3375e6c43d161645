"""Multiple shooting: where replay would run away, the simulator goes on from a state of the log.

A pendulum that is balanced, or a drone, is held up by its controller. Replayed without it, any small error grows, and
soon says more of the first state than of the robot. So a replay takes the log's state anew each time that a small error
of the last one has grown GROWTH-fold. Whether a robot is replayed in parts is a matter of the model and its commands,
not of the gap. Such parts also end where the replay is off by as much as the robot moves: beyond that no slope holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64, MjModel
from realsim.gap.case.case import Run
from realsim.gap.case.model.edit import Edit
from realsim.gap.case.motion import Motion, estimate
from realsim.gap.simulation.control import controls, switched_off, tracks_of
from realsim.gap.simulation.sampling import rotation_from
from realsim.gap.simulation.state import Anchor, Start, initial_state

if TYPE_CHECKING:
    from realsim.gap.simulation.simulate import Simulator

GROWTH = 10.0
"""An encoder's millimetre or milliradian becomes a centimetre. The first value tried, on four made flights of a drone;
not tuned. On 22 other cases: `benchmarks/diagnosis/unstable.py`."""
SMALL = 1e-4
"""rad or m of the error that is let grow, and of the steps that slopes are taken over: small enough to be linear, large
beside rounding. Not tuned."""
LEAST = 0.1
"""s between two states, three times the half window that a velocity is estimated over. Not tuned."""
FLIGHT = 0.2
"""The same of a robot in the air, whose replay may part from a hover at once: what it lacks shows in how far it has
gone by then. A Crazyflie with 3.9 g more at one rotor turns by 1 rad within it, and after 0.5 s no slope holds."""


def anchored(simulator: Simulator) -> tuple[Start, ...]:
    """The starts of the runs, with the states from which each goes on.

    A robot that falls in one run is held up by its controller in all: every run then begins in a state of the log, also
    one in which it keeps still, which no command of its own makes it do. Only runs in which it falls are in parts.
    """
    case, starts = simulator.case, simulator.starts
    if not case.whole:
        return starts
    replays = [_Replay.of(simulator, run, start) for run, start in zip(case.runs, starts, strict=True)]
    if not any(replay and replay.falls() for replay in replays):
        return starts
    return tuple(replay.in_parts() if replay else start for replay, start in zip(replays, starts, strict=True))


class _Replay:
    """One run, replayed from states of the log."""

    def __init__(self, simulator: Simulator, run: Run, start: Start, motion: Motion) -> None:
        self.simulator, self.run, self.motion, self.edit = simulator, run, motion, Edit(simulator.context)
        self.flies = simulator.case.floating and not simulator.context.driven
        self.held = not self.flies and simulator.case.command_kind != "torque"
        self.start, self.last = start, run.duration - LEAST
        self.model = self.edit.compiled(run.setup)
        self.dt = float(self.model.opt.timestep)
        self.steps = int(np.ceil(run.duration / self.dt)) + 2
        case = simulator.case
        self.control = controls(simulator.context, self.model, run, self.edit, self.steps, 0)
        self.off = switched_off(case, self.model, run, self.edit, self.steps, 0)
        tracks = {"pos": motion.qpos[:, [case.model.joint(n).qposadr[0] for n in case.joint_names]]}
        if case.floating:
            adr = int(case.model.jnt_qposadr[np.flatnonzero(case.model.jnt_type == 0)[0]])
            tracks |= {"base_pos": motion.qpos[:, adr : adr + 3], "base_quat": motion.qpos[:, adr + 3 : adr + 7]}
        grid = np.searchsorted(motion.time, np.arange(self.steps) * self.dt).clip(0, len(motion.time) - 1)
        self.logged = {name: values[grid] for name, values in tracks.items()}
        self.spread = np.maximum(self._coordinates(self.logged, 0).std(axis=0), 10 * SMALL)
        travel = np.nanstd(np.concatenate([r.signals["joint_pos"] for r in case.runs]), axis=0)
        self.spread[: len(travel)] = np.maximum(self.spread[: len(travel)], travel)  # a run may be one of standing

    @staticmethod
    def of(simulator: Simulator, run: Run, start: Start) -> _Replay | None:
        """None of a run that is too short, or in which the robot touches something: feet that strike part from the log
        for good (see Comparison)."""
        try:
            motion = estimate(simulator.case, run)
        except GapError:
            return None
        return None if _in_contact(simulator.case.model, motion) else _Replay(simulator, run, start, motion)

    def falls(self) -> bool:
        """Whether a small error of the state that the run begins in grows too much before its end. Of a robot that no
        servo holds, in the air or driven by torques, whether the replay parts from the log at all: spinning away, it
        lets no small error grow, and no slope holds."""
        return self.bears(self.start, 0.0, near=not self.held) <= self.last

    def in_parts(self) -> Start:
        """The run's start with the states from which its replay goes on."""
        motion, reason = self.motion, "a small error would grow too fast in replay"
        least = LEAST if self.held else FLIGHT
        begun = self.start if self.start.moving else Start("log", motion.qpos[0], motion.qvel[0])
        here, anchors, at = begun, list[Anchor](), 0.0
        if not self.falls():  # a replay that only drifts shows what is wrong the longer it is
            return replace(begun, reason="nothing but its controller holds this robot")
        while (at := at + max(self.bears(here, at, near=True), least)) <= self.last:
            good = np.flatnonzero(motion.good & (motion.time >= at))
            if not len(good):
                break
            at, qpos, qvel = (float(motion.time[good[0]]), motion.qpos[good[0]], motion.qvel[good[0]])
            anchors.append(Anchor(at, qpos, qvel))
            here = Start("log", qpos, qvel)
        return replace(begun, reason=reason, anchors=tuple(anchors))

    def bears(self, start: Start, at: float, near: bool = False) -> float:
        """s from a moment of the run for which a small error of the state that the replay begins in stays small and,
        if asked, the replay itself stays nearer to the log than the robot moves; inf to the run's end."""
        import mujoco

        first, simulator = round(at / self.dt), self.simulator
        state = initial_state(simulator.case, self.model, self.run, self.edit, start)
        data, kind = mujoco.MjData(self.model), mujoco.mjtState.mjSTATE_FULLPHYSICS
        mujoco.mj_setState(self.model, data, state, kind)
        mujoco.mj_integratePos(self.model, data.qpos, np.full(self.model.nv, SMALL), 1.0)
        aside = np.zeros(len(state))
        mujoco.mj_getState(self.model, data, aside, kind)
        offs = None if self.off is None else [self.off[first:]] * 2
        rolled = simulator.rolled(self.model, [state, aside], [self.control[first:]] * 2, self.edit, offs)
        one, other = (
            self._coordinates(tracks_of(simulator.context, self.model, s, 0, self.edit), first) for s in rolled
        )
        lost = ~(np.abs(one - other).max(axis=1) <= GROWTH * SMALL)
        if near:
            off = (one - self._coordinates(self.logged, first)[first:]) / self.spread
            lost |= ~(np.square(off).mean(axis=1) <= 1.0)
        return float(np.argmax(lost)) * self.dt if lost.any() else np.inf

    def _coordinates(self, tracks: Mapping[str, F64], first: int) -> F64:
        """(N, K) of joints and base, turns counted from the log's orientation at a step."""
        if "base_pos" not in tracks:
            return tracks["pos"]
        turn = rotation_from(tracks["base_quat"], self.logged["base_quat"][first])
        return np.concatenate([tracks["pos"], tracks["base_pos"], turn], axis=1)


def _in_contact(model: MjModel, motion: Motion, every: float = 0.1) -> bool:
    """Whether the robot touches anything in some state of the log."""
    import mujoco

    data, step = mujoco.MjData(model), max(round(every / (motion.time[1] - motion.time[0])), 1)
    for qpos in motion.qpos[motion.good][::step]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return True
    return False
