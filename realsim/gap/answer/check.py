"""How much: errors of the nominal and of the patched simulator on the runs of the check, signal by signal.

One definition everywhere (sentence, page, JSON): `before` is the nominal simulator, `after` the one with the causes, as
the patch changes it. Everyday deviations are in neither; they only decide how much of the rest is worth explaining.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import interval90, resampled
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.case.model.channels import unit_of
from realsim.gap.inference.causes.fitted import is_gap
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Setting, Simulator, measured

BLOCK_SECONDS = 0.5
"""Blocks of the bootstrap: some correlation times of a servo's error. Not tuned."""
KINDS = {
    "validation": "no fit, floor or search saw these runs; the verdict is decided with them",
    "left_out_in_turn": "no run was spared: each fitted run as predicted by values fitted to the others",
    "fitted": "no run was spared and there is only one: these runs were fitted",
}
"""What the runs of a check are."""


@dataclass(frozen=True)
class Horizons:
    """Squared errors of predictions from states of the log, in units of sensors, detail and the states' own noise."""

    windows: int
    before: float
    """Mean square of the nominal simulator."""
    fraction: float
    """Share of it that the causes remove."""
    ci90: tuple[float, float]


@dataclass(frozen=True)
class Check:
    """Squared normalised errors on the runs of the check."""

    runs: tuple[str, ...]
    kind: str
    """A key of KINDS."""
    before: float
    """Mean square of the nominal simulator's error in units of the floor."""
    after: float
    """The same of the patched one's."""
    beside: float
    """The same with the everyday deviations that the fitted runs make most probable."""
    ci90: tuple[float, float]
    """Of `fraction`, by a bootstrap over blocks."""
    signals: dict[str, dict[str, Any]]
    """By signal, root mean squares in its `unit`: of the `motion` about its mean, of the error before and after, and of
    what sensors and a good simulator's details leave (`floor`)."""
    beside90: tuple[float, float] | None = None
    """90 percent interval of the share that the causes remove beside everyday deviations; None where that cannot be
    simulated."""
    where_it_acts: float = 0.0
    """Share of the squared error that the patch removes in the channels that it changes, weighed by how much of its
    change falls in each: one joint's cause is not judged by another joint's gap."""
    horizons: Horizons | None = None
    """The same over horizons of a second at most, in all windows that were not fitted."""

    @property
    def holds(self) -> bool:
        """Whether the causes surely reduce the error: over horizons, where one whole replay decides nothing, or in that
        replay, where the horizons do not speak against it.

        As the patch stands; or beside everyday deviations, where these explain the rest: on a robot with many joints
        and feet they make most of the error, and a cause without them may even leave more.
        """
        if self.horizons is not None and self.horizons.ci90[0] > 0:
            return True
        return self.replay_holds and not (self.horizons is not None and self.horizons.ci90[1] < 0)

    @property
    def replay_holds(self) -> bool:
        """The same in whole replays of the runs of the check alone."""
        if self.beside90 is None or is_gap(np.array([self.beside])):
            return self.ci90[0] > 0
        return max(self.ci90[0], self.beside90[0]) > 0

    @property
    def follows(self) -> bool:
        """Whether the patched simulator goes where the robot goes, in some signal at least."""
        moved = [s["rms_after"] < figures.FOLLOWS * s["motion"] for s in self.signals.values()]
        return any(moved) or not moved

    @property
    def fraction(self) -> float:
        """Share of the squared error that the patch removes."""
        return 1 - self.after / max(self.before, 1e-12)

    @property
    def unexplained(self) -> float:
        """Share of the gap above the floor that stays beside causes and everyday deviations."""
        return float(np.clip((self.beside - 1) / (self.before - 1), 0, 1)) if self.before > 1 else 0.0

    @property
    def above_floor(self) -> float | None:
        """Share of the gap above the floor that the patch removes, None where there is hardly any."""
        return (self.before - self.after) / (self.before - 1) if self.before > 1.2 else None

    @property
    def unseen(self) -> bool:
        return self.kind == "validation"


