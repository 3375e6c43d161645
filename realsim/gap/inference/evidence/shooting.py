"""Multiple shooting: many short simulations, each from a state estimated from the log, compared at several horizons.

How the error grows with the horizon is a signature. An error that is there at once lies in the sensors; one that grows
in proportion to time is a delay or a wrong velocity; one that grows with its square is a missing force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.case import Run
from realsim.gap.case.model.edit import Edit
from realsim.gap.case.motion import Motion, estimate
from realsim.gap.simulation.control import controls, switched_off, tracks_of
from realsim.gap.simulation.simulate import Setting, Simulator, rotation_from, sample
from realsim.gap.simulation.state import Start, initial_state

HORIZONS = (0.02, 0.1, 0.5)
"""Seconds, beside one sample and the whole run."""
STRIDE = 0.25
"""Seconds between the starts of windows."""
MOST_WINDOWS = 200
"""Spread over all runs; half as many on robots of more than twelve joints."""


@dataclass(frozen=True)
class Shots:
    """Errors of predictions from estimated states, in the units of the signals."""

    labels: tuple[str, ...]
    """(H,) horizons in words: `one sample`, `20 ms`, ..."""
    seconds: F64
    """(H,)"""
    names: tuple[tuple[str, str], ...]
    """(K,) (signal, joint or axis)."""
    errors: F64
    """(W, H, K) measured minus predicted; NaN where a window does not reach, or the simulation failed."""

    def rms(self, signal: str) -> F64:
        """(H,) root mean square over windows and the columns of a signal."""
        columns = [i for i, (s, _) in enumerate(self.names) if s == signal]
        squares = np.where(np.isfinite(self.errors[:, :, columns]), self.errors[:, :, columns], np.nan) ** 2
        count = np.isfinite(squares).sum(axis=(0, 2))
        return np.sqrt(np.nansum(squares, axis=(0, 2)) / np.maximum(count, 1)) + np.where(count, 0.0, np.nan)

    def signals(self) -> list[str]:
        return list(dict.fromkeys(s for s, _ in self.names))

    def growth(self) -> dict[str, dict[str, float | None]]:
        """By signal and horizon: root mean square error; None where no window reaches."""
        return {
            signal: {
                n: float(v) if np.isfinite(v) else None for n, v in zip(self.labels, self.rms(signal), strict=True)
            }
            for signal in self.signals()
        }


def shoot(
    simulator: Simulator,
    settings: Sequence[Setting] = (),
    runs: Sequence[int] | None = None,
    onsets: Mapping[str, float] | None = None,
) -> Shots:
    """Predict from estimated states with the nominal simulator, or with one that `settings` change.

    Args:
        runs: indices into the case's runs, all if None.
        onsets: see `Simulator.edited`.
    """
    case = simulator.case
    chosen = list(range(len(case.runs))) if runs is None else list(runs)
    edit = simulator.edited(settings, onsets)
    models = {setup: edit.compiled(setup) for setup in {case.runs[i].setup for i in chosen}}
    model = models[case.runs[chosen[0]].setup]
    dt = float(model.opt.timestep)
    step = float(np.median([np.median(np.diff(case.runs[i].time)) for i in chosen]))
    seconds = np.array([step, *(h for h in HORIZONS if h > 1.2 * step)])
    labels = ("one sample", *(f"{1000 * h:g} ms" for h in seconds[1:]))
    count = int(np.ceil(seconds[-1] / dt)) + 2
    late = edit.signals.observation_delay
    windows = _windows(simulator, chosen, float(seconds[-1]))
    states, inputs, offs, seen = [], [], [], []
    for i, motion, starts in windows:
        run = case.runs[i]
        model = models[run.setup]
        reach = int(np.ceil((run.duration + seconds[-1]) / dt)) + count
        commands = controls(simulator.context, model, run, edit, reach, 0)
        off = switched_off(case, model, run, edit, reach, 0)
        for n in starts:
            first = max(round((float(motion.time[n]) - late) / dt), 0)
            here = Start("log", motion.qpos[n], motion.qvel[n])
            states.append(initial_state(case, model, run, edit, here))
            inputs.append(commands[first : first + count])
            offs.append(None if off is None else off[first : first + count])
            seen.append((run, motion, n))
    if not states:
        return Shots(labels, seconds, (), np.zeros((0, len(seconds), 0)))
    sensors: list[F64] = [np.zeros(0)] * len(states)
    for setup, model in models.items():
        of = [k for k, (run, _, _) in enumerate(seen) if run.setup == setup]
        rolled = simulator.rolled(model, [states[k] for k in of], [inputs[k] for k in of], edit, [offs[k] for k in of])
        for k, rows_of in zip(of, rolled, strict=True):
            sensors[k] = rows_of
    names, rows = _names(simulator), []
    for s, (run, motion, n) in zip(sensors, seen, strict=True):
        track = tracks_of(simulator.context, models[run.setup], s, 0, edit)
        rows.append(_errors(simulator, run, motion, n, track, seconds, dt, edit))
    return Shots(labels, seconds, tuple(names), np.stack(rows))


def _windows(simulator: Simulator, chosen: list[int], longest: float) -> list[tuple[int, Motion, list[int]]]:
    """(run, its motion, starts as indices into the motion), evenly thinned to the budget."""
    case = simulator.case
    most = MOST_WINDOWS if len(case.joint_names) <= 12 else MOST_WINDOWS // 2
    total = sum(case.runs[i].duration for i in chosen)
    stride = max(STRIDE, total / most)
    found = []
    for i in chosen:
        motion = estimate(case, case.runs[i])
        times = np.arange(0.05, motion.time[-1] - 0.5 * longest, stride)
        starts = np.searchsorted(motion.time, times)
        found.append((i, motion, [int(n) for n in starts if n < len(motion.time) and motion.good[n]]))
    return found


def _names(simulator: Simulator) -> list[tuple[str, str]]:
    names = [("joint_pos", j) for j in simulator.case.joint_names]
    signals = {c.signal for c in simulator.channels}
    return names + [(s, a) for s in ("base_pos", "base_rot") if s in signals for a in "xyz"]


def _errors(
    simulator: Simulator, run: Run, motion: Motion, n: int, track: dict[str, F64], seconds: F64, dt: float, edit: Edit
) -> F64:
    """(H, K) of one window."""
    s = edit.signals
    at = motion.time[n] + seconds
    shift = np.array([s.joint_offset.get(j, 0.0) + s.reading_offset.get(j, 0.0) for j in simulator.case.joint_names])
    parts = [_logged(run, "joint_pos", at) - sample(track["pos"], seconds / dt) - shift]
    signals = {c.signal for c in simulator.channels}
    if "base_pos" in signals:
        parts.append(_logged(run, "base_pos", at) - sample(track["base_pos"], seconds / dt))
    if "base_rot" in signals:
        # Both as turns from the state that the window begins at.
        adr = int(simulator.case.model.jnt_qposadr[np.flatnonzero(simulator.case.model.jnt_type == 0)[0]])
        start = motion.qpos[n, adr + 3 : adr + 7]
        real = rotation_from(_logged(run, "base_quat", at), start)
        parts.append(real - rotation_from(sample(track["base_quat"], seconds / dt), start))
    error = np.concatenate(parts, axis=1)
    error[at > run.time[-1]] = np.nan
    return error


def _logged(run: Run, signal: str, at: F64) -> F64:
    """(H, K) of the log at these times, between finite samples; NaN in longer holes."""
    columns = []
    for column in run.signals[signal].T:
        finite = np.isfinite(column)
        time = run.time[finite]
        value = np.interp(at, time, column[finite]) if finite.any() else np.full(len(at), np.nan)
        hole = np.abs(time[np.searchsorted(time, at).clip(0, len(time) - 1)] - at) > 0.05 if finite.any() else True
        columns.append(np.where(hole, np.nan, value))
    return np.stack(columns, axis=1) if columns else np.zeros((len(at), 0))
