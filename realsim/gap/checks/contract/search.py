"""One search for what differs between a loop and its contract: one score, a mistake after the other.

Score: the mean over joints of log(rms of sent less replayed targets + floor), in nats. Of all proposals, each fitted,
the one with the best score is taken if it is worth PRICE; it is applied, those before it are fitted again, and
the search goes on. At the end, each that is taken is left out once, and stays out if it is no longer worth PRICE.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.types import F64
from realsim.gap.checks.contract.loop import Loop, commands, looking, targets
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.proposals import AGES, Family, families, single
from realsim.gap.checks.contract.steps import Run, Steps

FLOOR = 0.01
"""Share of a joint's targets' spread (rms about the mean) below which differences are nobody's concern: what encoder
and rate noise of usual size leave (0.5 mrad, 0.02 rad/s; benchmarks/diagnosis/contract.py, seeds below 100)."""
LEAST_SPREAD = 0.02
"""rad: a target that moves less is judged as if it moved so much."""
NOTICED = 0.05
"""Share of a joint's spread that a mistake has to stand out of: half of what noise of a log's own sensors may leave
under a policy that answers them strongly (`check.KEPT`)."""
NOISE = {"pos": 5e-4, "vel": 0.02, "gyro": 0.01, "quat": 5e-4}
"""rad, rad/s, rad/s, 1: what sensors of usual quality add to a log, and the policy did not see. A policy that answers
it strongly leaves differences that no mistake explains."""
STANDS_OUT = 2.0
"""Times such differences that a mistake has to stand out of: they vary from log to log by less."""
PRICE = 0.2
"""Nats: beyond NOTICED, a mistake must take away a third of the variance that is left in one joint at least. Less is
what shrinkage by noise of readings and rounding of contracts to three digits reach."""
PER_PARAMETER = 0.004
"""Nats of the score: a family of as many parameters as joints must fit better by 5 % than one with a single one."""
TIE = 0.05
"""Nats of the score by which another kind may be worse and still be named beside the best."""
SAME = 0.01
"""Relative difference of all joints' scales within which two proposals are one change."""
MOST = 6
"""Mistakes one after the other."""
ITERATIONS = 6
ROUNDS = 8
"""In which each row's age is chosen beside the others'."""


@dataclass(frozen=True)
class Trial:
    """A proposal, fitted."""

    family: Family
    values: F64
    scales: F64
    """(J,) rad: root of the mean square and the floor's."""
    rivals: tuple[Trial, ...] = ()
    """Of one that was taken: what explains as much, of any kind, the best first."""

    @property
    def score(self) -> float:
        return _cost(self.scales) + PER_PARAMETER * (self.family.size + self.family.read)

    @property
    def kind(self) -> str:
        return self.family.describe(self.values)[0]

    @property
    def text(self) -> str:
        return self.family.describe(self.values)[1]

    def applied(self, loop: Loop) -> Loop:
        return self.family.change(loop, self.values)


def _cost(scales: F64) -> float:
    """Nats."""
    return float(np.mean(np.log(scales)))


class Problem:
    """Residuals of one log under one policy."""

    def __init__(self, contract: Contract, steps: Steps, blank: float = 1.0) -> None:
        self.contract, self.steps = contract, looking(contract, steps, blank)
        self.open = 0.0
        """Share of the spread that inputs which are not logged leave open: a mistake has to stand out of it."""
        skip = contract.memory + int(AGES[-1])
        self.skip = [min(skip, max(len(r.time) - 20, 0)) for r in steps.runs]
        self.commands = commands(contract, steps)
        sent = np.concatenate([c[k:] for c, k in zip(self.commands, self.skip, strict=True)])
        self.spread = np.sqrt(np.mean((sent - sent.mean(axis=0)) ** 2, axis=0))
        self.floor = FLOOR * np.maximum(self.spread, LEAST_SPREAD)

    def residual(self, loop: Loop, steps: Steps | None = None) -> F64:
        """(rows, J) rad, without the beginnings, where the histories are not known; `steps` are other readings."""
        replayed = targets(self.contract, steps or self.steps, loop)
        return np.concatenate([(c - t)[k:] for c, t, k in zip(self.commands, replayed, self.skip, strict=True)])

    def scales(self, loop: Loop) -> F64:
        """(J,) rad."""
        return self.scales_of(self.residual(loop))

    def scales_of(self, residual: F64) -> F64:
        return np.sqrt(np.mean(residual**2, axis=0) + self.floor**2)

    def noticed(self, loop: Loop) -> F64:
        """(J,) rad that a mistake beside those of a loop has to stand out of."""
        rng = np.random.default_rng(0)

        def blurred(run: Run) -> Run:
            return replace(
                run, **{k: getattr(run, k) + rng.normal(0, s, getattr(run, k).shape) for k, s in NOISE.items()}
            )

        by_noise = self.residual(loop) - self.residual(loop, self.steps.each(blurred))
        floor = max(NOTICED, self.open) * np.maximum(self.spread, LEAST_SPREAD)
        return np.maximum(floor, STANDS_OUT * np.sqrt(np.mean(by_noise**2, axis=0)))

    def worth(self, before: F64, after: F64, floor: F64) -> bool:
        """Whether scales (J,) fell by what a mistake has to explain; `floor` is `noticed` before it."""
        gain = np.log(np.hypot(before, floor) / np.hypot(after, floor))
        return bool(np.max(gain) > PRICE and _cost(after) < _cost(before))

    def left(self, loop: Loop) -> float:
        """Rms of what is left over the rms of the targets about their means, all joints together."""
        spread = np.sqrt(np.mean(np.maximum(self.spread, LEAST_SPREAD) ** 2))
        return float(np.sqrt(np.mean(self.residual(loop) ** 2)) / spread)


