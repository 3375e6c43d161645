"""Is this log fit for a diagnosis? Clock, drops, quantisation, saturation, units, order and sign, rest, excitation."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.case import Case
from realsim.gap.simulate import Simulator


def examine(simulator: Simulator) -> dict[str, Any]:
    """Figures and `warnings`. Raises GapError where no diagnosis is possible."""
    case = simulator.case
    warnings = list(case.warnings) + [f"left out: {d}" for d in case.dropped_runs]
    clock = [_clock(r.time) for r in case.runs]
    for run, c in zip(case.runs, clock, strict=True):
        if c["jitter"] < 1e-9:
            warnings.append(f"{run.name}: perfectly even time stamps: they were made up, not measured")
        if c["gaps"]:
            warnings.append(f"{run.name}: {c['gaps']} gaps in time, the longest {c['longest_s']:.3g} s")
    _failures(simulator)
    still = _still(case)
    if still == len(case.runs):
        raise GapError(
            "no run excites the robot: all commands are constant",
            file=case.folder,
            expected="commands that move the joints",
            hint="record slow and fast motion with reversals",
        )
    if still:
        warnings.append(f"{still} runs hold one command: they show only loads at rest")
    missing = {
        k: float(np.mean([1 - np.isfinite(r.signals[k]).mean() for r in case.runs])) for k in case.runs[0].signals
    }
    missing = {k: v for k, v in missing.items() if v > 0}
    for name, share in missing.items():
        if share > 0.2:
            warnings.append(f"{share:.0%} of {name} is missing")
    warnings += _conventions(simulator)
    return {
        "clock": {
            "median_step_s": float(np.median([c["step"] for c in clock])),
            "jitter_s": float(np.median([c["jitter"] for c in clock])),
        },
        "missing": missing,
        "quantum": {k: _quantum(case, k) for k in ("joint_pos",)},
        "warnings": warnings,
    }


def _clock(time: np.ndarray) -> dict[str, Any]:
    step = np.diff(time)
    median = float(np.median(step))
    gaps = step > 3 * median
    return {
        "step": median,
        "jitter": float(np.std(step[~gaps])) if (~gaps).any() else 0.0,
        "gaps": int(gaps.sum()),
        "longest_s": float(step.max()),
    }


def _still(case: Case) -> int:
    return sum(bool((np.ptp(r.command, axis=0) < 1e-6).all()) for r in case.runs)


def _quantum(case: Case, name: str) -> float:
    """Smallest step between readings, the median over joints."""
    steps = []
    for column in range(case.runs[0].signals[name].shape[1]):
        values = np.unique(case.runs[0].signals[name][:, column])
        values = values[np.isfinite(values)]
        if len(values) > 2:
            steps.append(float(np.quantile(np.diff(values), 0.1)))
    return float(np.median(steps)) if steps else 0.0


def _failures(simulator: Simulator) -> None:
    """The nominal simulator must survive the runs: say where and when it does not."""
    case = simulator.case
    for run, track in zip(case.runs, simulator.nominal_tracks, strict=True):
        settle, dt = track["settle"]
        bad = ~np.isfinite(track["pos"]).all(axis=1)
        if bad.any():
            when = int(np.argmax(bad)) * dt - settle
            raise GapError(
                "the nominal simulator explodes",
                file=case.folder / "model.xml",
                found=f"in {run.name} at {when:.2f} s",
                hint="check gains, inertias and the time step of model.xml before looking for a gap",
            )
        if "base_pos" in track and "base_pos" in run.signals:
            real = run.signals["base_pos"][:, 2]
            low = float(np.nanmin(track["base_pos"][:, 2]))
            start = float(np.nanmedian(real[:5]))
            if low < 0.5 * start <= np.nanmin(real) * 1.4:
                when = float(np.argmax(track["base_pos"][:, 2] < 0.5 * start)) * dt - settle
                raise GapError(
                    "the nominal simulator falls over where the robot does not",
                    file=case.folder / "model.xml",
                    found=f"in {run.name} at {when:.2f} s",
                    hint="shorten the runs (max_seconds), or mend the model first",
                )


def _conventions(simulator: Simulator) -> list[str]:
    """Wrong units, order or sign: each is tested against the nominal simulator."""
    case = simulator.case
    found = []
    nominal = simulator.simulate()
    names = case.joint_names
    real = np.concatenate([r.signals["joint_pos"] for r in case.runs])
    model = np.concatenate([y[:, : len(names)] for y in nominal])
    good = np.isfinite(real).all(axis=1) & np.isfinite(model).all(axis=1)
    a, b = real[good] - real[good].mean(axis=0), model[good] - model[good].mean(axis=0)
    size_a, size_b = np.sqrt((a**2).mean(axis=0)), np.sqrt((b**2).mean(axis=0))
    corr = (a.T @ b) / len(a) / np.maximum(np.outer(size_a, size_b), 1e-12)
    for j, name in enumerate(names):
        if size_b[j] < 1e-3 or size_a[j] < 1e-3:
            continue
        ratio = size_a[j] / size_b[j]
        if 40 < ratio < 80 and corr[j, j] > 0.8:
            found.append(f"{name}: positions look like degrees (they are {ratio:.0f} times the simulator's)")
        if corr[j, j] < -0.8:
            found.append(f"{name}: positions look negated")
        best = int(np.argmax(np.abs(corr[j])))
        if best != j and corr[j, best] > 0.97 and corr[j, j] < 0.6:
            found.append(f"{name}: its column looks like that of {names[best]}: check the order of joints")
    if case.has("joint_torque"):
        found += _torque_units(simulator, nominal)
    return found


def _torque_units(simulator: Simulator, nominal: list[np.ndarray]) -> list[str]:
    case, found = simulator.case, []
    for c, channel in enumerate(simulator.channels):
        if channel.signal != "joint_torque":
            continue
        real = np.concatenate([r.signals["joint_torque"][:, channel.index] for r in case.runs])
        model = np.concatenate([y[:, c] for y in nominal])
        good = np.isfinite(real) & np.isfinite(model)
        top = float((model[good] ** 2).sum())
        gain = float((real[good] * model[good]).sum()) / top if top > 1e-12 else 1.0
        if case.torque_kind == "measured" and (abs(gain) > 4 or abs(gain) < 0.25):
            found.append(f"{channel.label}: torque is {gain:.3g} times the simulator's: is it in N m?")
        elif gain < -0.25:
            found.append(f"{channel.label}: torque looks negated")
    return found
