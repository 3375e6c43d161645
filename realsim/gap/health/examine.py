"""Is this log fit for a diagnosis? Refused with the reason where it is not; otherwise figures and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.health.conventions import log_conventions, nominal_conventions
from realsim.gap.health.signals import clocks, initial_states, missing, noise, quanta, saturation
from realsim.gap.logs.case import Case
from realsim.gap.simulation.channels import uncompared
from realsim.gap.simulation.simulate import Simulator

SOME_FALLS = 1 / 3
"""Share of the runs in which the nominal simulator may fall over before the log is refused."""


def examine(simulator: Simulator) -> dict[str, Any]:
    """Figures and `warnings`. Raises GapError where no diagnosis is possible."""
    case = simulator.case
    warnings = list(case.warnings) + [f"left out: {d}" for d in case.dropped_runs]
    clock, said = clocks(case)
    warnings += said
    warnings += log_conventions(case)
    warnings += _failures(simulator)
    warnings += _excitation(case)
    gone, said = missing(case)
    warnings += said + uncompared(case)
    nominal = simulator.simulate()
    warnings += nominal_conventions(simulator, nominal)
    start, said = initial_states(simulator)
    warnings += said
    full, said = saturation(simulator)
    warnings += said
    floor, said = noise(simulator, nominal)
    return {
        "clock": clock,
        "missing": gone,
        "quantum": quanta(case),
        "noise": floor,
        "start": start,
        "saturation": full,
        "warnings": gathered(warnings + said, [r.name for r in case.runs]),
    }


def gathered(warnings: Sequence[str], runs: Sequence[str]) -> list[str]:
    """Warnings with the same text about several runs as one: `run_01, run_02 and 5 more: ...`."""
    about: dict[str, list[str]] = {}
    for warning in warnings:
        name, colon, text = warning.partition(": ")
        known = colon and Path(name).stem in runs
        about.setdefault(text if known else warning, []).extend([Path(name).stem] if known else [])
    found = []
    for text, names in about.items():
        more = f" and {len(names) - 3} more" if len(names) > 4 else ""
        listed = ", ".join(names[: 3 if more else 4])
        found.append(f"{listed}{more}: {text}" if names else text)
    return found


def _excitation(case: Case) -> list[str]:
    still = sum(bool((np.ptp(r.command, axis=0) < 1e-6).all() and r.enabled is None) for r in case.runs)
    if still == len(case.runs):
        raise GapError(
            "no run excites the robot: all commands are constant",
            file=case.folder,
            expected="commands that move the joints",
            hint="record slow and fast motion with reversals",
        )
    moved = np.max([np.ptp(r.command, axis=0) for r in case.runs], axis=0)
    idle = [name for name, m in zip(case.actuator_names, moved, strict=True) if m < 1e-6]
    said = [f"{still} runs hold one command: they show only loads at rest"] if still else []
    if idle:
        said.append(f"never commanded to move, so little can be said of them: {', '.join(idle)}")
    return said


def _failures(simulator: Simulator) -> list[str]:
    """The nominal simulator must survive the runs: say where and when it does not.

    A few falls refuse no log: such a run is compared up to where robot and simulator part for good.
    """
    case, falls = simulator.case, []
    for run, track in zip(case.runs, simulator.nominal_tracks, strict=True):
        settle, dt = track["settle"]
        bad = ~np.isfinite(track["pos"]).all(axis=1)
        if bad.any():
            when = int(np.argmax(bad)) * dt - settle
            raise GapError(
                "the nominal simulator explodes",
                file=case.folder / "model.xml",
                found=f"in {run.name} at {when:.2f} s" if when >= 0 else f"while it settles before {run.name} begins",
                hint="check gains, inertias and the time step of model.xml before looking for a gap",
            )
        if "base_pos" in track and "base_pos" in run.signals:
            real = run.signals["base_pos"][:, 2]
            low = float(np.nanmin(track["base_pos"][:, 2]))
            start = float(np.nanmedian(real[:5]))
            if low < 0.5 * start <= np.nanmin(real) * 1.4:
                falls.append((run.name, float(np.argmax(track["base_pos"][:, 2] < 0.5 * start)) * dt - settle))
    said = ", ".join(f"in {name} at {when:.2f} s" for name, when in falls)
    if len(falls) > SOME_FALLS * len(case.runs):
        raise GapError(
            "the nominal simulator falls over where the robot does not",
            file=case.folder / "model.xml",
            found=said,
            hint="shorten the runs (max_seconds), or mend the model first",
        )
    return [f"the nominal simulator falls over where the robot does not, {said}"] if falls else []
