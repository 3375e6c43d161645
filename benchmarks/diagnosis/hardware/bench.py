"""A real log on the bench: its model fitted on half of the runs, and what errors of the model do to the other half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.diagnosis.hardware.errors import Error, Label, Robot, errors
from realsim.core.errors import RealsimError
from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.case.motion import estimate
from realsim.gap.simulation.simulate import Simulator, measured
from tests.truths.written import write_case

FREE = {
    "position": (
        "stiffness_gain", "damping_gain", "coulomb_friction", "viscous_friction", "armature", "joint_offset",
    ),
    "torque": ("motor_gain", "coulomb_friction", "viscous_friction", "armature", "joint_offset", "com_offset"),
}  # fmt: skip
"""Kinds that a baseline is fitted with; what else is wrong stays in it, as in any real model."""
PRIOR = 0.002
"""Weight of a parameter's own size beside residuals in units of the motion: only enough to settle what the runs do not.
Ten times as much kept the rotor inertia of a quadruped's calf near zero and left twice the error on the other runs."""
EVALUATIONS = 40
"""Of the baseline's fit; most settle in 10 to 30."""
LATEST = 3
"""Samples by which a baseline's commands may be late."""
STRIDE = 0.01
"""Seconds between the residuals of the fit."""
SAME = 0.1
"""Share (rms) of an error's change of the motion that another error, with its best size, may leave and be as good."""

BEGINNING = 0.2
"""Seconds of a run in which its estimated start matters: another error would have given another one."""
PART = 0.5
"""Seconds for which a robot that only torques drive is replayed from a state of its log: a pendulum that nothing holds
up falls either way. The first value tried, on the development log."""
NUDGE = 1e-4
"""rad and rad/s by which the states that parts begin in are moved for their slopes."""
FROM_ZERO = 5.0
"""Added to all sizes in the fit, whose steps are a share of their value: one from next to no friction would be lost in
what keeps a robot from moving."""

Tracks = list[np.ndarray]


@dataclass(frozen=True)
class Baseline:
    """A model fitted on half of the runs."""

    sizes: dict[str, float]
    """kind@place -> size."""
    late: int
    """Samples by which the commands come late."""
    left: dict[str, dict[str, float]]
    """Signal -> rms of `motion`, and of what is left on the runs `fitted` and `unseen`, in the signal's unit."""


class Bench:
    """One log, split: every other window is for the baseline, beginning with the first of the first run."""

    def __init__(self, folder: Path) -> None:
        self.case = load_case(folder)
        order: dict[str, int] = {}
        number = [order.setdefault(r.name.rpartition("_")[0], len(order)) for r in self.case.runs]
        window = [sum(n == number[i] for n in number[:i]) for i in range(len(number))]
        even = [(n + w) % 2 == 0 for n, w in zip(number, window, strict=True)]
        self.fitted = self.case.with_runs(tuple(r for r, e in zip(self.case.runs, even, strict=True) if e))
        self.others = self.case.with_runs(tuple(r for r, e in zip(self.case.runs, even, strict=True) if not e))
        if min(len(self.fitted.runs), len(self.others.runs)) < 2:
            raise ValueError(f"{folder}: too few runs to fit on some and diagnose the others")

    def robot(self, case: Case) -> Robot:
        """Figures of the nominal simulation of a case."""
        with Simulator(case, settings()) as simulator:
            tracks = simulator.nominal_tracks
        model, names = case.model, list(case.joint_names)
        drive = {j: a for j in names if (a := case.actuator_of(j)) is not None}
        vel = np.nan_to_num(np.concatenate([t["vel"] for t in tracks]))
        torque = np.nan_to_num(np.concatenate([t["torque"] for t in tracks]))
        effort = dict(zip(names, np.percentile(np.abs(torque), 90, axis=0), strict=True))
        speed = dict(zip(names, np.percentile(np.abs(vel), 90, axis=0), strict=True))
        saturated = {}
        for joint, name in drive.items():
            actuator, column = model.actuator(name), np.abs(torque[:, names.index(joint)])
            top = float(np.abs(actuator.forcerange).max()) * abs(case.gear(joint)) if actuator.forcelimited[0] else 0.0
            saturated[joint] = float(np.mean(column > 0.99 * top)) if top else 0.0
        sample = float(np.median(np.diff(case.runs[0].time)))
        return Robot(model, case.command_kind, drive, effort, speed, saturated, sample)


def settings() -> DiagnoseConfig:
    return DiagnoseConfig(threads=1, report=False)


