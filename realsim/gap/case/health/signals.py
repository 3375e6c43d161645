"""Health of the arrays themselves: clock, drops, resolution, saturation, noise, and how the runs begin."""

from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.case.case import Case, Run
from realsim.gap.case.motion import differences, median_size, sample_noise
from realsim.gap.case.split import replicates, spread
from realsim.gap.inference.likelihood.comparison import DETAIL
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.start import NOISES, first_fit, first_speed_spread
from realsim.gap.simulation.state import AT_REST, Start, first_rows

Notes = list[str]
SLOWEST = 0.2
"""s between samples beyond which nothing of a servo's motion is left in a log."""
COARSE = 0.05
"""s between samples beyond which delays, servo gains and friction at reversals are guessed at: a servo of 5 Hz has
hardly four samples a period."""
SHORTEST = 0.4
"""s that all runs together must last."""
REST_OFF, REST_SPEED = 0.1, 0.1
"""Share of a joint's range of motion (or rad), and of its peak speed: what a start at rest may differ by."""
STARTED = {
    "rest": "from rest under the first command",
    "given": "from init_qpos and init_qvel",
    "log": "from the state of the first samples",
}
MOSTLY = 0.1
"""Share of samples at a limit from which a note is given."""

SPIKE, SPIKE_OF_RANGE = 10.0, 0.05
"""How far a single sample is off for a spike, as a multiple of the range of the four around it, and as a share of the
column's in all runs. Set on damaged files (benchmarks/robustness/fuzz.py, seed 0)."""

NOISY, STILLEST, MOST_STILL = 1.5, 1e-4, 6
"""Motion in units of a sample's noise, and in rad or m, below which a position does not move; notes of that at most.
Noise alone has 1."""

LITTLE, ARM = 0.02, 0.05
"""rad (root mean square) that the liveliest joint of a useful log exceeds, and m that a slide moves for 1 rad. Not
tuned."""
CHANGES = 0.7
"""Root mean square by which repetitions differ, as a share of their error against the simulator: with errors that have
nothing to do with each other it is 1."""


def clocks(case: Case) -> tuple[dict[str, Any], Notes]:
    """Sampling step and jitter, medians over runs. Refuses a log that is too coarse or too short."""
    notes, steps, jitters = [], [], []
    for run in case.runs:
        step = np.diff(run.time)
        median = float(np.median(step))
        gaps = step > 3 * median
        jitter = float(np.std(step[~gaps]))
        steps.append(median)
        jitters.append(jitter)
        if jitter < 1e-6 * median + 1e-7 * run.duration:  # the latter is what single precision rounds
            notes.append(f"{run.name}: perfectly even time stamps: they were generated, not measured")
        elif jitter > 0.3 * median:
            notes.append(
                f"{run.name}: the sampling step varies by {jitter / median:.0%}: check what stamps the samples"
            )
        if gaps.any():
            longest = f"the longest {step.max():.3g} s"
            notes.append(f"{run.name}: {int(gaps.sum())} late samples, {longest}: the last command holds until then")
        notes += _stale(run.name, run.signals["joint_pos"], run.command, case.joint_names)
    usual, length = float(np.median(steps)), float(sum(r.duration for r in case.runs))
    if usual > SLOWEST or length < SHORTEST:
        raise GapError(
            "samples are too far apart to show a servo's motion" if usual > SLOWEST else "the log is too short",
            file=case.folder,
            expected=f"a sample every {SLOWEST:g} s or more often, and {SHORTEST:g} s in all",
            found=f"a sample every {usual:.3g} s, {length:.3g} s in all",
            hint='is time in seconds? If not: "units": {"time": "ms"} in log.json',
        )
    if usual > COARSE:
        notes.append(f"a sample every {usual:.3g} s: what is faster (delay, servo gains, reversals) hardly shows")
    return {"median_step_s": usual, "jitter_s": float(np.median(jitters))}, notes


def _stale(name: str, values: F64, command: F64, joints: tuple[str, ...]) -> Notes:
    """Readings that repeat exactly while the command moves: the sensor is slower than the log."""
    moving = (np.abs(np.diff(command, axis=0)) > 1e-9).any(axis=1)
    same = (np.diff(values, axis=0) == 0)[moving]
    if len(same) < 50 or not joints:
        return []
    share = same.mean(axis=0)
    # A coarse encoder repeats at slow motion, joint by joint; a slow bus repeats all joints in the same samples.
    together = float(same.all(axis=1).mean())
    if together > 0.3 and len(np.unique(values[:, 0])) > 100:
        return [f"{name}: {together:.0%} of the readings repeat the one before: the bus is slower than the log"]
    stuck = [joint for joint, s in zip(joints, share, strict=True) if s > 0.98]
    return [f"{name}: the reading of {', '.join(stuck)} stands still while the command moves"] if stuck else []


