"""The two logs fitted jointly: what the robot has at both times, and a change that only the later log shows.

The earlier log's causes are found first, and hold for both. About them the residual of all runs is taken as
r = G x + [now] G d + [now] H c + e: everyday deviations x that stay, small ones d that come from day to day, and a
change c of one effect at one place. With x and d integrated out, the evidence of every possible change is linear
algebra, as in `realsim.gap.inference.likelihood.screen`; the best are fitted by simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.effects.base import Parameter
from realsim.gap.inference.causes.fitted import Cause, spread
from realsim.gap.inference.likelihood.linear import Evidence, log_evidence, marginal, posterior
from realsim.gap.inference.likelihood.screen import Candidate, Screen, slab
from realsim.gap.simulation.simulate import Setting

DAILY = 0.5
"""Standard deviation of what comes and goes from day to day, as a share of the everyday deviations between robots: a
joint's friction differs by some percent between a cold and a warm morning. Not tuned."""
SHARED_STEPS = 2.0
"""Standard deviations of its fit by which a value that both logs share may still move: one log alone gave it."""
ITERATIONS = 5


@dataclass(frozen=True)
class Changed:
    """Changes at their best values, beside what both logs share."""

    causes: tuple[Cause, ...]
    """Values are changes of the coordinates since the earlier log."""
    misfit: float
    covariance: F64
    """(m, m) of all values in a row."""
    evidence: Evidence
    """Of all runs, over 2p unknowns: deviations that stay, then those of the later log alone."""
    prior: F64
    """(2p,)"""
    predictions: tuple[F64, ...]


