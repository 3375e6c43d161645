"""Start of a run in the simulator: at rest under its first command, or exactly in the state it was recorded from.

Sensors and drives make a robot at rest look out of place: an encoder with an offset, play, a load that the model does
not know. None of that moves. So a run is taken out of rest only where the log moves in its first moments in a way that
the state it begins in explains and that a start from rest does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.case.case import Case, Run
from realsim.gap.case.kinks import median_size, third_differences
from realsim.gap.case.model.edit import Edit
from realsim.gap.simulation.stepping import fresh

if TYPE_CHECKING:
    from realsim.gap.simulation.simulate import Simulator

STILL = 0.05
"""rad/s or m/s: slower than this is at rest."""
FAR = 0.03
"""rad or m: a posture farther than this from the nominal simulator's rest may be one that the robot was let go from."""
NOISES = 5.0
"""Standard deviations of its estimate that a first speed must exceed."""
BEGINNING = 0.3
"""s in which a state that is out of equilibrium shows."""
FIRST = 0.08
"""s that a first state is estimated from."""
DECISIVE = 0.35
"""A start in motion must leave at most this share of the squared error that a start at rest leaves."""
LEAST_MOTION = 2e-3
"""rad or m (root mean square) that a start from rest must miss of the first moments."""


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
    def reads_the_log(self) -> bool:
        """Whether what the sensors do changes a state that the simulator is in."""
        return self.moving or bool(self.anchors)

    def part(self, k: int) -> Start:
        """How part k of the run begins."""
        return replace(self, anchors=()) if k == 0 else Start("log", self.anchors[k - 1].qpos, self.anchors[k - 1].qvel)


def initial_state(case: Case, model: Any, run: Run, edit: Edit, start: Start | None = None) -> F64:
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


def _set_speeds(nominal: Any, model: Any, data: Any, edit: Edit, qvel: F64) -> None:
    """A rotor behind play or a spring moves with its joint."""
    for j in range(nominal.njnt):
        name = nominal.joint(j).name
        width = {0: 6, 1: 3}.get(int(nominal.jnt_type[j]), 1)
        a, b = nominal.jnt_dofadr[j], model.jnt_dofadr[_counterpart(nominal, model, j)]
        data.qvel[b : b + width] = qvel[a : a + width]
        if name in edit.signals.rotors:
            data.qvel[model.joint(edit.signals.rotors[name]).dofadr[0]] = qvel[a]


def _counterpart(nominal: Any, model: Any, joint: int) -> int:
    """Index of a nominal joint in a changed model. Effects add only joints with names, so nameless ones keep order."""
    name = nominal.joint(joint).name
    if name:
        return int(model.joint(name).id)
    before = sum(not nominal.joint(k).name for k in range(joint))
    return [k for k in range(model.njnt) if not model.joint(k).name][before]


def first_rows(values: F64, count: int = 5) -> F64:
    """Median of the first finite rows: the pose at rest, without the encoder's noise."""
    good = values[np.isfinite(values).all(axis=1)][:count]
    if not len(good):
        raise GapError("a signal has no complete sample")
    return np.asarray(np.median(good, axis=0))


# ---------------------------------------------------------------- which runs