def spikes(case: Case) -> Notes:
    """Single samples far from the two before and the two after, which agree: a bit that flipped, a reading of 0.

    Velocities and torques are not looked at: an impact looks like that.
    """
    notes = []
    arrays = {"command": (case.actuator_names, [r.command for r in case.runs])}
    arrays["joint_pos"] = (case.joint_names, [r.signals["joint_pos"] for r in case.runs])
    for array, (names, values) in arrays.items():
        for j, name in enumerate(names):
            columns = [v[:, j] for v in values]
            seen = np.concatenate(columns)
            least = SPIKE_OF_RANGE * float(np.ptp(seen[np.isfinite(seen)])) if np.isfinite(seen).any() else np.inf
            for run, column in zip(case.runs, columns, strict=True):
                if len(rows := _spikes(column, least)):
                    at, more = run.time[rows[0]], f" and {len(rows) - 1} more" if len(rows) > 1 else ""
                    notes.append(f"{run.name}: {array} of {name} at {at:.3f} s{more} is far from the samples around it")
    return notes


def _spikes(column: F64, least: float) -> Any:
    """Rows of a column (T,) that are off by more than `least`."""
    rows = np.flatnonzero(np.isfinite(column))
    x = column[rows]
    if len(x) < 5:
        return rows[:0]
    around = np.stack([x[:-4], x[1:-3], x[3:-1], x[4:]])
    off = np.abs(x[2:-2] - np.median(around, axis=0))
    return rows[2:-2][off > np.maximum(SPIKE * np.ptp(around, axis=0), least)]


def missing(case: Case) -> tuple[dict[str, float], Notes]:
    """Share of each signal that is not there. Refuses a log without most of its joint positions."""
    found = {k: float(np.mean([1 - np.isfinite(r.signals[k]).mean() for r in case.runs if k in r.signals]))
             for k, first in case.runs[0].signals.items() if first.size}  # fmt: skip
    found = {k: v for k, v in found.items() if v > 0}
    if found.get("joint_pos", 0) > 0.7:
        raise GapError(
            "most joint positions are missing", file=case.folder, expected="a position in at least 30 % of the rows",
            found=f"{found['joint_pos']:.0%} are missing",
            hint="record positions as often as commands, at 50 Hz or more; check that their columns are the right ones",
        )  # fmt: skip
    notes = [f"{share:.0%} of {name} is missing" for name, share in found.items() if share > 0.05]
    partly = sorted({k for r in case.runs for k in r.signals if not all(k in s.signals for s in case.runs)})
    return found, notes + [f"{name} is not in every run, so it is not compared" for name in partly]


def quanta(case: Case) -> dict[str, float]:
    """Smallest step between readings by signal, the median over its columns; 0 where none can be determined."""
    names = [k for k in case.runs[0].signals if k.startswith("joint") and case.has(k)]
    return {k: _quantum(np.concatenate([r.signals[k] for r in case.runs])) for k in names}


def _quantum(values: F64) -> float:
    steps = []
    for column in values.T:
        levels = np.unique(column[np.isfinite(column)])
        if len(levels) > 2:
            steps.append(float(np.quantile(np.diff(levels), 0.1)))
    return float(np.median(steps)) if steps else 0.0


def beyond_range(case: Case) -> Notes:
    """Actuators that are commanded beyond what the model lets them take, where the simulator cuts the command."""
    model, notes = case.model, []
    for u, name in enumerate(case.actuator_names):
        actuator = model.actuator(name)
        low, high = actuator.ctrlrange if actuator.ctrllimited[0] else (-np.inf, np.inf)
        command = np.concatenate([run.command[:, u] for run in case.runs])
        share = float(((command < low) | (command > high)).mean())
        if share > MOSTLY:
            notes.append(
                f"{name}: commanded beyond the model's range ({low:.3g} to {high:.3g}) in {share:.0%} of the samples, "
                f"up to {np.abs(command).max():.3g}: is it in the actuator's unit?"
            )
    return notes


