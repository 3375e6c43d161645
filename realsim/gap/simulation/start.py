"""Start of a run in the simulator: at rest under its first command, or in the state that the log shows.

A start is a measurement. The first command is held only where the log stands still under it: sensors and drives make a
robot at rest look out of place (an encoder with an offset, play, a load that the model does not know), and a changed
model is to find its own rest. Where the log moves at its first sample, or leaves its first posture under a command that
stands, the state is that of `init_qpos` and `init_qvel`, or the one fitted to the first samples. Where commands change
at once, so that the log alone does not tell, the nominal simulator tries both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case, Run
from realsim.gap.case.motion import differences, estimate, median_size
from realsim.gap.simulation.state import AT_REST, Start

if TYPE_CHECKING:
    from realsim.gap.simulation.simulate import Simulator

FAR = 0.03
"""rad or m: a posture farther than this from the nominal simulator's rest may be one that the robot was let go from."""
NOISES = 5.0
"""Standard deviations of its estimate that a first speed must exceed."""
BEGINNING = 0.3
"""s in which a state that is out of equilibrium shows."""
FIRST = 0.08
"""s that a first state is estimated from."""
AT_FIRST = 0.018
"""s (or one sample) in which a log that stands still at first does not move: below a servo's response, which is often
a sample or two late. Not tuned."""
DECISIVE = 0.35
"""A start in motion must leave at most this share of the squared error that a start at rest leaves."""
LEAST_MOTION = 2e-3
"""rad or m (root mean square) that a start from rest must miss of the first moments."""
STANDS = 0.01
"""Share of its range in the run by which a command may change and still stand. Not tuned."""
GROSS = 0.25
"""Share of a joint's travel in the log: no offset, load or weak servo makes a robot at rest look so far out of place
without a command that stands for long. Not tuned."""
STEADY = 0.5
"""Share of the mean speed of the first moments that a first speed must have: a robot that is set going at once has
next to none, one that was moving about as much. Not tuned."""


# ---------------------------------------------------------------- which runs


def find_starts(simulator: Simulator, resting: Sequence[F64]) -> tuple[Start, ...]:
    """How every run begins. `resting`: (T, C) a run, what the nominal simulator reads after a start at rest."""
    case = simulator.case
    starts = [Start() for _ in case.runs]
    trials: dict[int, Start] = {}
    sure = {i for i, run in enumerate(case.runs) if _moves(simulator, run, resting[i])}
    for i, run in enumerate(case.runs):
        moved = run.goes_on and (not case.floating or "base_pos" in run.signals)
        if moved or _says_that_it_moves(run) or i in sure or _suspicious(simulator, run, resting[i]):
            given = _says_that_it_moves(run) or run.init_qpos is not None
            trials[i] = _given(case, run) if given else _from_log(case, run)
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
        says = _says_that_it_moves(case.runs[i])
        if i in sure:
            believed = True
        elif case.runs[i].goes_on:  # it may move or not: what is nearer
            believed = after < before
        elif says:
            believed = after < max(4 * before, LEAST_MOTION**2)
        else:
            believed = after < DECISIVE * before and before > LEAST_MOTION**2
        if believed:
            starts[i] = start
        elif says:
            starts[i] = Start(reason="the log stands still where init_qvel says that it moves")
    return tuple(starts)


def _says_that_it_moves(run: Run) -> bool:
    return run.init_qvel is not None and bool(np.abs(run.init_qvel).max(initial=0.0) > AT_REST)


def _moves(simulator: Simulator, run: Run, resting: F64) -> bool:
    """Whether the log alone shows that it does not begin at rest under its first command: it moves at its first sample,
    or leaves its first posture while that command stands, or is nowhere near where a command that soon changes would
    have led. A torque, held, leads anywhere: there it is enough that the simulator does not rest where the log begins.
    """
    case = simulator.case
    if case.floating and "base_pos" not in run.signals and run.init_qpos is None:
        return False  # nobody knows where the base is
    if simulator.context.touches:
        return False  # feet take up their load first: a logged height is not that of the model's contacts
    change = np.abs(run.command - run.command[0]) > STANDS * np.ptp(run.command, axis=0)
    changed = change.any(axis=1)
    until = min(float(run.time[np.argmax(changed)]) if changed.any() else np.inf, BEGINNING)
    stands, beginning = run.time <= until, _beginning(run.time)
    for columns, signal in _moving_parts(simulator):
        values = run.signals[signal]
        error = values - resting[:, columns]
        if not np.isfinite(values[beginning]).any(axis=0).all() or not np.isfinite(error[beginning]).any():
            continue
        rates = run.signals.get("joint_vel") if signal == "joint_pos" and not simulator.velocity_lag else None
        noise = _noise(values)
        place, speed = first_fit(run.time, values, 2, rates)
        off, excess = first_fit(run.time, error, 2)
        way = first_fit(run.time, values, 1)[1]
        sigma = _speed_spread(run.time) * noise
        fast = np.abs(speed) > np.maximum(AT_REST, NOISES * sigma)
        fast &= (speed * way > 0) & (np.abs(speed) > STEADY * np.abs(way)) & (np.abs(excess) > STEADY * np.abs(speed))
        away = np.abs(off)
        moved = np.nanmax(np.abs(values[stands] - place), axis=0, initial=0.0)
        moved_off = moved > np.maximum(np.minimum(0.2 * away, FAR), NOISES * noise)
        nowhere_near = (away > GROSS * _travel(case, signal)) & (until < BEGINNING)
        left = (away > FAR) & (moved_off | nowhere_near | (case.command_kind == "torque"))
        if (fast | left).any():
            return True
    return False


