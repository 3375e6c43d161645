"""When a force acts: windows of time in which a constant force would explain what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from realsim.gap.causes.figures import GRID, LEAD, MARGIN, SHORTEST, SLIDES, TIMES
from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.leftover import deviations
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.simulation.context import base_body
from realsim.gap.simulation.edit import NEAR
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64


@dataclass(frozen=True)
class Clock:
    """From when on a window's seconds are counted in each run, and the names of its edges."""

    zero: dict[int, float]
    """Screened run -> s; a run that is left out has no force."""
    edges: tuple[str, str]
    latest: float = np.inf
    """s at which a window may begin at the latest."""

    def values(self, start: float, end: float) -> dict[str, float]:
        first, second = self.edges
        return {first: start - LEAD, second: end - start} if second == "lasts" else {first: start, second: end}


def own_time(screen: Screen) -> Clock:
    """Seconds since each run began."""
    return Clock(dict.fromkeys(range(len(screen.runs)), 0.0), ("start", "end"))


def clocks(screen: Screen) -> list[Clock]:
    """The runs' own time; and since something sudden began in them, where it does."""
    found = [own_time(screen)]
    onsets = screen.simulator.onsets
    names = [screen.simulator.case.runs[r].name for r in screen.runs]
    if any(n in onsets for n in names):
        zero = {k: onsets[n] - LEAD for k, n in enumerate(names) if n in onsets}
        found.append(Clock(zero, ("since", "lasts"), LEAD + NEAR))
    return found


def window_candidates(screen: Screen, fit: Fit, most: int = 2) -> list[tuple[float, Candidate, dict[str, float]]]:
    """(gain, candidate, start values) of forces that act for a while, where that says much more than acting always.

    The response to a force that lasts much longer than the servos' settling is nearly the constant force's response
    cut to the window, so that no further simulation is needed to find the window; the fit then simulates it.
    """
    left, weights = _left(screen, fit)
    chosen = []
    for clock in clocks(screen):
        found = _by_place(screen, clock, left, weights)
        chosen += sorted(found, key=lambda item: -item[0])[:most]
    return chosen


def _by_place(
    screen: Screen, clock: Clock, left: list[F64], weights: list[F64]
) -> list[tuple[float, Candidate, dict[str, float]]]:
    """The best window of each body's force on one clock, where it says much more than a force that acts always."""
    whole_runs = own_time(screen)
    found = []
    for name, place in dict.fromkeys((a.effect, a.place) for a in screen.atoms if lookup(a.effect).passing):
        at = {a.parameter.name: i for i, a in enumerate(screen.atoms) if (a.effect, a.place) == (name, place)}
        axes, index = tuple(at), list(at.values())  # a planar arm cannot feel a force across its plane
        info, score = _by_time(screen, clock, index, left, weights)
        total = (info, score) if clock == whole_runs else _by_time(screen, whole_runs, index, left, weights)
        scale = np.array([abs(screen.atoms[i].parameter.step) for i in index])
        whole = float(_gain(total[0].sum(axis=0), total[1].sum(axis=0), scale)[0])
        gain, start, end, force = _best_window(info, score, scale, screen.comparison.config.bin_seconds, clock.latest)
        if gain > TIMES * whole + MARGIN:
            directions = np.eye(len(screen.atoms))[:, index]
            candidate = Candidate(name, (place,), (*axes, *clock.edges), directions, axes)
            found.append((gain, candidate, dict(zip(axes, force, strict=True)) | clock.values(start, end)))
    return found


def adjusted(fitter: Fitter, fit: Fit) -> Fit:
    """The fit with the window and the size of its last cause moved to where the simulation agrees best.

    A push that lifts a foot has no response in proportion to itself, so that what is found on slopes may be off.
    """
    best = fit
    candidate = fit.causes[-1].candidate
    edges = [n for n in lookup(candidate.effect).passing if n in candidate.names]
    for size in SLIDES:
        moves = [(name, move) for name in (*edges, "force") for move in (size, -size)]
        while True:
            tried = list(fitter.each(partial(_moved, fitter, best), moves))
            misfits = [np.inf if f is None else f.misfit for f in tried]
            k = int(np.argmin(misfits))
            further = tried[k]
            if misfits[k] >= best.misfit:
                break
            while further is not None and further.misfit < best.misfit:  # what gained once mostly gains again
                best = further
                further = _moved(fitter, best, moves[k])
    return best


def at_other_bodies(screen: Screen, fitter: Fitter, fit: Fit) -> list[Fit]:
    """The fit with the force of its last cause at other bodies instead: where it does best as it is, and at the base.

    The trunk and the hips on it answer alike to a push, until its window and its size are right.
    """
    cause, others = fit.causes[-1], fit.causes[:-1]
    case = screen.simulator.case
    base = case.model.body(base_body(case)).name if case.floating else ""
    whole = max((c.names for c in screen.candidates if c.effect == cause.candidate.effect), key=len)
    like = [c for c in screen.candidates if c.effect == cause.candidate.effect and c.names == whole]
    elsewhere = [replace(c, names=cause.candidate.names) for c in like if c.places != cause.candidate.places]
    moved = fitter.each(lambda c: fitter.looked_at(fit, (*others, Cause(c, cause.values))), elsewhere)
    fits = sorted((f for f in moved if f is not None), key=lambda f: f.misfit)
    return fits[:1] + [f for f in fits[1:] if f.causes[-1].candidate.place == (base,)]


def _moved(fitter: Fitter, fit: Fit, change: tuple[str, float]) -> Fit | None:
    """With an edge moved by so many seconds, or the force by this share; None if that cannot be."""
    name, move = change
    cause = fit.causes[-1]
    if name == "since" and abs(cause.named[name] + move) > NEAR:
        return None
    if name == "force":
        passing = lookup(cause.candidate.effect).passing
        values = tuple(v if n in passing else v * (1 + move) for n, v in cause.named.items())
    else:
        values = tuple(v + move * (n == name) for n, v in cause.named.items())
    return fitter.looked_at(fit, (*fit.causes[:-1], replace(cause, values=values)))


def _left(screen: Screen, fit: Fit) -> tuple[list[F64], list[F64]]:
    x = deviations(screen, fit)
    left, weights = [], []
    for k, run in enumerate(screen.runs):
        r = screen.comparison.residual(run, fit.predictions[k])
        weights.append(np.where(np.isfinite(r), screen.comparison.weights[run], 0.0))
        left.append(np.nan_to_num(r) - screen.fitted(k, fit.evidence.centre + x - fit.about))
    return left, weights


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
    shortest, step = int(SHORTEST / width), max(int(GRID / width), 1)

    def best(starts: Any, ends: Any) -> tuple[float, int, int, F64]:
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