def saturation(simulator: Simulator) -> tuple[dict[str, Any], Notes]:
    """Share of samples at a limit by joint: the nominal drive's force range, and a flat top of the logged torque."""
    case, context = simulator.case, simulator.context
    drive: dict[str, float] = {}
    logged: dict[str, float] = {}
    notes = []
    for j, joint in enumerate(case.joint_names):
        if joint in context.actuator and context.limited(joint):
            torque = np.concatenate([np.abs(t["torque"][:, j]) for t in simulator.nominal_tracks])
            drive[joint] = float((torque > 0.995 * context.torque_range[joint]).mean())
        if case.has("joint_torque"):
            torque = np.concatenate([np.abs(r.signals["joint_torque"][:, j]) for r in case.runs])
            torque = torque[np.isfinite(torque)]
            logged[joint] = float((torque > 0.995 * torque.max()).mean()) if torque.max(initial=0) > 0 else 0.0
            if logged[joint] > MOSTLY:
                notes.append(
                    f"{joint}: the logged torque stays at {torque.max():.3g} in {logged[joint]:.0%} of the samples"
                )
        notes += _end_stops(case, joint, j)
    full = [f"{joint} ({share:.0%})" for joint, share in drive.items() if share > MOSTLY]
    if full:
        notes.append(f"the nominal drive is at its force range for much of the time: {', '.join(full)}")
    keep = {"nominal_drive": drive, "logged_torque": logged}
    return {k: {n: v for n, v in d.items() if v > 0.001} for k, d in keep.items()}, notes


def _end_stops(case: Case, joint: str, column: int) -> Notes:
    part = case.model.joint(joint)
    if not part.limited[0]:
        return []
    low, high = part.range
    values = np.concatenate([r.signals["joint_pos"][:, column] for r in case.runs])
    beyond = float(np.nanmean((values < low - 0.02) | (values > high + 0.02)))
    return [f"{joint}: {beyond:.0%} of the positions lie beyond the range in model.xml"] if beyond > 0.01 else []


def noise(simulator: Simulator, nominal: list[F64]) -> tuple[dict[str, Any], Notes]:
    """By signal: noise of a sample from the log's high frequencies, and what runs that repeat a command differ by."""
    case, found = simulator.case, {}
    notes = _stillness(case)
    for signal in dict.fromkeys(c.signal for c in simulator.channels):
        if signal not in case.runs[0].signals:
            continue  # the base's orientation is compared as a rotation vector
        columns = [i for i, c in enumerate(simulator.channels) if c.signal == signal]
        kinks, errors = [], []
        for run, y in zip(case.runs, nominal, strict=True):
            r = run.signals[signal][:, [simulator.channels[i].index for i in columns]] - y[:, columns]
            kinks += [differences(column, 3) / np.sqrt(20) for column in r.T]
            errors.append(r)
        sample = 1.4826 * median_size(np.concatenate(kinks))
        found[signal] = {"sample": sample, "replicates": spread(case, signal)}
        for group in replicates(case):
            sizes = {i: float(np.sqrt(np.nanmean(errors[i] ** 2))) for i in group}
            apart = spread(case, signal, group) or 0.0
            least = max(CHANGES * float(np.mean(list(sizes.values()))), 4 * sample, 2 * _tolerated(case, signal))
            if apart > least:
                names = " and ".join(case.runs[i].name for i in group)
                notes.append(
                    f"{signal}: {names} have the same commands and differ by {apart:.3g}, as much as from the "
                    "simulator: the robot itself changes from run to run"
                )
    return found, notes


def _stillness(case: Case) -> Notes:
    """A note on what has more noise than motion; refuses a log in which nothing else moves."""
    still, moving, sizes = [], 0, [0.0]
    for signal, names in (("joint_pos", case.joint_names), ("base_pos", tuple("xyz") if case.floating else ())):
        for j, name in enumerate(names if case.has(signal) else ()):
            columns = [r.signals[signal][:, j] for r in case.runs]
            noise = sample_noise(case, j, signal)
            motion = float(np.sqrt(np.mean([np.nanvar(c) for c in columns])))
            moving += motion > max(NOISY * noise, STILLEST)
            sizes.append(motion / ARM if signal == "base_pos" or case.slides(name) else motion)
            if motion <= NOISY * noise:
                still.append(f"{signal} of {name}: {motion:.2g} rms of motion, {noise:.2g} of noise")
    if not moving:
        raise GapError(
            "the positions have more noise than motion" if still else "nothing in the log moves",
            file=case.folder,
            expected="motion that stands out of the sensors' noise",
            found="; ".join(still[:3]) or "positions that do not change",
            hint="do the drives give torque, are these the right columns, and are they in the unit that log.json says?",
        )
    notes = [f"more noise than motion: {text}" for text in still] if len(still) <= MOST_STILL else []
    if case.joint_names and max(sizes) < LITTLE:
        size = f"{max(sizes):.2g} rad rms at most, 1 m counted as {1 / ARM:g} rad"
        notes.append(
            f"the robot hardly moves ({size}): play and stiction are as large. Record motions of 0.1 rad or more"
        )
    return notes