def find_starts(simulator: Simulator, resting: Sequence[F64]) -> tuple[Start, ...]:
    """How every run begins. `resting`: (T, C) a run, what the nominal simulator reads after a start at rest."""
    case = simulator.case
    starts = [Start() for _ in case.runs]
    trials: dict[int, Start] = {}
    for i, run in enumerate(case.runs):
        if run.init_qvel is not None and np.abs(run.init_qvel).max(initial=0.0) > STILL:
            trials[i] = _given(case, run)
        elif _suspicious(simulator, run, resting[i]):
            trials[i] = _from_log(case, run)
    if not trials:
        return tuple(starts)
    predicted = _trial(simulator, trials)
    for _ in range(2):  # a servo's motion is no parabola: what the nominal simulator leaves of it nearly is
        refined = {
            i: _refined(simulator, case.runs[i], trials[i], predicted[i])
            for i in trials
            if trials[i].kind == "log" and _motion_missed(simulator, case.runs[i], predicted[i]) < np.inf
        }
        if not refined:
            break
        trials |= refined
        predicted |= _trial(simulator, refined)
    for i, start in trials.items():
        before = _motion_missed(simulator, case.runs[i], resting[i])
        after = _motion_missed(simulator, case.runs[i], predicted[i])
        if start.kind == "given":
            believed = after < max(4 * before, LEAST_MOTION**2)
        else:
            believed = after < DECISIVE * before and before > LEAST_MOTION**2
        if believed:
            starts[i] = start
        elif start.kind == "given":
            starts[i] = Start(reason="the log stands still where init_qvel says that it moves")
    return tuple(starts)


def _trial(simulator: Simulator, trials: dict[int, Start]) -> dict[int, F64]:
    """(T, C) a run; only the first BEGINNING seconds mean anything."""
    chosen = list(trials)
    edit = simulator.edited(())
    raw = simulator.roll_out(edit, chosen, starts=[trials[i] for i in chosen], seconds=BEGINNING)
    return {i: simulator.read(simulator.case.runs[i], r, edit) for i, r in zip(chosen, raw, strict=True)}


def _given(case: Case, run: Run) -> Start:
    """The state that the log gives; its positions where it gives only speeds."""
    guess = _from_log(case, run)
    assert guess.qpos is not None
    if run.init_qpos is None:
        return replace(guess, kind="given", qvel=run.init_qvel, reason="init_qvel says that it moves")
    reading = run.signals["joint_pos"][0]
    if not np.isfinite(reading).all():
        reading = guess.qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]]
    given = run.init_qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]]
    return Start("given", run.init_qpos, run.init_qvel, _agree(run, reading, given), "init_qvel says that it moves")


def _from_log(case: Case, run: Run) -> Start:
    """The state of the first samples; of parts that are not logged, the given one."""
    from realsim.gap.case.motion import estimate

    motion = estimate(case, run)
    qpos, qvel = motion.qpos[0].copy(), motion.qvel[0].copy()
    return Start("log", qpos, qvel, reason="its first samples move as from a state of their own")


def _agree(run: Run, reading: F64, given: F64) -> bool:
    """Whether a given posture is what the encoders read, and so has their errors."""
    return bool(np.nanmax(np.abs(reading - given)) < 3e-3 + NOISES * float(np.max(_noise(run.signals["joint_pos"]))))


def _suspicious(simulator: Simulator, run: Run, resting: F64) -> bool:
    """A first look, without any simulation: does the log move from the start, or come back from another posture?"""
    if simulator.case.floating and "base_pos" not in run.signals and run.init_qpos is None:
        return False  # nobody knows where the base is
    for columns, signal in _moving_parts(simulator):
        values = run.signals[signal]
        error = values - resting[:, columns]
        inside = run.time <= BEGINNING
        if not np.isfinite(resting[inside][:, columns]).all() or not np.isfinite(values[inside]).any(axis=0).all():
            continue
        noise = _noise(values)
        speed, spread = first_fit(run.time, values, 2)[1], _speed_spread(run.time) * noise
        place, excess = first_fit(run.time, error, 2)
        fast = np.abs(speed) > np.maximum(STILL, NOISES * spread)
        if (fast & (np.abs(excess) > 0.5 * np.abs(speed))).any():
            return True
        away, moved = np.abs(place), np.nanstd(error[inside], axis=0)
        if ((away > FAR) & (moved > np.maximum(0.2 * away, NOISES * noise))).any():
            return True
    return False


def _moving_parts(simulator: Simulator) -> list[tuple[list[int], str]]:
    """(columns of the comparison, signal) of joints and base."""
    found = []
    for signal in ("joint_pos", "base_pos"):
        columns = [i for i, c in enumerate(simulator.channels) if c.signal == signal]
        if columns:
            found.append((columns, signal))
    return found