def search(problem: Problem, loop: Loop) -> tuple[Loop, list[Trial]]:
    """(the loop that explains the log, the mistakes in it, the largest first)."""
    start, taken = loop, list[Trial]()
    while len(taken) < MOST:
        here, floor = problem.scales(loop), problem.noticed(loop)
        if not problem.worth(here, problem.floor, floor):  # whatever a mistake would explain
            break
        tried = list(_tried(problem, start, taken, here))
        if any(t.family.size for t in taken) and tried:  # those near the best as well: what was taken is fitted to all
            near = min(t.score for t in tried) + PRICE
            tried = [_together(problem, start, [*taken, t])[-1] if t.score < near else t for t in tried]
        best = _chosen(problem, here, floor, tried)
        if best is None:
            break
        taken = _settled(problem, start, [*taken, best])
        loop = _applied(start, taken)
    for which in range(len(taken) - 2, -1, -1):  # without those that the later ones make needless
        fewer = [t for k, t in enumerate(taken) if k != which]
        before = _applied(start, fewer)
        if not problem.worth(problem.scales(before), problem.scales(_applied(start, taken)), problem.noticed(before)):
            taken = fewer
    return _applied(start, taken), taken


def _chosen(problem: Problem, here: F64, floor: F64, tried: list[Trial]) -> Trial | None:
    """The best of what is worth its price beside the scales `here` (J,) and `noticed` (J,), with its rivals.

    The same change comes in several words (minus one as a scale, and as three axes turned round): the one with the
    fewest parameters is taken, and the others are no rivals.
    """
    tried = [t for t in tried if problem.worth(here, t.scales, floor)]
    if not tried:
        return None
    least = min(tried, key=lambda t: t.score)
    best = min((t for t in tried if _same(t, least)), key=lambda t: t.family.size + t.family.read)
    near = (t for t in tried if t.score < least.score + TIE and not _same(t, least))
    return replace(best, rivals=tuple(sorted(near, key=lambda t: t.score)))


def _same(a: Trial, b: Trial) -> bool:
    return a is b or bool(np.allclose(a.scales, b.scales, rtol=SAME))


def _settled(problem: Problem, start: Loop, taken: list[Trial]) -> list[Trial]:
    """All fitted again together, and each but the last chosen again among its rivals: what came first was fitted to
    what came later too."""
    for k in range(len(taken) - 1):
        without = _applied(start, [*taken[:k], *taken[k + 1 :]])
        fits = [_together(problem, start, [*taken[:k], t, *taken[k + 1 :]]) for t in (taken[k], *taken[k].rivals)]
        best = _chosen(problem, problem.scales(without), problem.noticed(without), [fit[k] for fit in fits])
        if best is not None:
            fit = next(f for f in fits if f[k].values is best.values)
            taken = [*fit[:k], best, *fit[k + 1 :]]
    return taken


def _together(problem: Problem, start: Loop, trials: list[Trial]) -> list[Trial]:
    """All fitted at once: one after the other, a delay takes what is a filter's, and gives it back slowly."""
    last = replace(trials[-1].family, starts=(trials[-1].values,))
    whole = _fitted(problem, start, _joined(trials[:-1], last))
    assert whole is not None
    parts = np.split(whole.values, np.cumsum([t.family.size for t in trials])[:-1])
    return [replace(t, values=v, scales=whole.scales) for t, v in zip(trials, parts, strict=True)]


def _joined(taken: Sequence[Trial], last: Family) -> Family:
    """What was taken, from where it is, and another family as one family."""
    parts = [*(t.family for t in taken), last]
    here, ends = [t.values for t in taken], np.cumsum([f.size for f in parts])[:-1]

    def change(loop: Loop, x: F64) -> Loop:
        for family, values in zip(parts, np.split(x, ends), strict=True):
            loop = family.change(loop, values)
        return loop

    starts = tuple(np.concatenate([*here, s]) for s in last.starts)
    return Family(change, last.describe, starts, np.concatenate([np.full(f.size, f.step) for f in parts]))