def with_error(case: Case, errors: Sequence[tuple[Error, float]]) -> Case:
    """The case with a wrong model, or wrong times of its commands. Raises ValueError where no such model exists."""
    spec, shift = case.spec.copy(), 0
    for error, size in errors:
        if error.shifts == "command":
            shift += round(size / float(np.median(np.diff(case.runs[0].time))))
        else:
            error.apply(spec, size)
    model = spec.compile()
    runs = tuple(_earlier(r, shift) for r in case.runs) if shift else case.runs
    return replace(case, spec=spec, model=model, runs=runs)


def _earlier(run: Any, samples: int) -> Any:
    """The same run whose commands are logged so many samples earlier: the robot does them late."""
    index = np.clip(np.arange(len(run.time)) + samples, 0, len(run.time) - 1)
    return replace(run, command=run.command[index], enabled=None if run.enabled is None else run.enabled[index])


def predict(case: Case, errors: Sequence[tuple[Error, float]] = ()) -> Tracks:
    """(T, C) a run: what the simulator of a case reads, with errors in its model."""
    changed = with_error(case, [e for e in errors if e[0].shifts != "reading"])
    with Simulator(changed, settings()) as simulator:
        tracks = simulator.simulate()
    for error, size in errors:
        if error.shifts == "reading":
            tracks = [_sooner(r.time, y, size) for r, y in zip(case.runs, tracks, strict=True)]
    return tracks


def _sooner(time: np.ndarray, values: np.ndarray, seconds: float) -> np.ndarray:
    """What a simulator reads that does not know that the robot's readings are late."""
    return np.column_stack([np.interp(time + seconds, time, column) for column in values.T])


def real(case: Case) -> tuple[Tracks, list[str]]:
    """((T, C) a run that was measured, signal of each column)."""
    with Simulator(case, settings()) as simulator:
        channels = simulator.channels
    return [measured(r, channels) for r in case.runs], [c.signal for c in channels]


# ---------------------------------------------------------------- in parts


def parted(case: Case) -> Case:
    """The case of a robot that only torques drive, in parts of PART seconds from states of the log; others whole."""
    if case.command_kind != "torque":
        return case
    parts = []
    for run in case.runs:
        motion = estimate(case, run)
        edges = np.linspace(0.0, run.duration + 1e-9, max(1, round(run.duration / PART)) + 1)
        for k, (begin, end) in enumerate(pairwise(edges)):
            part = run.where((run.time >= begin) & (run.time < end))
            at = int(np.argmin(np.abs(motion.time - part.time[0])))
            state = {"init_qpos": motion.qpos[at], "init_qvel": motion.qvel[at]}
            parts.append(replace(part, name=f"{run.name}_{k}", time=part.time - part.time[0], **state))
    return case.with_runs(tuple(parts))


