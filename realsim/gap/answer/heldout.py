"""How much: errors on runs that no fit has seen, beside baselines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from realsim.errors import GapError
from realsim.gap.causes.fit import Fit
from realsim.gap.causes.leftover import nuisance_settings
from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.evidence.blackbox import predict
from realsim.gap.simulation.simulate import Setting, Simulator
from realsim.types import F64

BLOCK_SECONDS = 0.5


@dataclass(frozen=True)
class Shrinkage:
    """Squared normalised error on unseen runs; 1 is the nominal simulator's."""

    runs: tuple[str, ...]
    unseen: bool
    """False if there was no run to spare, so the fit has seen them."""
    after: float
    fraction: float
    ci90: tuple[float, float]
    above_floor: float | None
    """Fraction of the gap above the noise floor that went, None where there is none."""
    with_nuisances: float
    """Error left when the small everyday deviations are fitted too, unless they make it worse."""
    unexplained: float
    """Share of the gap above the floor that then stays."""
    before_over_floor: float
    """Mean squared error of the nominal simulator in units of the floor."""
    after_over_floor: float
    """The same of causes and nuisances together."""
    structure: float = 0.0
    """Share of what is then left that a black box still predicts on the unseen runs."""
    per_signal: dict[str, dict[str, float]] = field(default_factory=dict)
    baselines: dict[str, float] = field(default_factory=dict)
    """Error by baseline, 1 is the nominal simulator's."""


def errors(
    simulator: Simulator, comparison: Comparison, settings: Sequence[Setting], runs: Sequence[int]
) -> list[F64] | None:
    """(B, C) residuals a run, or None where the simulation fails."""
    try:
        predicted = simulator.simulate(settings, runs=runs)
    except GapError:
        return None
    if not all(np.isfinite(y).all() for y in predicted):
        return None
    return [comparison.residual(r, y) for r, y in zip(runs, predicted, strict=True)]


def with_nuisances(
    screen: Screen, comparison: Comparison, fit: Fit, settings: Sequence[Setting], runs: Sequence[int]
) -> list[F64] | None:
    """Residuals with causes and nuisances; the nuisances shrink until the simulator accepts them."""
    for scale in (1.0, 0.5, 0.0):
        found = errors(screen.simulator, comparison, [*settings, *nuisance_settings(screen, fit, scale)], runs)
        if found is not None:
            return found
    return None


def mean_gaps(comparison: Comparison, nominal: Sequence[F64]) -> list[float]:
    """Mean square of the nominal simulator's error in units of the floor, a run."""
    runs = range(len(nominal))
    return [mean_square(comparison, [comparison.residual(i, nominal[i])], [i]) for i in runs]


def mean_square(comparison: Comparison, residuals: Sequence[F64], runs: Sequence[int], cap: float = np.inf) -> float:
    """Mean of squared residuals in units of the floor."""
    total, count = 0.0, 0
    for run, r in zip(runs, residuals, strict=True):
        ratio = np.minimum(r**2 / comparison.floor(run), cap)
        total += float(np.nansum(ratio))
        count += int(np.isfinite(ratio).sum())
    return total / max(count, 1)


def shrinkage(
    screen: Screen,
    comparison: Comparison,
    nominal: Fit,
    fit: Fit,
    runs: Sequence[int],
    unseen: bool,
    resamples: int,
    seed: int,
    rivals: dict[str, Sequence[Setting]],
) -> Shrinkage:
    """Before and after on `runs`, with a block bootstrap, and what the rivals reach."""
    simulator = screen.simulator
    before = errors(simulator, comparison, [], runs)
    if before is None:
        raise GapError("the nominal simulator explodes on the unseen runs")
    after = errors(simulator, comparison, fit.settings(), runs) or before
    clean = with_nuisances(screen, comparison, fit, fit.settings(), runs) or after
    e0, e1, e2 = (mean_square(comparison, r, runs) for r in (before, after, clean))
    if e1 < e2:  # deviations that do not carry over are not held against the causes
        clean, e2 = after, e1
    rng = np.random.default_rng(seed)
    low, high = _bootstrap(comparison, before, after, runs, resamples, rng)
    baselines = {"nominal": 1.0}
    for name, settings in rivals.items():
        found = errors(simulator, comparison, settings, runs)
        baselines[name] = mean_square(comparison, found, runs) / e0 if found is not None else float("nan")
    learned = predict(simulator, comparison, _of(comparison, screen.runs, screen.nominal), screen.runs, runs)
    boxed = [a - p for a, p in zip(before, learned, strict=True)]
    baselines["black-box residual (ridge)"] = mean_square(comparison, boxed, runs) / e0
    left = with_nuisances(screen, comparison, fit, fit.settings(), screen.runs) or _of(
        comparison, screen.runs, fit.predictions
    )
    further = predict(simulator, comparison, left, screen.runs, runs)
    e3 = mean_square(comparison, [a - p for a, p in zip(clean, further, strict=True)], runs)
    return Shrinkage(
        runs=tuple(simulator.case.runs[i].name for i in runs),
        unseen=unseen,
        after=e1 / e0,
        fraction=1 - e1 / e0,
        ci90=(low, high),
        above_floor=(e0 - e1) / (e0 - 1) if e0 > 1.2 else None,
        with_nuisances=e2 / e0,
        unexplained=float(np.clip((e2 - 1) / (e0 - 1), 0, 1)) if e0 > 1.0 else 0.0,
        before_over_floor=e0,
        after_over_floor=e2,
        structure=float(np.clip(1 - e3 / e2, 0, 1)) if unseen else 0.0,
        per_signal=_per_signal(comparison, before, after, runs),
        baselines=baselines,
    )


def _of(comparison: Comparison, runs: Sequence[int], predictions: Sequence[F64]) -> list[F64]:
    return [comparison.residual(r, y) for r, y in zip(runs, predictions, strict=True)]


def _bootstrap(
    comparison: Comparison,
    before: list[F64],
    after: list[F64],
    runs: Sequence[int],
    resamples: int,
    rng: np.random.Generator,
) -> tuple[float, float]:
    width = max(int(BLOCK_SECONDS / comparison.config.bin_seconds), 1)
    blocks0, blocks1 = [], []
    for run, a, b in zip(runs, before, after, strict=True):
        floor = comparison.floor(run)
        x, y = np.nansum(a**2 / floor, axis=1), np.nansum(b**2 / floor, axis=1)
        edges = np.arange(0, len(x), width)
        blocks0.append(np.add.reduceat(x, edges))
        blocks1.append(np.add.reduceat(y, edges))
    x, y = np.concatenate(blocks0), np.concatenate(blocks1)
    pick = rng.integers(0, len(x), (resamples, len(x)))
    fractions = 1 - y[pick].sum(axis=1) / np.maximum(x[pick].sum(axis=1), 1e-12)
    return float(np.quantile(fractions, 0.05)), float(np.quantile(fractions, 0.95))


def _per_signal(
    comparison: Comparison, before: list[F64], after: list[F64], runs: Sequence[int]
) -> dict[str, dict[str, float]]:
    result = {}
    for signal in dict.fromkeys(c.signal for c in comparison.channels):
        columns = [i for i, c in enumerate(comparison.channels) if c.signal == signal]
        rms = [float(np.sqrt(np.nanmean(np.concatenate([r[:, columns] for r in rs]) ** 2))) for rs in (before, after)]
        floor = float(np.sqrt(np.mean(np.concatenate([comparison.floor(i)[:, columns] for i in runs]))))
        result[signal] = {"rms_before": rms[0], "rms_after": rms[1], "floor": floor}
    return result
