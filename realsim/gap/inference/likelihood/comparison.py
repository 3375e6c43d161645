"""Difference between log and simulator: bins, noise floor, weights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case, Run
from realsim.gap.case.motion import differences, median_size
from realsim.gap.config import DiagnoseConfig
from realsim.gap.simulation.simulate import Channel, measured

CORRELATION = 20.0
"""Unmodelled detail is correlated over some tenths of a second: that many bins count as one."""
LONG_PART = 400
"""Bins of a part of a replay from which on its beginning does not matter to that."""
CLOCK_SIGMA = 3e-4
"""Seconds: jitter of time stamps that nobody logs. Its error grows with the rate of a signal."""
TOUCH_SIGMA = 3e-3
"""Seconds by which a touchdown may come sooner or later: what an accelerometer on a walking robot makes of it."""

PHASE = 0.3
"""A torque may be sampled before or after a command that changes at that very moment: share of the step, as noise."""

PART_SECONDS, PART_FACTOR = 0.5, 12.0
"""A floating robot has parted from its simulator where the error stays this many times above the usual one."""

TEMPER = 0.25
TEMPER_SECONDS = 1.0

# What structure of no consequence remains in any good simulator: (absolute, share of the signal's own spread).
DETAIL = {
    "joint_pos": (8e-4, 0.002),
    "joint_vel": (8e-3, 0.006),
    "joint_torque": (2e-2, 0.015),
    "base_pos": (8e-4, 0.005),
    "base_rot": (1.2e-3, 0.005),
    "imu_gyro": (1e-2, 0.01),
    "imu_acc": (1e-1, 0.05),
}


@dataclass(frozen=True)
class Noise:
    """The floor, channel by channel."""

    sensor: F64
    """(C,) standard deviation of a sample, from the log's own high frequencies."""
    detail: F64
    """(C,) standard deviation of slow structure that is no gap."""


