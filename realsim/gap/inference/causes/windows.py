"""When a force acts: windows of time in which a constant force would explain what is left."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.case.model.edit import NEAR
from realsim.gap.effects.base import Place
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fit import Fit
from realsim.gap.inference.causes.fitted import rests
from realsim.gap.inference.likelihood.screen import Candidate, Screen


@dataclass(frozen=True)
class Clock:
    """From when on a window's seconds are counted in each run, and the names of its edges."""

    zero: dict[int, float]
    """Screened run -> s; a run that is left out has no force."""
    edges: tuple[str, str]
    latest: float = np.inf
    """s at which a window may begin at the latest."""

    def values(self, start: float, end: float) -> tuple[float, float]:
        return (start, end) if self.latest == np.inf else (start - figures.BRIEF, end - start)


def clocks(screen: Screen, onsets: Mapping[str, float]) -> list[Clock]:
    """The runs' own time; and since something sudden began in them, where it does."""
    names = [screen.simulator.case.runs[r].name for r in screen.runs]
    since = {k: onsets[n] - figures.BRIEF for k, n in enumerate(names) if n in onsets}
    own = Clock(dict.fromkeys(range(len(screen.runs)), 0.0), ("start", "end"))
    return [own, Clock(since, ("since", "lasts"), figures.BRIEF + NEAR)] if since else [own]


def window_candidates(screen: Screen, fit: Fit, most: int = 2) -> list[tuple[float, Candidate, dict[str, float]]]:
    """(gain, candidate, start values) of forces that act for a while, where that says more than acting always: the
    best few bodies on each clock.

    The response to a force that lasts much longer than the servos' settling is nearly the constant force's response
    cut to the window, so that no further simulation is needed to find the window; the fit then simulates it.
    """
    left, weights = _left(screen, fit)
    chosen, always = [], dict[tuple[str, Place], float]()
    for clock in clocks(screen, fit.conditions.onsets):
        found = []
        for name, place in dict.fromkeys((a.effect, a.place) for a in screen.atoms if lookup(a.effect).law.passing):
            candidate, index = _candidate(screen, name, place, clock.edges)
            info, score = _by_time(screen, clock, index, left, weights)
            scale = np.array([abs(screen.atoms[i].parameter.step) for i in index])
            whole = always.setdefault((name, place), float(_gain(info.sum(axis=0), score.sum(axis=0), scale)[0]))
            width = screen.comparison.config.bin_seconds
            gain, start, end, force = _best_window(info, score, scale, width, clock.latest)
            if gain > whole + figures.NEAR:
                values = zip(candidate.names, (*force, *clock.values(start, end)), strict=True)
                found.append((gain, candidate, dict(values)))
        chosen += sorted(found, key=lambda item: -item[0])[:most]
    return chosen


def _candidate(screen: Screen, name: str, place: Place, edges: tuple[str, ...]) -> tuple[Candidate, list[int]]:
    """(a force with these edges, the atoms of its axes): a planar arm cannot feel a force across its plane."""
    at = {a.parameter.name: i for i, a in enumerate(screen.atoms) if (a.effect, a.place) == (name, place)}
    every = {p.name: p for p in lookup(name).parameters(screen.simulator.context, place)}
    parameters, index = tuple(every[n] for n in (*at, *edges)), list(at.values())
    return Candidate(name, (place,), parameters, np.eye(len(screen.atoms))[:, index], tuple(at)), index


def _left(screen: Screen, fit: Fit) -> tuple[list[F64], list[F64]]:
    left = rests(screen, fit)
    weights = [fit.conditions.weights.of[run] for run in screen.runs]
    weights = [np.where(np.isfinite(r), w, 0.0) for r, w in zip(left, weights, strict=True)]
    return [np.nan_to_num(r) for r in left], weights


def _by_time(screen: Screen, clock: Clock, index: list[int], left: list[F64], weights: list[F64]) -> tuple[F64, F64]:
    """(T, m, m) information and (T, m) score of the force in each bin of a clock's time, all its runs together."""
    width = screen.comparison.config.bin_seconds
    times = {k: screen.comparison.times[screen.runs[k]] - zero for k, zero in clock.zero.items()}
    last = max(int(t[-1] / width) for t in times.values()) + 1
    m = len(index)
    info, score = np.zeros((last, m, m)), np.zeros((last, m))
    for k, t in times.items():
        D = screen.columns(k, index).reshape(*weights[k].shape, len(index)).astype(float)
        inside = t >= 0
        at = np.clip((t[inside] / width).astype(int), 0, last - 1)
        W = (weights[k][:, :, None] * D)[inside]
        np.add.at(info, at, np.einsum("bci,bcj->bij", W, D[inside]))
        np.add.at(score, at, np.einsum("bci,bc->bi", W, left[k][inside]))
    return info, score


def _gain(info: F64, score: F64, scale: F64) -> tuple[F64, F64]:
    """(...) gains and (..., m) forces of many windows at once, from (..., m, m) information and (..., m) scores."""
    force = np.linalg.solve(info + np.diag(0.02 / scale**2), score[..., None])[..., 0]
    return 0.5 * np.sum(score * force, axis=-1), np.asarray(force, np.float64)


def _best_window(
    info: F64, score: F64, scale: F64, width: float, latest: float = np.inf
) -> tuple[float, float, float, F64]:
    """(gain, start, end, force) of the window in which a constant force says most, begun at the `latest` then."""
    zero = np.zeros((1, *info.shape[1:]))
    total, tally = np.cumsum(np.concatenate([zero, info]), axis=0), np.cumsum(np.vstack([zero[:, 0], score]), axis=0)
    shortest, step = int(figures.BRIEF / width), max(int(figures.BRIEF / 2 / width), 1)

    def best(starts: NDArray[np.int64], ends: NDArray[np.int64]) -> tuple[float, int, int, F64]:
        first, last = (a.ravel() for a in np.meshgrid(starts, ends, indexing="ij"))
        long = (last - first >= min(shortest, len(info))) & (first * width <= latest)
        first, last = first[long], last[long]
        gain, force = _gain(total[last] - total[first], tally[last] - tally[first], scale)
        k = int(np.argmax(gain))
        return float(gain[k]), int(first[k]), int(last[k]), force[k]

    edges = np.unique(np.append(np.arange(0, len(info), step), len(info)))
    _, start, end, _ = best(edges, edges)
    near = np.arange(-step, step + 1)
    gain, start, end, force = best(*(np.unique(np.clip(near + at, 0, len(info))) for at in (start, end)))
    return gain, start * width, end * width, force
