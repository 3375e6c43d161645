"""What a diagnosis compares, as time series for Foxglove, PlotJuggler or Rerun: signals.mcap."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.mcap_file import NUMBER, TIME, stamped, write_mcap
from realsim.core.types import F64
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.simulation.simulate import measured

LOG: Mapping[str, Any] = {
    "type": "object",
    "properties": {"timestamp": TIME, "level": NUMBER, "message": {"type": "string"}, "name": {"type": "string"}},
}


def write_signals(path: Path, found: Diagnosis, sentence: str) -> None:
    """Write the runs of the check, each with its own topics, one run after the other.

    `/RUN/measured`, `/RUN/nominal` and, where causes were found, `/RUN/with_causes` hold a number for each signal
    (`joint_pos.elbow`, in the unit of the log); `/RUN/residual` is measured less nominal, averaged over bins.
    `/diagnosis` is the answer.

    Raises:
        GapError: the diagnosis kept no arrays.
        MissingExtraError: the package mcap is not installed.
    """
    kept = found.evidence
    if kept is None:
        raise GapError("no signals were kept", expected="a diagnosis with a report")
    names = [f"{c.signal}.{c.label}" for c in kept.channels]
    signals = ("signals", {"type": "object", "properties": dict.fromkeys(names, NUMBER)})
    runs = [kept.case.runs[i].name for i in kept.runs]
    parts = ("measured", "nominal", *(("with_causes",) if kept.after else ()), "residual")
    topics: dict[str, Any] = {f"/{run}/{part}": signals for run in runs for part in parts}
    topics["/diagnosis"] = ("foxglove.Log", LOG)
    answer = {"timestamp": stamped(0.0), "level": 2, "message": sentence, "name": "realsim"}
    write_mcap(path, topics, [("/diagnosis", 0.0, answer), *_messages(kept, names)])


def _messages(kept: Arrays, names: list[str]) -> Iterator[tuple[str, float, dict[str, float]]]:
    begin = 0.0
    for k, number in enumerate(kept.runs):
        run = kept.case.runs[number]
        start = begin - float(run.time[0])
        tables = {"measured": measured(run, kept.channels), "nominal": kept.before[k]}
        if kept.after:
            tables["with_causes"] = kept.after[k]
        for part, table in tables.items():
            yield from _rows(f"/{run.name}/{part}", run.time + start, table, names)
        yield from _rows(f"/{run.name}/residual", kept.times[number] + start, kept.errors_before[k], names)
        begin += float(run.time[-1] - run.time[0]) + 1.0


def _rows(topic: str, times: F64, table: F64, names: list[str]) -> Iterator[tuple[str, float, dict[str, float]]]:
    for time, row in zip(times, table, strict=False):
        yield topic, float(time), {n: float(v) for n, v in zip(names, row, strict=True) if np.isfinite(v)}