@dataclass(frozen=True)
class Starts:
    """What the states that parts begin in, which are the log's and noisy, can explain is no error of a model."""

    slopes: Tracks
    """(T, C, K) a run: change of what is read by one unit of each coordinate of its first state; K is 0 if it rests."""
    scale: np.ndarray
    """(C,) by which errors of the signals are compared."""

    @staticmethod
    def of(case: Case, errors: Sequence[tuple[Error, float]], base: Tracks, scale: np.ndarray) -> Starts:
        columns: list[Tracks] = []
        for k in range(2 * case.model.nv if case.command_kind == "torque" else 0):
            moved = predict(case.with_runs(tuple(_nudged(r, k) for r in case.runs)), errors)
            columns.append([(a - b) / NUDGE for a, b in zip(moved, base, strict=True)])
        empty = [np.empty((*y.shape, 0)) for y in base]
        return Starts([np.stack(c, axis=2) for c in zip(*columns, strict=True)] if columns else empty, scale)

    def beside(self, tracks: Tracks) -> Tracks:
        """Errors or changes (T, C) a run, without what the first state explains."""
        return [self._without(y, s) for y, s in zip(tracks, self.slopes, strict=True)]

    def _without(self, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        known = np.isfinite(values) & np.isfinite(slopes).all(axis=2)
        if not slopes.shape[2] or not known.any():
            return values
        left = np.where(known, values, np.nan)
        columns = (slopes / self.scale[:, None])[known]
        left[known] -= slopes[known] @ np.linalg.lstsq(columns, (values / self.scale)[known], rcond=1e-8)[0]
        return left


def _nudged(run: Any, k: int) -> Any:
    """The run begun NUDGE aside in a position, or behind these in a speed."""
    state = np.concatenate([run.init_qpos, run.init_qvel])
    state[k] += NUDGE
    return replace(run, init_qpos=state[: len(run.init_qpos)], init_qvel=state[len(run.init_qpos) :])


# ---------------------------------------------------------------- baseline


def fit(bench: Bench) -> Baseline:
    """Bounded least squares over all runs, for every delay of 0 .. LATEST samples; the best of them."""
    case = parted(bench.fitted)
    known = errors(bench.robot(bench.fitted))
    free = [e for e in known if e.kind in FREE[case.command_kind]]
    delay = next(e for e in known if e.kind == "command_delay")
    sample = bench.robot(bench.fitted).sample
    log, _ = real(case)
    scale = _spread(log)
    step = max(1, round(STRIDE / sample))
    low = np.array([max(e.least, -2.0) for e in free])

    def residual(z: np.ndarray, late: int) -> np.ndarray:
        x = z - FROM_ZERO
        wrong = [(delay, late * sample), *zip(free, x.tolist(), strict=True)]
        try:
            tracks = predict(case, wrong)
            rest = Starts.of(case, wrong, tracks, scale).beside([a - b for a, b in zip(log, tracks, strict=True)])
        except (ValueError, RealsimError):  # no such body: as bad as a simulation that fails
            rest = [np.full_like(y, np.nan) for y in log]
        parts = []
        for a, error in zip(log, rest, strict=True):
            failed = np.where(np.isnan(a), 0.0, 3.0)  # of the simulation; a missing sample counts for nothing
            parts.append(np.where(np.isnan(error), failed, error / scale)[::step].ravel())
        rows = np.clip(np.concatenate(parts), -3, 3)
        return np.concatenate([rows / np.sqrt(len(rows)), PRIOR * x])

    x, best = np.clip(np.zeros(len(free)), low + 1e-3, None), None
    for late in range(LATEST + 1):
        bounds = (low + FROM_ZERO - 1e-9, np.full(len(free), 3.0 + FROM_ZERO))
        start = x + FROM_ZERO
        found = least_squares(residual, start, bounds=bounds, diff_step=2e-3, max_nfev=EVALUATIONS, args=(late,))
        x = np.clip(found.x - FROM_ZERO, low + 1e-6, 2.99)
        if best is not None and found.cost > 0.995 * best[0].cost:
            break
        best = (found, late)
    assert best is not None
    found, late = best
    sizes = {f"{e.kind}@{e.place}": float(v) for e, v in zip(free, found.x - FROM_ZERO, strict=True)}
    baseline = Baseline(sizes, late, {})
    return replace(baseline, left=_left(bench, baseline))


def applied(bench: Bench, case: Case, baseline: Baseline) -> Case:
    """A case (of the same robot) with the baseline's model and clock."""
    robot = bench.robot(bench.fitted)
    known = {f"{e.kind}@{e.place}": e for e in errors(robot)}
    late = (known["command_delay@"], -baseline.late * robot.sample)
    # The baseline's fit moved the commands earlier by `late`; a model has no delay, so the log's commands come late.
    return with_error(case, [(late[0], -late[1]), *((known[k], v) for k, v in baseline.sizes.items())])


def _left(bench: Bench, baseline: Baseline) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for name, case in (("fitted", bench.fitted), ("unseen", bench.others)):
        changed = parted(applied(bench, case, baseline))
        log, signals = real(changed)
        rest = _errors(changed, log)[0]
        for signal in dict.fromkeys(signals):
            columns = [i for i, s in enumerate(signals) if s == signal]
            row = found.setdefault(signal, {})
            row[name] = float(np.sqrt(np.nanmean(np.concatenate([r[:, columns] for r in rest]) ** 2)))
            row.setdefault("motion", float(np.sqrt(np.mean(_spread(log)[columns] ** 2))))
    return found


def _errors(case: Case, log: Tracks) -> tuple[Tracks, Tracks, Starts]:
    """(what a model leaves, what it predicts, beside what) of a log in parts."""
    base = predict(case)
    starts = Starts.of(case, (), base, _spread(log))
    return starts.beside([a - b for a, b in zip(log, base, strict=True)]), base, starts


def _spread(tracks: Tracks) -> np.ndarray:
    return np.maximum(np.nanstd(np.concatenate(tracks), axis=0), 1e-6)


# ---------------------------------------------------------------- errors and their likes


@dataclass(frozen=True)
class Drawn:
    """Errors that were put in, with what they do."""

    errors: tuple[tuple[Error, float], ...]
    labels: tuple[Label, ...]
    visibility: tuple[float, ...]
    """Of each: rms change over the rms that the baseline leaves, in the channel where it is largest."""
    equivalents: tuple[tuple[Label, ...], ...]
    """Of each: labels that change the motion alike."""


def draw(case: Case, robot: Robot, kinds: Sequence[str], rng: np.random.Generator) -> Drawn | None:
    """One error of each of these kinds at a random place; None where none is visible at any size tried."""
    known, whole, case = errors(robot), case, parted(case)
    rest, base, starts = _errors(case, real(case)[0])
    ruler = Ruler(case, base, starts, np.sqrt(np.nanmean(np.concatenate(rest) ** 2, axis=0)))
    chosen: list[tuple[Error, float]] = []
    seen, likes = [], []
    for kind in kinds:
        places = [e for e in known if e.kind == kind and e.drawn]
        rng.shuffle(places)  # type: ignore[arg-type]
        found = next((f for e in places if (f := _sized(ruler, e, rng)) is not None), None)
        if found is None:
            return None
        error, size, change, visibility = found
        chosen.append((error, size))
        seen.append(visibility)
        likes.append(tuple(_like(ruler, known, error, change)))
    try:
        if not _runs(predict(whole, chosen)):
            return None
    except ValueError:
        return None
    return Drawn(tuple(chosen), tuple(e.label(s) for e, s in chosen), tuple(seen), tuple(likes))


@dataclass(frozen=True)
class Ruler:
    """By how much errors change what is read."""

    case: Case
    base: Tracks
    starts: Starts
    left: np.ndarray
    """(C,) rms of what the baseline leaves."""

    def change(self, tracks: Tracks) -> np.ndarray:
        """(N, C) what differs, in units of what the baseline leaves; of whole runs without their BEGINNING."""
        rows = self.starts.beside([b - a for a, b in zip(self.base, tracks, strict=True)])
        skip = [0.0 if s.shape[2] else BEGINNING for s in self.starts.slopes]
        kept = [np.nan_to_num(d)[r.time > t] for r, d, t in zip(self.case.runs, rows, skip, strict=True)]
        return np.concatenate(kept) / self.left


def _sized(ruler: Ruler, error: Error, rng: np.random.Generator) -> tuple[Error, float, np.ndarray, float] | None:
    size = float(np.exp(rng.uniform(np.log(error.low), np.log(error.high))))
    sign = float(rng.choice([-1.0, 1.0])) if error.either else 1.0
    if error.shifts:
        size = max(round(size / error.low), 1) * error.low  # whole samples
    for factor in (1.0, 1.6, 2.5):
        for way in (sign, -sign) if error.either else (sign,):
            amount = way * size * (factor if not error.shifts else round(factor + 0.3))
            if amount <= error.least:
                continue
            try:
                tracks = predict(ruler.case, [(error, amount)])
            except (ValueError, RealsimError):  # no such body: another size or sign
                continue
            if not _runs(tracks):
                continue
            change = ruler.change(tracks)
            visibility = float(np.sqrt((change**2).mean(axis=0)).max())
            if visibility >= 1.0:
                return error, amount, change, visibility
    return None


def _like(ruler: Ruler, known: Sequence[Error], error: Error, change: np.ndarray) -> list[Label]:
    """Labels of other errors that change the motion as this one does, but for a share SAME of it."""
    found = []
    for other in known:
        if other is error:
            continue
        size = 0.3 * other.low
        best = np.inf
        for _ in range(4):
            size = float(np.clip(size, max(other.least, -3.0), 3.0)) if not other.shifts else max(size, 1e-4)
            try:
                own = ruler.change(predict(ruler.case, [(other, size)]))
            except (ValueError, RealsimError):  # no such body
                break
            power = float((own * own).sum())
            if power < 1e-12:
                break
            miss = float(np.sqrt(((change - own) ** 2).sum() / (change**2).sum()))
            if miss < best:
                best, at = miss, size
            step = float((own * change).sum()) / power
            if not np.isfinite(step) or abs(step - 1) < 0.02:
                break
            size *= float(np.clip(step, -4, 4))
        if best < SAME:
            found.append(other.label(at))
    return found


def _runs(tracks: Tracks) -> bool:
    return all(np.isfinite(t).all() for t in tracks)


def write(case: Case, folder: Path) -> None:
    """The case as a folder of the contract."""
    runs = {}
    for run in case.runs:
        given = {k: v for k in ("init_qpos", "init_qvel", "enabled") if (v := getattr(run, k)) is not None}
        runs[run.name] = {"time": run.time, "command": run.command, **run.signals, **given}
    names = ("joint_names", "actuator_names", "command_kind", "base", "torque_kind", "imu_site", "contact_bodies")
    write_case(folder, case.spec.to_xml(), runs, **{n: getattr(case, n) for n in names})
