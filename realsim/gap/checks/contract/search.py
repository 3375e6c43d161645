"""One search for what differs between a loop and its contract: one score, a mistake after the other.

Score: the mean over joints of log(rms of sent less replayed targets + floor), in nats. Of all proposals, each fitted,
the one with the best score is taken if it is worth PRICE; it is applied, and the search goes on. At the end, each that
is taken is left out once, and stays out if it is no longer worth PRICE.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.types import F64
from realsim.gap.checks.contract.loop import Loop, commands, targets
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.proposals import Family, families
from realsim.gap.checks.contract.steps import Steps

FLOOR = 0.01
"""Share of a joint's targets' spread (rms about the mean) below which differences are nobody's concern: what encoder
and rate noise of usual size leave (0.5 mrad, 0.02 rad/s; benchmarks/diagnosis/contract.py, seeds below 100)."""
LEAST_SPREAD = 0.02
"""rad: a target that moves less is judged as if it moved so much."""
NOTICED = 0.05
"""Share of a joint's spread that a mistake has to stand out of: half of what noise of a log's own sensors may leave
under a policy that answers them strongly (`check.KEPT`)."""
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


@dataclass(frozen=True)
class Trial:
    """A proposal, fitted."""

    family: Family
    values: F64
    loop: Loop
    scales: F64
    """(J,) rad: root of the mean square and the floor's."""

    @property
    def score(self) -> float:
        return float(np.mean(np.log(self.scales))) + PER_PARAMETER * self.family.size

    @property
    def kind(self) -> str:
        return self.family.tell(self.values)[0]

    @property
    def text(self) -> str:
        return self.family.tell(self.values)[1]


@dataclass(frozen=True)
class Taken:
    """A mistake that the search has taken, and what explains as much."""

    trial: Trial
    rivals: tuple[Trial, ...]


class Problem:
    """Residuals of one log under one policy."""

    def __init__(self, contract: Contract, steps: Steps) -> None:
        self.contract, self.steps = contract, steps
        self.open = 0.0
        """Share of the spread that inputs which are not logged leave open: a mistake has to stand out of it."""
        skip = contract.memory
        self.skip = [min(skip, max(len(r.time) - 20, 0)) for r in steps.runs]
        self.commands = commands(contract, steps)
        sent = np.concatenate([c[k:] for c, k in zip(self.commands, self.skip, strict=True)])
        self.spread = np.sqrt(np.mean((sent - sent.mean(axis=0)) ** 2, axis=0))
        self.floor = FLOOR * np.maximum(self.spread, LEAST_SPREAD)

    def residual(self, loop: Loop) -> F64:
        """(rows, J) rad, without the beginnings, where the histories are not known."""
        replayed = targets(self.contract, self.steps, loop)
        return np.concatenate([(c - t)[k:] for c, t, k in zip(self.commands, replayed, self.skip, strict=True)])

    def scales(self, residual: F64) -> F64:
        return np.sqrt(np.mean(residual**2, axis=0) + self.floor**2)

    def worth(self, before: F64, after: F64) -> bool:
        """Whether scales (J,) fell by what a mistake has to explain."""
        floor = max(NOTICED, self.open) * np.maximum(self.spread, LEAST_SPREAD)
        one, other = np.hypot(before, floor), np.hypot(after, floor)
        return bool(np.max(np.log(one / other)) > PRICE and np.mean(np.log(after)) < np.mean(np.log(before)))

    def left(self, loop: Loop) -> float:
        """Rms of what is left over the rms of the targets about their means, all joints together."""
        spread = np.sqrt(np.mean(np.maximum(self.spread, LEAST_SPREAD) ** 2))
        return float(np.sqrt(np.mean(self.residual(loop) ** 2)) / spread)


def search(problem: Problem, loop: Loop) -> tuple[Loop, list[Taken]]:
    """(the loop that explains the log, the mistakes in it, the largest first)."""
    taken: list[Taken] = []
    trials: list[Trial] = []
    while len(taken) < MOST:
        here = problem.scales(problem.residual(loop))
        tried = sorted(_tried(problem, loop, here), key=lambda t: t.score)
        if not tried or not problem.worth(here, tried[0].scales):
            break
        best = tried[0]
        near = [t for t in tried[1:] if t.score < best.score + TIE and t.kind != best.kind]
        # The same change in other words (minus one as a scale, and as three axes turned round) is no rival.
        near = [t for t in near if not np.allclose(t.scales, best.scales, rtol=SAME)]
        rivals = {t.kind: t for t in reversed(near) if problem.worth(here, t.scales)}
        taken.append(Taken(best, tuple(rivals.values())))
        loop = best.loop
        trials.append(best)
    return _pruned(problem, taken)


