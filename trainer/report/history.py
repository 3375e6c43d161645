"""The folder of a training run as columns of numbers: `history.jsonl`, and what lies beside it.

A line of the history is a JSON object: a row an iteration, or an evaluation on the way (with `success`). Which figures
a row has is the trainer's business: all numbers are kept under their names, the rest is passed over.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import check_size, read_json
from realsim.core.types import F64
from trainer.errors import TrainerError
from trainer.report.evaluations import Evaluated, read_evaluations

AXES = ("iterations", "samples", "minutes")
"""What curves can be drawn over."""
MAX_BYTES = 2**30
"""Of a history; 100,000 iterations have about a quarter of it."""
MAX_NAMES = 2000
"""Of figures in a history; the built-in trainer has about a hundred."""
LARGEST = 1e30
"""Of a figure; more is as good as infinite, and not drawn."""
LAST = 20
"""Iterations whose mean is the figure of a table. A single one is too noisy: with 4096 worlds some 400 episodes end."""


@dataclass(frozen=True)
class Run:
    """A training run; M iterations were logged."""

    name: str
    folder: Path
    over: Mapping[str, F64]
    """Axis -> (M,) iterations, samples or minutes done after each row; without an axis that is not known."""
    columns: Mapping[str, F64]
    """Name of a figure -> (M,) values, NaN where it was not logged or is not a number."""
    on_the_way: F64
    """(E, 2) evaluations while training: iterations done before it, success rate."""
    evaluations: tuple[Evaluated, ...] = ()
    target: float | None = None
    """Success rate that was aimed at."""
    robot: str = ""
    notes: tuple[str, ...] = ()
    """What could not be read, and what to know about the figures."""
    derived: Mapping[str, F64] = field(default_factory=dict)
    """As `columns`: what is computed from them."""

    def column(self, name: str) -> F64 | None:
        """(M,) values of a figure; None if no iteration has it."""
        values = self.derived.get(name, self.columns.get(name))
        return None if values is None or not np.isfinite(values).any() else values

    def weights(self, name: str) -> F64:
        """(M,) what each iteration counts in a mean: as many episodes as ended, if the figure is about these."""
        parts = name.split("/")
        counts = None
        if name.startswith("env/family/") and parts[-1] not in ("row", "episodes"):
            counts = self.columns.get("/".join([*parts[:3], "episodes"]))
        elif name.startswith("env/end/") or name in _OF_EPISODES:
            counts = self.columns.get("episodes")
        return np.ones(len(self)) if counts is None else np.nan_to_num(counts)

    def mean(self, name: str, end: int | None = None) -> float:
        """Mean of a figure over the last iterations before row `end`; NaN if none of them has it."""
        values = self.column(name)
        if values is None:
            return math.nan
        stop = len(self) if end is None else end
        part = slice(max(0, stop - LAST), stop)
        return weighted_mean(values[part], self.weights(name)[part])

    def evaluated_over(self, axis: str) -> F64:
        """(E,) the evaluations on the way on an axis."""
        x = np.concatenate([[0.0], self.over[axis]])
        return np.interp(self.on_the_way[:, 0], np.concatenate([[0.0], self.over["iterations"]]), x)

    def __len__(self) -> int:
        return len(self.over["iterations"])


_OF_EPISODES = ("env/success", "env/episode/covered", "env/episode/seconds", "return", "length")


def weighted_mean(values: F64, weights: F64) -> float:
    """Mean of what is finite; NaN where nothing counts."""
    counted = np.isfinite(values) & (weights > 0)
    return float(np.average(values[counted], weights=weights[counted])) if counted.any() else math.nan


def read_runs(folders: Sequence[Path]) -> list[Run]:
    """The runs, each under the shortest name that tells them apart.

    Raises:
        RealsimError: a folder without a history, or a history without a single readable iteration.
    """
    return [read_run(folder, name) for folder, name in zip(folders, _names(folders), strict=True)]


def read_run(folder: Path, name: str) -> Run:
    """One run; see `read_runs`."""
    rows = _read_rows(_history_of(folder))
    notes = list(rows.notes)
    done = np.asarray(rows.iterations) + 1.0
    columns = {key: np.asarray(values) for key, values in rows.columns.items()}
    if done[0] > 1:
        notes.append(f"the history begins at iteration {done[0]:.0f}: its minutes count from there")
    over = {"iterations": done}
    samples = columns.get("samples", np.zeros(1))
    if np.isfinite(samples).all() and samples[0] > 0 and (np.diff(samples) >= 0).all():
        over["samples"] = samples
    else:
        notes.append("no samples were logged: it cannot be drawn over samples")
    minutes = _minutes(columns)
    if minutes is not None:
        over["minutes"] = minutes
    else:
        notes.append("no seconds were logged: it cannot be drawn over minutes")
    result, remarks = _result(folder)
    evaluations, unread = read_evaluations(folder, result)
    found = _part(result, "result")
    target: Any = result.get("target")
    run = Run(
        name=name,
        folder=folder,
        over=over,
        columns=columns,
        on_the_way=np.asarray(rows.on_the_way, float).reshape(-1, 2),
        evaluations=evaluations,
        target=float(target) if _is_number(target) and 0 < target <= 1 else None,
        robot=str(found.get("robot", ""))[:60],
        notes=(*notes, *remarks, *unread, *map(str, _part(found, "warnings", list))),
    )
    return replace(run, derived=_derived(run))


@dataclass
class _Rows:
    """What a history holds, while it is read."""

    iterations: array[float] = field(default_factory=lambda: array("d"))
    columns: dict[str, array[float]] = field(default_factory=dict)
    on_the_way: list[tuple[float, float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def training(self, iteration: float, row: Mapping[str, Any]) -> None:
        """A row of an iteration. One that happens again (after a resume) takes the place of the first."""
        if len(self.iterations) and self.iterations[-1] >= iteration:
            last = f"{self.iterations[-1] + 1:.0f}"
            self.notes.append(
                f"history.jsonl goes back from iteration {last} to {iteration + 1:.0f}: what follows counts"
            )
        while len(self.iterations) and self.iterations[-1] >= iteration:
            self.iterations.pop()
            for values in self.columns.values():
                values.pop()
            self.on_the_way = [e for e in self.on_the_way if e[0] <= iteration]
        before = len(self.iterations)
        self.iterations.append(iteration)
        for name, value in row.items():
            if name != "iteration" and (_is_number(value) or value is None):
                if name not in self.columns:
                    self.columns[name] = array("d", [math.nan]) * before
                usable = value is not None and abs(value) < LARGEST
                self.columns[name].append(float(value) if usable else math.nan)
        for values in self.columns.values():
            if len(values) == before:
                values.append(math.nan)

    def evaluation(self, iteration: float, success: Any) -> None:
        """A row of an evaluation: its number is that of the iteration before it, or 0 before the first."""
        if _is_number(success) and 0 <= success <= 1:
            self.on_the_way.append((iteration + 1 if len(self.iterations) else 0.0, float(success)))


def _read_rows(path: Path) -> _Rows:
    rows, unreadable, number = _Rows(), [], 0
    check_size(path, MAX_BYTES)
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                row = _row(line)
                if row is None:
                    unreadable.append(number)
                elif "success" in row:
                    rows.evaluation(float(row["iteration"]), row["success"])
                else:
                    rows.training(float(row["iteration"]), row)
                if len(rows.columns) > MAX_NAMES:
                    found = f"more than {MAX_NAMES} different figures"
                    raise TrainerError("not a training history", file=path, found=found)
    except OSError as error:
        raise TrainerError("the file cannot be read", file=path, found=error.strerror or str(error)) from error
    if not len(rows.iterations):
        raise TrainerError(
            "the history holds no iteration",
            file=path,
            expected="one JSON object per line, with the iteration's number and its figures",
            found=f"{number} lines, {len(unreadable)} of them unreadable" if number else "an empty file",
            hint="let the run finish its first iteration",
        )
    if unreadable:
        which = ", ".join(map(str, unreadable[:5])) + (", ..." if len(unreadable) > 5 else "")
        rows.notes.append(f"history.jsonl: {len(unreadable)} of {number} lines could not be read (line {which})")
    return rows


def _row(line: bytes) -> dict[str, Any] | None:
    """A line's object if it is a row; None for one that is cut off, or something else."""
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict):
        return None
    iteration: Any = row.get("iteration")
    return row if _is_number(iteration) and 0 <= iteration < LARGEST else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _history_of(folder: Path) -> Path:
    path = folder / "history.jsonl"
    if path.is_file():
        return path
    if not folder.exists():
        found = "there is no such folder"
    elif not folder.is_dir():
        found = "a file"
    else:
        inner = sorted(p.parent.name for p in folder.glob("*/history.jsonl"))
        found = f"no history.jsonl in it{', but in ' + ', '.join(inner[:5]) if inner else ''}"
    raise TrainerError(
        "not the folder of a training run",
        file=folder,
        expected="a folder that `realsim pretrain` or `realsim finetune` wrote, with history.jsonl",
        found=found,
        hint="name the folder that --out named there",
    )