def _travel(case: Case, signal: str) -> F64:
    """(K,) range of a signal in all runs."""
    values = np.concatenate([run.signals[signal] for run in case.runs])
    return np.asarray(np.nanmax(values, axis=0) - np.nanmin(values, axis=0))


def _trial(simulator: Simulator, trials: dict[int, Start]) -> dict[int, F64]:
    """(T, C) a run; only the first BEGINNING seconds mean anything."""
    chosen = list(trials)
    edit = simulator.edited(())
    raw = simulator.roll_out(edit, chosen, starts=[trials[i] for i in chosen], seconds=BEGINNING)
    return {i: simulator.read(simulator.case.runs[i], r, edit) for i, r in zip(chosen, raw, strict=True)}


def _given(case: Case, run: Run) -> Start:
    """The state that the log gives; of its first samples what it does not give."""
    guess, reason = _from_log(case, run), "the log does not stand still under its first command"
    assert guess.qpos is not None
    if _says_that_it_moves(run):
        reason = "init_qvel says that it moves"
    qvel = guess.qvel if run.init_qvel is None else run.init_qvel
    if run.init_qpos is None:
        return replace(guess, kind="given", qvel=qvel, reason=reason)
    reading = run.signals["joint_pos"][0]
    if not np.isfinite(reading).all():
        reading = guess.qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]]
    given = run.init_qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]]
    return Start("given", run.init_qpos, qvel, _agree(run, reading, given), reason)


def _from_log(case: Case, run: Run) -> Start:
    """The state of the first samples; of parts that are not logged, the given one."""
    motion = estimate(case, run)
    qpos, qvel = motion.qpos[0].copy(), motion.qvel[0].copy()
    return Start("log", qpos, qvel, reason="its first samples move as from a state of their own")


def _agree(run: Run, reading: F64, given: F64) -> bool:
    """Whether a given posture is what the encoders read, and so has their errors."""
    noise = _noise(run.signals["joint_pos"])
    return bool((np.abs(reading - given) < 3e-3 + NOISES * noise.max(initial=0.0)).all())


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
        fast = np.abs(speed) > np.maximum(AT_REST, NOISES * spread)
        if (fast & (np.abs(excess) > 0.5 * np.abs(speed))).any():
            return True
        away, moved = np.abs(place), np.nanstd(error[inside], axis=0)
        if ((away > FAR) & (moved > np.maximum(np.minimum(0.2 * away, FAR), NOISES * noise))).any():
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
    """The start moved by what the prediction from it misses in its first moments; no speed where the log stands."""
    case = simulator.case
    assert start.qpos is not None
    assert start.qvel is not None
    qpos, qvel = start.qpos.copy(), start.qvel.copy()
    for columns, signal in _moving_parts(simulator):
        speeds = [i for i, c in enumerate(simulator.channels) if c.signal == "joint_vel"]
        error = run.signals[signal] - predicted[:, columns]
        if signal == "joint_pos":
            timely = speeds and not simulator.velocity_lag
            rate = run.signals["joint_vel"] - predicted[:, speeds] if timely else None
            place, speed = first_fit(run.time, error, 2, rate)
            qpos[[case.model.joint(n).qposadr[0] for n in case.joint_names]] += place
            dofs = [case.model.joint(n).dofadr[0] for n in case.joint_names]
            qvel[dofs] = np.where(_still(run.time, run.signals[signal]), 0.0, qvel[dofs] + speed)
        else:
            free = int(np.flatnonzero(case.model.jnt_type == 0)[0])
            a, b = int(case.model.jnt_qposadr[free]), int(case.model.jnt_dofadr[free])
            place, speed = first_fit(run.time, error, 2)
            qpos[a : a + 3] += place
            qvel[b : b + 3] = np.where(_still(run.time, run.signals[signal]), 0.0, qvel[b : b + 3] + speed)
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


def _still(time: F64, values: F64) -> Bool:
    """(K,) whether (T, K) readings stand still at first: a late response must not become a first speed."""
    k = min(max(int(np.searchsorted(time, AT_FIRST)), 1), len(time) - 1)
    least = np.maximum(NOISES * np.sqrt(2) * _noise(values), AT_REST * time[k])
    return np.abs(values[k] - values[0]) < least


def _beginning(time: F64) -> Bool:
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
    return np.array([1.4826 * median_size(differences(column, 3) / np.sqrt(20)) for column in values.T])