class Joint:
    """Fits changes on the runs of a screen, of which some are the later log's."""

    def __init__(self, screen: Screen, shared: Sequence[Cause], covariance: F64, now: Sequence[int]) -> None:
        """`now`: positions among the screened runs; `shared`: causes of both logs, `covariance` of their values."""
        self.screen, self.shared = screen, list(shared)
        self.now = set(now)
        self.stays = screen.prior.copy()
        errors = list(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
        for cause in self.shared:
            c = cause.candidate
            for name in c.names:
                sigma = SHARED_STEPS * errors.pop(0)
                atoms = [screen.index.get((c.effect, place, name)) for place in c.places]
                for i in (i for i in atoms if i is not None):
                    self.stays[i] = max(self.stays[i], sigma)

    def nothing(self) -> Changed:
        """No change at all."""
        found = self.at((), np.zeros(0))
        assert found is not None
        return found

    def ranked(self, current: Changed) -> list[tuple[float, Candidate, F64]]:
        """(gain in log-evidence, candidate, estimate) of every further change, the best first."""
        p = len(self.stays)
        A, b, _ = marginal(current.evidence, current.prior, np.inf)
        taken = {(c.candidate.effect, q) for c in current.causes for q in c.candidate.places}
        found = []
        for candidate in self.screen.candidates:
            if any((candidate.effect, q) in taken for q in candidate.places):
                continue
            gain, estimate = log_evidence(A[p:, p:], b[p:], candidate.directions, slab(candidate))
            found.append((gain, candidate, estimate))
        return sorted(found, key=lambda item: -item[0])

    def fit(self, causes: Sequence[Cause], iterations: int = ITERATIONS) -> Changed | None:
        """The best values near those given, by Gauss-Newton over the simulation; None where it cannot run."""
        candidates = [c.candidate for c in causes]
        parameters = [p for c in candidates for p in c.parameters]
        low, high = self._bounds(candidates, parameters)
        z = np.clip(np.array([v for c in causes for v in c.values]), low, high)
        here = self.at(candidates, z)
        for factor in (0.5, 0.25):
            if here is None:
                z = factor * z
                here = self.at(candidates, z)
        if here is None:
            return None
        local = self._local(candidates, z, parameters, here)
        for _ in range(iterations):
            if local is None:
                break
            info, scores = local
            scale = np.array([2 * abs(q.step) for q in parameters])
            step = np.linalg.solve(info + np.diag(1e-3 / scale**2), scores.sum(axis=0))
            better = None
            for share in (1.0, 0.5, 0.2, 0.05):
                there = np.clip(z + share * step, low, high)
                trial = self.at(candidates, there)
                if trial is not None and trial.misfit < here.misfit - 0.01:
                    better = trial, there
                    break
            if better is None:
                break
            gained = here.misfit - better[0].misfit
            here, z = better
            local = self._local(candidates, z, parameters, here)
            if gained < 0.1:
                break
        if local is None:
            return None
        return Changed(
            here.causes, here.misfit, spread(*local, parameters), here.evidence, here.prior, here.predictions
        )

    def at(self, candidates: Sequence[Candidate], z: F64) -> Changed | None:
        """The changes at these very values."""
        causes, row = [], list(z)
        for c in candidates:
            causes.append(Cause(c, tuple(float(row.pop(0)) for _ in c.names)))
        predictions = self._simulated(causes)
        if predictions is None:
            return None
        evidence = self._evidence(predictions)
        prior = self._prior(candidates)
        mean, _ = posterior(np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0), prior)
        misfit = 0.5 * float(sum(evidence.c) - np.sum(evidence.b, axis=0) @ mean)
        m = len(z)
        return Changed(tuple(causes), misfit, np.zeros((m, m)), evidence, prior, tuple(predictions))

    def gains(self, before: Changed, after: Changed) -> F64:
        """(n,) gain of each run of the later log when deviations are taken from all the others."""
        found = []
        for k in sorted(self.now):
            others = [i for i in range(len(self.screen.runs)) if i != k]
            found.append(self._unseen(before, others, k) - self._unseen(after, others, k))
        return np.array(found)

    def left(self, found: Changed) -> tuple[F64, F64]:
        """(earlier, later) mean squares in units of the floor that stay beside changes and deviations, by run."""
        x = posterior(np.sum(found.evidence.A, axis=0), np.sum(found.evidence.b, axis=0), found.prior)[0]
        p = len(self.stays)
        rows: tuple[list[float], list[float]] = ([], [])
        for k, run in enumerate(self.screen.runs):
            moved = x[:p] + (x[p:] if k in self.now else 0.0)
            r = self.screen.comparison.residual(run, found.predictions[k]) - self.screen.fitted(k, moved)
            rows[k in self.now].append(float(np.nanmean(r**2 / self.screen.comparison.floor(run))))
        return np.array(rows[0]), np.array(rows[1])

    def has(self, candidate: Candidate) -> bool:
        """Whether the earlier log has this effect there already."""
        return any(
            c.candidate.effect == candidate.effect and set(candidate.places) <= set(c.candidate.places)
            for c in self.shared
        )

    def before(self, candidate: Candidate) -> dict[str, float]:
        """Coordinates of an effect at a place in the earlier log: those of a shared cause, or its defaults."""
        values = {p.name: p.default for p in candidate.parameters}
        for cause in self.shared:
            if cause.candidate.effect == candidate.effect and set(candidate.places) <= set(cause.candidate.places):
                values |= {n: v for n, v in cause.named.items() if n in values}
        return values

    # ------------------------------------------------------------ inside

    def _settings(self, causes: Sequence[Cause]) -> list[Setting]:
        """The shared causes with the changes on top, coordinate by coordinate."""
        found: dict[tuple[str, tuple[str, ...]], dict[str, float]] = {}
        for cause in self.shared:
            for effect, place, values in cause.settings():
                found[effect, place] = dict(values)
        for cause in causes:
            start = self.before(cause.candidate)
            for effect, place, values in cause.settings():
                here = found.setdefault((effect, place), {})
                for name, change in values.items():
                    here[name] = here.get(name, start[name]) + change
        return [(effect, place, values) for (effect, place), values in found.items()]

    def _simulated(self, causes: Sequence[Cause]) -> list[F64] | None:
        screen = self.screen
        earlier = [run for k, run in enumerate(screen.runs) if k not in self.now]
        later = [run for k, run in enumerate(screen.runs) if k in self.now]
        try:
            then = screen.simulator.simulate(self._settings(()), runs=earlier)
            now = screen.simulator.simulate(self._settings(causes), runs=later)
        except GapError:
            return None
        if not all(np.isfinite(y).all() for y in (*then, *now)):
            return None
        rows = {False: iter(then), True: iter(now)}
        return [next(rows[k in self.now]) for k in range(len(screen.runs))]

    def _evidence(self, predictions: Sequence[F64]) -> Evidence:
        """Normal equations over (x, d), a run each."""
        one = self.screen.evidence(predictions)
        if np.any(one.centre):
            one = one.moved(-np.asarray(one.centre))
        p = len(self.stays)
        A, b = [], []
        for k, (a, s) in enumerate(zip(one.A, one.b, strict=True)):
            whole, right = np.zeros((2 * p, 2 * p)), np.zeros(2 * p)
            whole[:p, :p], right[:p] = a, s
            if k in self.now:
                whole[p:, :p] = whole[:p, p:] = whole[p:, p:] = a
                right[p:] = s
            A.append(whole)
            b.append(right)
        return Evidence(A, b, one.c, runs=one.runs)

    def _prior(self, candidates: Sequence[Candidate]) -> F64:
        """(2p,) of both kinds of deviations; what is a change is none from day to day."""
        daily = DAILY * self.screen.prior
        for c in candidates:
            daily[self.screen.atoms_of(c)] = 0.0
        return np.concatenate([self.stays, daily])

    def _bounds(self, candidates: Sequence[Candidate], parameters: Sequence[Parameter]) -> tuple[F64, F64]:
        start = [v for c in candidates for v in self.before(c).values()]
        low, high = np.array([p.bounds for p in parameters]).T
        return low - start, high - start

    def _local(
        self, candidates: Sequence[Candidate], z: F64, parameters: Sequence[Parameter], here: Changed
    ) -> tuple[F64, F64] | None:
        """(information (m, m), scores (later runs, m)) of the values, deviations integrated out."""
        screen, runs = self.screen, sorted(self.now)
        low, high = self._bounds(candidates, parameters)
        columns: list[list[F64]] = [[] for _ in runs]
        for i, p in enumerate(parameters):
            width = 0.1 * abs(p.step)
            there = z.copy()
            there[i] += width if z[i] + width <= high[i] else -width
            moved = self.at(candidates, np.clip(there, low, high))
            if moved is None or there[i] == z[i]:
                return None
            for row, k in enumerate(runs):
                change = screen.comparison.change(screen.runs[k], moved.predictions[k], here.predictions[k])
                columns[row].append(change.reshape(-1) / (there[i] - z[i]))
        count = len(self.stays)
        cov = posterior(np.sum(here.evidence.A, axis=0), np.zeros(2 * count), here.prior)[1]
        mean = cov @ np.sum(here.evidence.b, axis=0)
        info = np.zeros((len(z), len(z)))
        cross = np.zeros((len(z), 2 * count))
        scores = []
        for row, k in enumerate(runs):
            H, W = np.stack(columns[row], axis=1), screen.comparison.weights[screen.runs[k]].reshape(-1)
            r = np.nan_to_num(screen.comparison.residual(screen.runs[k], here.predictions[k]).reshape(-1))
            HG = H.T @ screen.weighted(k)
            info += (H * W[:, None]).T @ H
            cross[:, :count] += HG
            cross[:, count:] += HG
            scores.append(H.T @ (W * r) - HG @ (mean[:count] + mean[count:]))
        return info - cross @ cov @ cross.T, np.array(scores)

    def _unseen(self, found: Changed, others: Sequence[int], k: int) -> float:
        e = found.evidence
        A, b = np.sum([e.A[i] for i in others], axis=0), np.sum([e.b[i] for i in others], axis=0)
        x = posterior(A, b, found.prior)[0]
        return 0.5 * float(e.c[k] - 2 * e.b[k] @ x + x @ e.A[k] @ x)