def _applied(loop: Loop, taken: list[Trial]) -> Loop:
    for trial in taken:
        loop = trial.applied(loop)
    return loop


def _tried(problem: Problem, start: Loop, taken: list[Trial], here: F64) -> Iterator[Trial]:
    """All families, fitted; one of a single parameter beside what was taken, which may hold a part of what is its."""
    loop, first = _applied(start, taken), _cost(here)
    for family in families(problem.contract, problem.steps, loop):
        if family.size == 1 and taken:
            found = _fitted(problem, start, _joined(taken, family), first)
        else:
            found = _fitted(problem, loop, family, first if family.size else np.inf)
        if found is not None:
            yield replace(found, family=family, values=found.values[len(found.values) - family.size :])
    yield from _irregular(problem, loop)


def _fitted(problem: Problem, loop: Loop, family: Family, first: float = np.inf) -> Trial | None:
    """Gauss-Newton with a weight a joint, from the best start; None where nothing is gained on a `first` cost."""

    def residual(x: F64) -> F64:
        return problem.residual(family.change(loop, x))

    r, x = min(((residual(x), x) for x in family.starts), key=lambda start: _cost(problem.scales_of(start[0])))
    scales = problem.scales_of(r)
    for turn in range(ITERATIONS if family.size else 0):
        steps = family.step * np.eye(family.size)
        columns = [((residual(x + e) - r) / e.max() / scales).ravel() for e in steps]
        J = np.stack(columns, axis=1)
        inner = J.T @ J
        inner += 1e-9 * max(float(np.trace(inner)), 1e-12) * np.eye(family.size)
        step, before = -np.linalg.solve(inner, J.T @ (r / scales).ravel()), _cost(scales)
        for share in (1.0, 0.5, 0.2):
            there = residual(x + share * step)
            if _cost(problem.scales_of(there)) < before - 1e-4:
                break
        else:
            break
        x, r, scales = x + share * step, there, problem.scales_of(there)
        if before - _cost(scales) < 1e-3 or (turn == 0 and first - _cost(scales) < 0.01):
            break
    off = np.abs(x - family.starts[0])
    if family.size >= 4 and off.any():  # what is small beside the largest is neutral where nothing is lost by it
        for share in (0.5, 0.25, 0.1):
            fewer = np.where(off > share * off.max(), x, family.starts[0])
            there = problem.scales_of(residual(fewer))
            if _cost(there) < _cost(scales) + PER_PARAMETER:
                x, scales = fewer, there
                break
    return None if first - _cost(scales) < 0.005 else Trial(family, x, scales)


def _irregular(problem: Problem, loop: Loop) -> Iterator[Trial]:
    """Readings of which some are a step old: an age for every row, where it explains more than it costs."""
    if loop.stale is not None:
        return
    history = problem.contract.history
    pattern = [np.zeros(len(r.time)) for r in problem.steps.runs]
    scales = problem.scales(loop)

    def costs(stale: list[F64]) -> list[F64]:
        """Of every row, what it and those that still show its reading cost: rows a history apart do not meet."""
        r = problem.residual(replace(loop, stale=tuple(stale)))
        found, rows = [], 0.5 * np.sum((r / scales) ** 2, axis=1)
        for run, skip in zip(stale, problem.skip, strict=True):
            own, rows = rows[: len(run) - skip], rows[len(run) - skip :]
            found.append(np.convolve(np.concatenate([np.zeros(skip), own]), np.ones(history))[history - 1 :])
        return found

    for _ in range(ROUNDS):
        before = [p.copy() for p in pattern]
        for phase in range(history):
            turn = [np.arange(len(p)) % history == phase for p in pattern]
            now = costs(pattern)
            for age in (0.0, 1.0, 2.0):
                there = costs([np.where(t, age, p) for p, t in zip(pattern, turn, strict=True)])
                for p, t, new, old in zip(pattern, turn, there, now, strict=True):
                    better = t & (new + np.log(3.0) < old)
                    p[better], old[better] = age, new[better]
        scales = problem.scales(replace(loop, stale=tuple(pattern)))
        if all(map(np.array_equal, before, pattern)):
            break
    share = float(np.mean(np.concatenate(pattern) > 0))
    if 0.02 < share < 0.9:
        found = tuple(pattern)
        text = f"{share:.0%} of the readings are a policy step old or more: two clocks that drift, or a queue"
        # An age for each row: log 3 nats a row, spread over the joints as the score is.
        cost = np.log(3.0) / len(problem.contract.joints)
        family = single("irregular_readings", text, lambda loop: replace(loop, stale=found))
        yield Trial(family, np.zeros(0), scales * np.exp(cost * share))