def check(
    comparison: Comparison,
    runs: Sequence[int],
    kind: str,
    before: Sequence[F64],
    after: Sequence[F64],
    beside: Sequence[F64],
    resamples: int,
    seed: int,
    nothing: Sequence[F64] | None = None,
) -> Check:
    """From (B, C) residuals a run: nominal, patched, and patched with everyday deviations; `nothing`: these alone."""
    drawn = (comparison, runs, resamples, seed)
    return Check(
        runs=tuple(comparison.case.runs[i].name for i in runs),
        kind=kind,
        before=mean_square(comparison, before, runs),
        after=mean_square(comparison, after, runs),
        beside=mean_square(comparison, beside, runs),
        ci90=_gone(before, after, *drawn),
        signals=_signals(comparison, runs, before, after),
        beside90=_gone(nothing, beside, *drawn) if nothing is not None else None,
        where_it_acts=_where_it_acts(comparison, runs, before, after),
    )


def _gone(
    x: Sequence[F64], y: Sequence[F64], comparison: Comparison, runs: Sequence[int], resamples: int, seed: int
) -> tuple[float, float]:
    """90 percent interval of the share of x's squared error that is not in y, by a bootstrap over blocks."""
    drawn = []
    for rs in (x, y):
        squares = (np.nansum(r**2 / comparison.floor(i), axis=1) for i, r in zip(runs, rs, strict=True))
        drawn.append(resampled(in_blocks(comparison, squares), resamples, seed).sum(axis=1))
    low, high = interval90(1 - drawn[1] / np.maximum(drawn[0], 1e-12))
    return float(low), float(high)


def _where_it_acts(comparison: Comparison, runs: Sequence[int], before: Sequence[F64], after: Sequence[F64]) -> float:
    change = [x - y for x, y in zip(before, after, strict=True)]
    had, left, moved = (
        sum(np.nansum(r**2 / comparison.floor(run), axis=0) for run, r in zip(runs, rs, strict=True))
        for rs in (before, after, change)
    )
    return float(np.sum(moved * (1 - left / np.maximum(had, 1e-12))) / max(np.sum(moved), 1e-12))


def errors(
    simulator: Simulator,
    comparison: Comparison,
    settings: Sequence[Setting],
    runs: Sequence[int],
    onsets: Mapping[str, float],
) -> list[F64] | None:
    """(B, C) residuals a run, or None where the simulation fails; see `Simulator.edited` for `onsets`."""
    try:
        predicted = simulator.simulate(settings, runs, onsets=onsets)
    except GapError:
        return None
    if not all(np.isfinite(y).all() for y in predicted):
        return None
    return [comparison.residual(r, y) for r, y in zip(runs, predicted, strict=True)]


def mean_square(comparison: Comparison, residuals: Sequence[F64], runs: Sequence[int]) -> float:
    """Mean of squared residuals in units of the floor."""
    total, count = 0.0, 0
    for run, r in zip(runs, residuals, strict=True):
        ratio = r**2 / comparison.floor(run)
        total += float(np.nansum(ratio))
        count += int(np.isfinite(ratio).sum())
    return total / max(count, 1)


def in_blocks(comparison: Comparison, rows: Iterable[F64]) -> F64:
    """(N,) sums over blocks of half a second of (B,) a run."""
    width = max(int(BLOCK_SECONDS / comparison.config.bin_seconds), 1)
    return np.concatenate([np.add.reduceat(row, np.arange(0, len(row), width)) for row in rows])


def _signals(
    comparison: Comparison, runs: Sequence[int], before: Sequence[F64], after: Sequence[F64]
) -> dict[str, dict[str, Any]]:
    found = {}
    values = [measured(comparison.case.runs[i], comparison.channels) for i in runs]
    about = [v - np.nanmean(v, axis=0) for v in values]
    for signal in dict.fromkeys(c.signal for c in comparison.channels):
        columns = [i for i, c in enumerate(comparison.channels) if c.signal == signal]
        sizes = {"motion": about, "rms_before": before, "rms_after": after}
        floor = float(np.sqrt(np.mean(np.concatenate([comparison.floor(i)[:, columns] for i in runs]))))
        unit = unit_of(signal, comparison.channels[columns[0]].label, comparison.case.model)
        parts = {name: np.concatenate(rs)[:, columns] for name, rs in sizes.items()}
        rms = {name: float(np.sqrt(np.nanmean(values**2))) for name, values in parts.items()}
        found[signal] = {"unit": unit, **rms, "floor": floor}
    return found