def _tolerated(case: Case, signal: str) -> float:
    """Structure that is left in any good simulator of these runs, in the signal's unit."""
    absolute, relative = DETAIL[signal]
    return float(np.hypot(absolute, relative * np.nanstd(np.concatenate([r.signals[signal] for r in case.runs]))))


def initial_states(simulator: Simulator) -> tuple[dict[str, Any], Notes]:
    """How the runs begin: largest distance from the nominal simulator's rest, rad, and largest speed, rad/s.

    `runs` says of every run how it was started in the simulator, `parts` in how many those are replayed that are not
    replayed as a whole.
    """
    case = simulator.case
    notes, off, fast = [], [0.0], [0.0]
    how = {}
    for run, track, start, rest, y in zip(
        case.runs, simulator.nominal_tracks, simulator.starts, simulator.rests, simulator.simulate(), strict=True
    ):
        position = run.signals["joint_pos"]
        first = _first_position(position)
        travel = np.nanmax(position, axis=0) - np.nanmin(position, axis=0)
        distance, speed = np.abs(first - rest), _first_speed(run, y[:, : len(first)])
        rates = np.gradient(track["pos"], track["settle"][1], axis=0)
        peak = np.nanmax(np.abs(rates), axis=0)
        off.append(float(np.nanmax(distance, initial=0.0)))
        fast.append(float(np.nanmax(speed, initial=0.0)))
        how[run.name] = f"{STARTED[start.kind]}: {start.reason}"
        done = f"; it is simulated {STARTED[start.kind]}"
        notes += _given_state(case, run, start, first)
        if not case.joint_names:
            continue
        j = int(np.nanargmax(distance / (travel + REST_OFF)))
        if distance[j] > max(REST_OFF, 0.2 * travel[j]):
            notes.append(
                f"{run.name}: the initial state does not match: {case.joint_names[j]} begins at {first[j]:.3g}, the "
                f"nominal simulator rests at {rest[j]:.3g} under the first command{done}"
            )
        j = int(np.nanargmax(speed / (peak + 1e-6)))
        if speed[j] > max(REST_SPEED * peak[j], 0.15):
            notes.append(
                f"{run.name}: the run does not begin at rest: {case.joint_names[j]} moves at {speed[j]:.2g} rad/s{done}"
            )
        elif start.moving and not start.anchors and not run.goes_on:
            notes.append(f"{run.name}: the run does not begin at rest{done}")
    parts = [
        float(length)
        for run, start in zip(case.runs, simulator.starts, strict=True)
        if start.anchors
        for length in np.diff([0.0, *(a.time for a in start.anchors), run.duration])
    ]
    if parts:
        notes.append(
            f"a small error grows fast in replay: it goes on from states of the log, after {np.median(parts):.1f} s "
            f"(median of {len(parts)} parts), each begun where it fits best"
        )
    return {"farthest_from_rest": max(off), "fastest_at_start": max(fast), "runs": how, "parts": len(parts)}, notes


def _first_position(position: F64) -> F64:
    """(J,) median of the first five samples; of the first finite ones where an encoder comes up later."""
    if np.isfinite(position[:5]).any(axis=0).all():
        return np.asarray(np.nanmedian(position[:5], axis=0))
    return first_rows(position)


def _first_speed(run: Run, predicted: F64) -> F64:
    """(J,) speed at the first sample that the simulator's start (T, J) does not have; 0 where noise may be all of it.

    A joint that is set going at once moves as fast in the simulator, which begins at rest.
    """
    position = run.signals["joint_pos"]
    speed = np.abs(first_fit(run.time, position, 2)[1])
    excess = np.abs(first_fit(run.time, position - predicted, 2)[1])
    known = np.isfinite(position[:5]).any(axis=0)  # an encoder that comes up late says nothing of the first moment
    sure = excess > np.maximum(0.5 * speed, NOISES * first_speed_spread(run.time, position))
    return np.where(known & sure, speed, 0.0)


def _given_state(case: Case, run: Run, start: Start, first: F64) -> Notes:
    notes = []
    if run.init_qpos is not None:
        given = np.array([run.init_qpos[case.model.joint(n).qposadr[0]] for n in case.joint_names])
        far = np.abs(given - first)
        if far.max(initial=0.0) > REST_OFF:
            j = int(np.argmax(far))
            notes.append(
                f"{run.name}: init_qpos has {case.joint_names[j]} at {given[j]:.3g}, the log at {first[j]:.3g}"
            )
    if run.init_qvel is not None and np.abs(run.init_qvel).max(initial=0) > AT_REST and not start.moving:
        notes.append(f"{run.name}: init_qvel is not zero, but the log stands still: the run is simulated from rest")
    return notes