def _pruned(problem: Problem, taken: list[Taken]) -> tuple[Loop, list[Taken]]:
    """Without the mistakes that the others make needless."""
    base = Loop(blank=taken[0].trial.loop.blank) if taken else Loop()
    for which in range(len(taken) - 2, -1, -1):
        whole = _applied(base, taken)
        fewer = [t for k, t in enumerate(taken) if k != which]
        if not problem.worth(
            problem.scales(problem.residual(_applied(base, fewer))), problem.scales(problem.residual(whole))
        ):
            taken = fewer
    return _applied(base, taken), taken


def _applied(loop: Loop, taken: list[Taken]) -> Loop:
    for t in taken:
        loop = t.trial.family.change(loop, t.trial.values)
    return loop


def _tried(problem: Problem, loop: Loop, here: F64) -> Iterator[Trial]:
    for family in families(problem.contract, problem.steps, loop):
        if not family.size:
            changed = family.change(loop, family.starts[0])
            yield Trial(family, family.starts[0], changed, problem.scales(problem.residual(changed)))
            continue
        found = _fitted(problem, loop, family, here)
        if found is not None:
            yield found
    yield from _irregular(problem, loop)


def _fitted(problem: Problem, loop: Loop, family: Family, here: F64) -> Trial | None:
    """Gauss-Newton with a weight a joint, from the best start; None where the first step gains nothing."""

    def look(x: F64) -> tuple[F64, F64]:
        residual = problem.residual(family.change(loop, x))
        return residual, problem.scales(residual)

    def cost(scales: F64) -> float:
        return float(np.mean(np.log(scales)))

    x = min(family.starts, key=lambda start: cost(look(start)[1]))
    residual, scales = look(x)
    first = cost(here)
    for turn in range(ITERATIONS):
        weight = 1 / scales
        slopes = np.stack(
            [((look(x + family.step * e)[0] - residual) / family.step * weight).ravel() for e in np.eye(family.size)],
            axis=1,
        )
        inner = slopes.T @ slopes
        inner += 1e-9 * max(float(np.trace(inner)), 1e-12) * np.eye(family.size)
        step = -np.linalg.solve(inner, slopes.T @ (residual * weight).ravel())
        for share in (1.0, 0.5, 0.2):
            there = look(x + share * step)
            if cost(there[1]) < cost(scales) - 1e-4:
                break
        else:
            break
        gained = cost(scales) - cost(there[1])
        x, (residual, scales) = x + share * step, there
        if gained < 1e-3 or (turn == 0 and first - cost(scales) < 0.01):
            break
    x, scales = _sparse(x, scales, look, family)
    if first - cost(scales) < 0.005:
        return None
    return Trial(family, x, family.change(loop, x), scales)


def _sparse(x: F64, scales: F64, look: Callable[[F64], tuple[F64, F64]], family: Family) -> tuple[F64, F64]:
    """Parameters that are small beside the largest become neutral where nothing is lost by it."""
    neutral = family.starts[0]
    off = np.abs(x - neutral)
    if family.size < 4 or not off.any():
        return x, scales
    for share in (0.5, 0.25, 0.1):
        fewer = np.where(off > share * off.max(), x, neutral)
        there = look(fewer)[1]
        if np.mean(np.log(there)) < np.mean(np.log(scales)) + PER_PARAMETER:
            return fewer, there
    return x, scales


def _irregular(problem: Problem, loop: Loop) -> Iterator[Trial]:
    """Readings of which some are a step old: an age for every row, where it explains more than it costs."""
    if loop.stale is not None:
        return
    history = problem.contract.history
    pattern = [np.zeros(len(r.time)) for r in problem.steps.runs]
    spans = np.cumsum([0, *(len(p) - k for p, k in zip(pattern, problem.skip, strict=True))])
    scales = problem.scales(problem.residual(loop))

    def costs(stale: list[F64]) -> F64:
        r = problem.residual(replace(loop, stale=tuple(stale)))
        return 0.5 * np.sum((r / scales) ** 2, axis=1)

    for _ in range(3):
        for phase in range(history):
            now = costs(pattern)
            for age in (0.0, 1.0, 2.0):
                other = [np.where(np.arange(len(p)) % history == phase, age, p) for p in pattern]
                better = costs(other) + np.log(3.0) < now
                for k, p in enumerate(pattern):
                    rows = np.zeros(len(p), bool)
                    rows[problem.skip[k] :] = better[spans[k] : spans[k + 1]]
                    rows &= np.arange(len(p)) % history == phase
                    p[rows] = age
                now = costs(pattern)
        scales = problem.scales(problem.residual(replace(loop, stale=tuple(pattern))))
    share = float(np.mean(np.concatenate(pattern) > 0))
    if 0.02 < share < 0.9:
        found = tuple(pattern)
        text = f"{share:.0%} of the readings are a policy step old or more: two clocks that drift, or a queue"
        family = Family(lambda loop, _: replace(loop, stale=found), lambda _: ("irregular_readings", text))
        # An age for each row: log 3 nats a row, spread over the joints as the score is.
        cost = np.log(3.0) / len(problem.contract.joints)
        yield Trial(family, np.zeros(0), replace(loop, stale=found), scales * np.exp(cost * share))