def _motion_missed(simulator: Simulator, run: Run, predicted: F64) -> float:
    """Squared error of the first moments, its mean taken out (an offset is no motion), summed over joints and base."""
    inside = run.time <= BEGINNING
    total = 0.0
    for columns, signal in _moving_parts(simulator):
        error = run.signals[signal][inside] - predicted[inside][:, columns]
        if not np.isfinite(predicted[inside][:, columns]).all():
            return float("inf")
        error = error[:, np.isfinite(error).any(axis=0)]
        total += float(np.nanvar(error, axis=0).sum())
    return total


def _refined(simulator: Simulator, run: Run, start: Start, predicted: F64) -> Start:
    """The start moved by what the prediction from it misses in its first moments."""
    case = simulator.case
    assert start.qpos is not None
    assert start.qvel is not None
    qpos, qvel = start.qpos.copy(), start.qvel.copy()
    for columns, signal in _moving_parts(simulator):
        speeds = [i for i, c in enumerate(simulator.channels) if c.signal == "joint_vel"]
        error = run.signals[signal] - predicted[:, columns]
        if signal == "joint_pos":
            rate = run.signals["joint_vel"] - predicted[:, speeds] if speeds else None
            place, speed = first_fit(run.time, error, 2, rate)
            qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]] += place
            qvel[[case.model.joint(n).dofadr[0] for n in case.joint_names]] += speed
        else:
            free = int(np.flatnonzero(case.model.jnt_type == 0)[0])
            a, b = int(case.model.jnt_qposadr[free]), int(case.model.jnt_dofadr[free])
            place, speed = first_fit(run.time, error, 2)
            qpos[a : a + 3] += place
            qvel[b : b + 3] += speed
    return replace(start, qpos=qpos, qvel=qvel)


# ---------------------------------------------------------------- first samples


def first_fit(time: F64, values: F64, degree: int, rates: F64 | None = None) -> tuple[F64, F64]:
    """(value, slope) at time 0 of (T, K) samples by a polynomial over FIRST seconds; `rates` are its derivative's."""
    inside = _beginning(time)
    t = time[inside]
    powers = np.arange(degree + 1)
    rows = t[:, None] ** powers
    slopes = powers * t[:, None] ** np.maximum(powers - 1, 0)
    place, slope = np.zeros(values.shape[1]), np.zeros(values.shape[1])
    weight = _noise(values) + 1e-5
    slack = _noise(rates) + 1e-4 if rates is not None else None
    for k in range(values.shape[1]):
        good = np.isfinite(values[inside, k])
        A, b = [rows[good] / weight[k]], [values[inside, k][good] / weight[k]]
        if rates is not None and slack is not None:
            known = np.isfinite(rates[inside, k])
            A.append(slopes[known] / slack[k])
            b.append(rates[inside, k][known] / slack[k])
        if good.sum() > degree + 1:
            place[k], slope[k] = np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0][:2]
        elif good.any():
            place[k] = values[inside, k][good][0]
    return place, slope


def _beginning(time: F64) -> Any:
    return time <= max(FIRST, float(time[min(6, len(time) - 1)]))


def _speed_spread(time: F64) -> float:
    """Standard deviation of a first speed for readings of standard deviation 1, 1/s."""
    t = time[_beginning(time)]
    rows = t[:, None] ** np.arange(3)
    return float(np.sqrt(np.linalg.pinv(rows.T @ rows)[1, 1]))


def first_speed_spread(time: F64, values: F64) -> F64:
    """(K,) standard deviation of the first speed of (T, K) readings, from their noise."""
    return _speed_spread(time) * _noise(values)


def _noise(values: F64) -> F64:
    """(K,) standard deviation of a sample, from third differences."""
    return np.array([1.4826 * median_size(third_differences(column) / np.sqrt(20)) for column in values.T])