def _names(folders: Sequence[Path]) -> list[str]:
    """The last parts of the paths, as many as it takes to tell them apart."""
    parts = [folder.resolve().parts for folder in folders]
    for count in range(1, max(map(len, parts), default=1) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    raise TrainerError("a run was named twice", found=", ".join(map(str, folders)))


def _minutes(columns: Mapping[str, F64]) -> F64 | None:
    """(M,) minutes so far of collecting and improving; what evaluations took is not logged."""
    parts = [columns[name] for name in ("collect_s", "update_s") if name in columns]
    minutes = np.cumsum(np.maximum(np.nan_to_num(np.sum(parts, axis=0)), 0.0)) / 60 if parts else np.zeros(1)
    return minutes if minutes[-1] > 0 else None


def _derived(run: Run) -> dict[str, F64]:
    """Counts an iteration of what the history counts from the start, and the speed."""
    derived = {}
    for name in ("env/physics/overflowed", "env/physics/solver_limited"):
        if (values := run.column(name)) is not None:
            derived[f"{name} an iteration"] = increments(values)
    if "samples" in run.over and "minutes" in run.over:
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = increments(run.over["samples"]) / (60 * increments(run.over["minutes"]))
        derived["samples a second"] = np.where(np.isfinite(speed), speed, np.nan)
    return derived


def increments(counts: F64) -> F64:
    """(M,) what each row adds to a count. A count that falls has begun anew at 0 (a resumed run)."""
    known = np.isfinite(counts)
    steps = np.full(len(counts), np.nan)
    added = np.diff(counts[known], prepend=0.0)
    steps[known] = np.where(added < 0, counts[known], added)
    return steps


def _result(folder: Path) -> tuple[dict[str, Any], list[str]]:
    """result.json, which a run has when it is finished."""
    path = folder / "result.json"
    if not path.is_file():
        return {}, ["the run goes on, or was interrupted"]
    try:
        data = read_json(path)
    except RealsimError as error:
        return {}, [f"result.json: {error.message}"]
    if not isinstance(data, dict):
        return {}, ["result.json does not hold a result"]
    return data, [] if "result" in data else ["the run goes on, or was interrupted"]


def _part(data: Mapping[str, Any], name: str, kind: type = dict) -> Any:
    """A part of untrusted data, empty if it is of another kind."""
    value = data.get(name)
    return value if isinstance(value, kind) else kind()