@dataclass(frozen=True, eq=False)
class Weights:
    """How much each error counts."""

    of: tuple[F64, ...]
    """(B, C) a run: one over the variance that is expected; 0 where there is no sample."""
    form: Mapping[int, F64] = field(default_factory=dict)
    """Run -> (B, C) root mean square that the form of the causes leaves open."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """Two fits compare where these are the same."""

    about: F64
    """(p,) nuisance parameters that every simulation contains; the others are linear about them."""
    weights: Weights
    onsets: Mapping[str, float] = field(default_factory=dict)
    """Run -> seconds at which something sudden begins there; see realsim.gap.inference.evidence.onsets."""
    gap: bool = False
    """Whether everyday deviations alone leave a gap; the search finds out."""


class Comparison:
    """Log against simulator on regular bins. Residuals are (B, C) a run, in the units of the channels."""

    def __init__(
        self,
        case: Case,
        channels: Sequence[Channel],
        nominal: Sequence[F64],
        config: DiagnoseConfig,
        runs: Sequence[int] | None = None,
        noise: Noise | None = None,
    ) -> None:
        """`runs`: those that the noise floor and what parts are judged by; all if None. `noise`: another log's floor,
        that errors count against."""
        self.case, self.channels, self.config = case, tuple(channels), config
        self._starts, self._counts, self._values, self.times = [], [], [], []
        self._valid, self._phase = [], []
        self._free: dict[int, list[tuple[Bool, F64, F64]]] = {}
        for run in case.runs:
            bins = np.floor(run.time / config.bin_seconds).astype(int)
            starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
            values = measured(run, channels)
            good = np.isfinite(values)
            self._starts.append(starts)
            self._valid.append(good)
            steps = np.where(good, PHASE * _torque_steps(case, run, channels), 0.0)
            self._phase.append(np.add.reduceat(steps**2, starts, axis=0))
            self._counts.append(np.add.reduceat(good.astype(float), starts, axis=0))
            self._values.append(np.where(good, values, 0.0))
            self.times.append(np.add.reduceat(run.time, starts) / np.diff(np.append(starts, len(run.time))))
        walks = [case.floating and c.signal == "imu_acc" for c in self.channels]
        self._clock = np.where(walks, TOUCH_SIGMA, CLOCK_SIGMA)
        self._rates = [self._rate(i, y) for i, y in enumerate(nominal)]
        known = range(len(nominal)) if runs is None else runs
        self.noise = self._floor(nominal, known)
        self.parted = self._part(nominal, known)
        """Run -> seconds from which robot and simulator have parted for good (a fall, a slip); left out from there."""
        self.noise = noise or self.noise
        self._correlation = [np.full((len(times), 1), CORRELATION) for times in self.times]

    def _part(self, nominal: Sequence[F64], known: Sequence[int]) -> dict[str, float]:
        """Time from which a floating robot's error is large for good: chaos, not evidence."""
        if not self.case.floating:
            return {}
        width = max(int(PART_SECONDS / self.config.bin_seconds), 1)
        levels = []
        for run, y in enumerate(nominal):
            square = np.nanmean(self.residual(run, y) ** 2 / self.floor(run), axis=1)
            levels.append(np.convolve(np.nan_to_num(square), np.ones(width) / width, mode="same"))
        limit = PART_FACTOR * max(float(np.median(np.concatenate([levels[i] for i in known]))), 8.0)
        parted = {}
        for run, level in enumerate(levels):
            fine = np.flatnonzero(level <= limit)
            last = int(fine[-1]) if len(fine) else 0
            if len(level) - last > width:
                last = max(last - width // 2, width)
                self._counts[run][last:] = 0
                parted[self.case.runs[run].name] = float(self.times[run][last])
        return parted

    def residual(self, run: int, simulated: F64) -> F64:
        """(B, C) mean of measured - simulated in each bin; NaN where a bin has no sample or the simulator failed."""
        return np.where(self._counts[run] > 0, self._mean(run, self._values[run] - simulated), np.nan)

    def rows_at(self, run: int, track: Mapping[str, F64]) -> NDArray[np.int64]:
        """(B,) the row of a simulator's own grid at each bin."""
        settle, dt = track["settle"]
        return np.clip(((self.times[run] + settle) / dt).astype(int), 0, len(track["pos"]) - 1)

    def change(self, run: int, simulated: F64, base: F64) -> F64:
        """(B, C) mean change of the prediction in each bin; 0 where none of its samples count."""
        return np.where(self._counts[run] > 0, self._mean(run, simulated - base), 0.0)

    def _mean(self, run: int, values: F64) -> F64:
        """(B, C) mean of (T, C) over the samples of each bin, beside the states that the run's parts begin in."""
        total = np.add.reduceat(np.where(self._valid[run], values, 0.0), self._starts[run], axis=0)
        return self._beside_starts(run, total / np.maximum(self._counts[run], 1))

    def free_starts(self, run: int, slopes: F64, parts: NDArray[np.int64]) -> None:
        """Let each part of a run begin where it fits best: what the state that it begins in can explain is no error.

        Args:
            slopes: (T, C, K) change of the prediction by one unit of each coordinate of those states.
            parts: (B,) the part that each bin lies in.
        """
        columns = [self._mean(run, slopes[:, :, k]) for k in range(slopes.shape[2])]
        S, known = np.stack(columns, axis=2), self._counts[run] > 0
        root = np.where(known, self.floor(run) ** -0.5, 0.0)
        self._free[run] = []
        for part in np.unique(parts):
            rows = parts == part
            there = S[rows].reshape(-1, S.shape[2])
            fit = np.linalg.pinv(root[rows].reshape(-1, 1) * there, rcond=1e-6) * root[rows].reshape(-1)
            self._free[run].append((rows, there, fit))
            self._correlation[run][rows] = correlated(int(rows.sum()))

    def expect(self, run: int, slopes: F64, parts: NDArray[np.int64]) -> None:
        """Let something unknown act in each part, steadily and independently: what it explains counts for as little as
        it is likely (whitening of the residual, so that floor and weights hold on).

        Args:
            slopes: (T, C, K) change of the prediction by one standard deviation of each of its coordinates.
            parts: as in `free_starts`, which comes before.
        """
        S = np.stack([self._mean(run, slopes[:, :, k]) for k in range(slopes.shape[2])], axis=2)
        root = np.where(self._counts[run] > 0, self.floor(run) ** -0.5, 0.0)
        for part in np.unique(parts):
            rows = parts == part
            scale = root[rows].reshape(-1, 1)
            basis, size, _ = np.linalg.svd(scale * S[rows].reshape(-1, S.shape[2]), full_matrices=False)
            back = np.divide(basis, scale, out=np.zeros(basis.shape), where=scale > 0)
            self._free[run].append((rows, back * (1 - 1 / np.sqrt(1 + size**2)), (scale * basis).T))
        self._correlation[run][:] = (
            CORRELATION  # answers to what is unknown are slow structure that no start takes over
        )

    def _beside_starts(self, run: int, values: F64) -> F64:
        """(B, C) without what the states that the parts of the run begin in explain."""
        for rows, slopes, fit in self._free.get(run, []):
            flat = values[rows].reshape(-1)
            values[rows] = (flat - slopes @ (fit @ flat)).reshape(values[rows].shape)
        return values

    def weights(self, detail: Sequence[F64] | None = None, form: Mapping[int, F64] | None = None) -> Weights:
        """Weights against slow structure of this size, (C,) or (B, C) a run; that of the floor if None."""
        sizes = [self.noise.detail for _ in self.case.runs] if detail is None else detail
        variances = [self.variance(i) + self._correlation[i] * d**2 for i, d in enumerate(sizes)]
        return Weights(
            tuple(np.where(n > 0, 1.0 / v, 0.0) for n, v in zip(self._counts, variances, strict=True)), form or {}
        )

    def tempered(self, runs: Sequence[int], simulated: Sequence[F64], nominal: Sequence[F64], form: float) -> Weights:
        """Weigh errors against the gap that is still there: a model that explains most of it is good enough for now.

        Without this, a large gap would be fitted by absurd values of many small deviations, because sensors are so
        precise that their price does not count. The tolerance is a quarter of the local error (about a second wide),
        and what the `form` of the causes leaves open: a few per cent of what they have changed.
        """
        detail: list[F64] = [self.noise.detail for _ in self.case.runs]
        missed = {}
        for run, y, y0 in zip(runs, simulated, nominal, strict=True):
            missed[run] = form * self._local(self.change(run, y, y0))
            left = TEMPER * self._local(np.nan_to_num(self.residual(run, y)))
            detail[run] = np.sqrt(self.noise.detail**2 + left**2 + missed[run] ** 2)
        return self.weights(detail, missed)

    def _local(self, values: F64) -> F64:
        """(B, C) root mean square over about a second."""
        width = min(max(int(TEMPER_SECONDS / self.config.bin_seconds), 1), len(values))
        kernel = np.ones(width) / width
        mean = [np.convolve(values[:, c] ** 2, kernel, mode="same") for c in range(values.shape[1])]
        return np.asarray(np.sqrt(np.maximum(np.stack(mean, axis=1), 0.0)))

    def variance(self, run: int) -> F64:
        """(B, C) variance of the sensors' noise in each bin."""
        sample = self.noise.sensor**2 + (self._clock * self._rates[run]) ** 2
        count = np.maximum(self._counts[run], 1)
        return (sample + self._phase[run] / count) / count

    def floor(self, run: int) -> F64:
        """(B, C) mean square that a perfect diagnosis would leave: sensors and detail."""
        return self.variance(run) + self.noise.detail**2

    def tolerance(self, run: int, weights: Weights) -> F64:
        """(B, C) mean square that causes may leave: the floor, and what their form leaves open."""
        return self.floor(run) + weights.form.get(run, np.zeros(1)) ** 2

    # ------------------------------------------------------------ inside

    def _rate(self, run: int, nominal: F64) -> F64:
        """(B, C) size of the signals' rate of change, from the nominal simulator."""
        rate = np.abs(np.gradient(np.nan_to_num(nominal), self.case.runs[run].time, axis=0))
        width = np.diff(np.append(self._starts[run], len(rate)))[:, None]
        return np.add.reduceat(rate, self._starts[run], axis=0) / width

    def _floor(self, nominal: Sequence[F64], runs: Sequence[int]) -> Noise:
        sensor, detail = [], []
        for c, channel in enumerate(self.channels):
            second, spread = [], []
            for i in runs:
                r = self._values[i][:, c] - nominal[i][:, c]
                r[~self._valid[i][:, c]] = np.nan
                second.append(differences(r, 2))
                spread.append(self._values[i][self._valid[i][:, c], c])
            kinks = np.concatenate(second)
            robust = 1.4826 * median_size(kinks)
            # A coarse encoder has a median of zero: then the mean of the smaller kinks speaks.
            trimmed = float(np.sqrt(np.mean(np.sort(kinks**2)[: max(int(0.9 * len(kinks)), 1)]))) if len(kinks) else 0.0
            sensor.append(max(robust, trimmed) / np.sqrt(6) + 1e-9)
            absolute, relative = DETAIL[channel.signal]
            values = np.concatenate(spread)
            values = values[np.isfinite(values)]
            detail.append(np.hypot(absolute, relative * float(np.std(values)) if len(values) else 0.0))
        return Noise(np.array(sensor), np.array(detail))


@cache
def correlated(bins: int) -> float:
    """Bins of slow structure that count as one, in a part of a replay of so many whose first position and speed are
    free: what they take over is no structure any more. Variance of the steady acceleration that least squares find in
    first-order autoregressive noise, over that in white noise of the same size; at least 1."""
    if bins >= LONG_PART:
        return CORRELATION
    t = np.arange(bins)
    rho = (CORRELATION - 1) / (CORRELATION + 1)  # (1 + rho) / (1 - rho) samples count as one
    free = np.vander(t / bins, 2)
    shape = t**2.0 - free @ (np.linalg.pinv(free) @ t**2.0)
    square = float(shape @ shape)
    return max(float(shape @ rho ** np.abs(t[:, None] - t) @ shape) / square, 1.0) if bins > 2 else 1.0


def _torque_steps(case: Case, run: Run, channels: Sequence[Channel]) -> F64:
    """(T, C) N m that each new command of a position servo adds to the torque at once; 0 for other signals."""
    steps = np.zeros((len(run.time), len(channels)))
    for c, channel in enumerate(channels):
        name = case.actuator_of(channel.label) if channel.signal == "joint_torque" else None
        if name is None or case.command_kind != "position":
            continue
        column = run.command[:, case.actuator_names.index(name)]
        gain = abs(case.command_torque(channel.label))
        most = float(np.nanmax(np.abs(run.signals["joint_torque"][:, channel.index]), initial=0.0))
        steps[:, c] = np.minimum(gain * np.abs(np.diff(column, prepend=column[0])), 2 * most)
    return steps
