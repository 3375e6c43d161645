"""What the report draws over time: the runs of the check, replayed before and after."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.compare import Comparison
from realsim.gap.evidence.shooting import Shots, shoot
from realsim.gap.logs.case import Case
from realsim.types import F64


@dataclass(frozen=True)
class Replay:
    """Runs of the check as the nominal and the patched simulator see them; empty with a reason if they cannot."""

    case: Case | None
    comparison: Comparison | None
    runs: tuple[int, ...] = ()
    before: tuple[F64, ...] = ()
    """(T, C) a run, nominal."""
    after: tuple[F64, ...] = ()
    """(T, C) a run, with the causes; empty where there are none."""
    shots: tuple[Shots, ...] = ()
    """Predictions from estimated states: nominal, and with the causes where there are any."""
    reason: str = ""
    """Why something is missing, or nothing."""

    def errors(self, simulated: tuple[F64, ...]) -> list[F64]:
        """(B, C) binned errors a run."""
        assert self.comparison is not None
        return [self.comparison.residual(r, y) for r, y in zip(self.runs, simulated, strict=True)]


def replay(found: Diagnosis) -> Replay:
    """Simulate the runs of the check with and without the causes."""
    simulator, comparison = found.evidence.get("simulator"), found.evidence.get("comparison")
    if simulator is None or comparison is None:
        return Replay(None, None, reason="The simulator was not kept with this diagnosis.")
    case = simulator.case
    chosen = set(found.evidence.get("check", ()))
    runs = tuple(i for i, r in enumerate(case.runs) if r.name in chosen)
    if not runs:
        return Replay(case, comparison, reason="No run was kept for the check.")
    with simulator:  # its thread pool opens at need; leaving closes it
        before = tuple(simulator.simulate(runs=runs))
        shots: tuple[Shots, ...] = (shoot(simulator, runs=runs),)
        fit = found.evidence.get("fit")
        if not found.causes or fit is None:
            reason = "No cause was found, so there is nothing to add."
            return Replay(case, comparison, runs, before, shots=shots, reason=reason)
        try:
            after = tuple(simulator.simulate(fit.settings(), runs=runs))
            shots = (*shots, shoot(simulator, fit.settings(), runs))
        except GapError as error:
            reason = f"The patched simulator does not run: {error.message}"
            return Replay(case, comparison, runs, before, shots=shots, reason=reason)
    return Replay(case, comparison, runs, before, after, shots)


def horizons(shown: Replay, signal: str = "joint_pos") -> list[tuple[str, float, float | None]]:
    """(horizon, before, after): error of predictions over each horizon, in units of a sample's noise floor."""
    if shown.comparison is None or not shown.shots or signal not in shown.shots[0].signals():
        return []
    columns = [i for i, c in enumerate(shown.comparison.channels) if c.signal == signal]
    noise = shown.comparison.noise
    floor = float(np.sqrt(np.mean(noise.sensor[columns] ** 2 + noise.detail[columns] ** 2)))
    rms = [s.rms(signal) / floor for s in shown.shots]
    return [
        (label, float(rms[0][i]), float(rms[1][i]) if len(rms) > 1 else None)
        for i, label in enumerate(shown.shots[0].labels)
        if np.isfinite([r[i] for r in rms]).all()
    ]


def worst_windows(shown: Replay, seconds: float = 1.5, count: int = 4) -> list[tuple[int, int, float, float]]:
    """(position in `runs`, channel, start, end): where the nominal simulator is farthest off, in units of the floor.

    Signals and channels take turns, so that four windows show four things where there are as many.
    """
    if shown.comparison is None or not shown.before:
        return []
    channels = shown.comparison.channels
    scored: list[tuple[float, int, int, float]] = []
    for k, error in enumerate(shown.errors(shown.before)):
        ratio = np.nan_to_num(error**2 / shown.comparison.floor(shown.runs[k]))
        width = min(max(int(seconds / shown.comparison.config.bin_seconds), 1), len(ratio))
        # Windows side by side, so that two of one channel never show the same.
        for first in range(0, len(ratio) - width + 1, width):
            start = float(shown.comparison.times[shown.runs[k]][first])
            scored += [(float(v), k, c, start) for c, v in enumerate(ratio[first : first + width].mean(axis=0))]
    chosen: list[tuple[float, int, int, float]] = []
    while scored and len(chosen) < count:
        of_channel = Counter(c for _, _, c, _ in chosen)
        of_signal = Counter(channels[c].signal for _, _, c, _ in chosen)
        best = min(scored, key=lambda w: (of_channel[w[2]], of_signal[channels[w[2]].signal], -w[0]))
        scored.remove(best)
        chosen.append(best)
    return [(k, c, start, start + seconds) for _, k, c, start in chosen]


def place_shares(found: Diagnosis) -> tuple[list[tuple[str, str]], Any]:
    """(kind, name) of each row and (R, phases) shares: one row a joint (all its signals), one a signal of the base."""
    comparison, shares = found.evidence["comparison"], np.asarray(found.evidence["shares"])
    rows: dict[tuple[str, str], F64] = {}
    for channel, row in zip(comparison.channels, shares, strict=True):
        key = ("joint", channel.label) if channel.signal.startswith("joint") else ("signal", channel.signal)
        rows[key] = rows.get(key, np.zeros(shares.shape[1])) + row
    return list(rows), np.array(list(rows.values()))
