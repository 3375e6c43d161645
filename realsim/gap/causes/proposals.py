"""Where the search looks next: functions of one signature, from a set of causes to sets that may explain more."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from realsim.gap.causes.figures import (
    ALIKE,
    ALONE,
    FINALISTS,
    FORETOLD,
    MORE,
    MOST_ALIKE,
    MOST_ALONE,
    SMALL,
    WORTH,
    WORTH_SHARE,
)
from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.leftover import is_gap, leftover
from realsim.gap.causes.linear import log_evidence, marginal
from realsim.gap.causes.probes import alone, probed, probed_footing, probed_ground
from realsim.gap.causes.score import near
from realsim.gap.causes.screen import Candidate, Screen, slab
from realsim.gap.causes.starts import Guess, contains, extended, fullest, nested, starts, suggested
from realsim.gap.causes.windows import window_candidates
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

Scored = tuple[float, Candidate, F64]
"""(gain in log evidence by the linear screen, candidate, estimate of its linear parameters)."""


@dataclass(frozen=True)
class Proposal:
    """A set of causes with values to search from."""

    causes: tuple[Cause, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    """Further values of all causes in a row."""
    foretold: float = 0.0
    """Gain in log evidence by the linear screen, where there is one."""


Propose = Callable[[Fitter, Fit], Iterator[Proposal]]


def by_slopes(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: the best places of the best effects by the linear screen."""
    screen = fitter.screen
    order = ranked(screen, here)
    best = order[0][0] if order else 0.0
    least = max(WORTH, WORTH_SHARE * best)  # far behind, only what is far from linear can still win
    chosen: list[Candidate] = []
    for gain, candidate, estimate in order:
        count = sum(c.effect == candidate.effect for c in chosen)
        most = 1 if len(chosen) >= FINALISTS else 3 if len(chosen) < 3 else 2
        if gain < least or len(chosen) == FINALISTS + MORE:
            break
        if count < most and not any(nested(candidate, c) for c in chosen):
            chosen.append(candidate)
            yield _further(fitter, here, candidate, estimate, gain)


def by_size(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: what explains much of the gap all by itself, when no nuisance parameter shares it."""
    screen = fitter.screen
    total = 0.5 * float(sum(here.evidence.c))
    best: dict[str, Scored] = {}
    for gain, c, estimate in alone(screen, here, screen.candidates):
        if gain > max(ALONE * total, best.get(c.effect, (0.0,))[0]) and not _taken(c, here):
            best[c.effect] = gain, c, estimate
    for gain, c, estimate in sorted(best.values(), key=lambda item: -item[0])[:MOST_ALONE]:
        yield _further(fitter, here, c, estimate, gain)


def by_window(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: a force that acts for a while."""
    for gain, candidate, values in window_candidates(fitter.screen, here):
        if not here.has(candidate.effect, candidate.place):
            yield _further(fitter, here, candidate, values, gain)


def by_simulation(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: what slopes do not foretell, looked at by simulation at a few sizes."""
    screen = fitter.screen
    order = ranked(screen, here)
    free = [c for _, c, _ in order]
    found = [*probed_ground(screen, fitter, here, free), *probed_footing(screen, fitter, here, free)]
    foretold = bool(order) and order[0][0] > FORETOLD * here.misfit
    if not foretold and leftover(screen, here).mean() > SMALL:
        found += probed(screen, fitter, here, free)
    for gain, candidate, values in found:
        yield _further(fitter, here, candidate, values, gain)


def by_likeness(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """Another cause in the place of each: what does the same to first order, and what is as likely beside the rest."""
    screen = fitter.screen
    for i, cause in enumerate(here.causes):
        others = _others(here, i)
        found = _alike(fitter, here, cause)
        rest = fitter.fit(others, iterations=2) if others else fitter.looked_at(here, ())
        order = ranked(screen, rest) if rest is not None else []
        own = next((gain for gain, c, _ in order if c.key == cause.candidate.key), 0.0)
        likely = [(c, e) for gain, c, e in order if gain > max(own - near(own), 0.0) and not _taken(c, here)]
        for c, estimate in likely[:MOST_ALIKE]:
            if c.names == c.linear:
                found.append(Cause(c, tuple(float(x) for x in estimate)))
        for other in found:
            yield Proposal((*others, other))


def by_simulation_instead(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """Another cause in the place of each, by simulation: where feet slip and land, slopes foretell little, and what
    sets a foot higher (the ground, an encoder) looks like the other until it is simulated."""
    screen = fitter.screen
    if not screen.simulator.context.touches:
        return
    gap = is_gap(leftover(screen, here))
    for i, cause in enumerate(here.causes):
        effect = lookup(cause.candidate.effect)
        rest = fitter.looked_at(here, _others(here, i))
        if rest is not None and (gap or effect.scope == "terrain" or cause.candidate.names == effect.footing):
            yield from (p for p in by_simulation(fitter, rest) if p.causes[-1].candidate.key != cause.candidate.key)


def by_effect(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """Another cause in the place of each: what its effect suggests, which is one that does the same by its nature, the
    same at another place, or other values of its own."""
    for i, cause in enumerate(here.causes):
        for candidate, values in suggested(fitter.screen, cause):
            if not contains(candidate, cause.candidate):
                yield _instead(here, i, candidate, values)


def by_widening(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """Each cause with all its effect's parameters, or as a special case of the law that contains it."""
    for i, cause in enumerate(here.causes):
        full = fullest(fitter.screen, cause.candidate)
        if full is not None:
            yield _instead(here, i, full, [list(extended(fitter.screen, cause, full).values)])
        for candidate, values in suggested(fitter.screen, cause):
            if contains(candidate, cause.candidate):
                yield _instead(here, i, candidate, values)


def _instead(here: Fit, i: int, candidate: Candidate, values: Sequence[Sequence[float]]) -> Proposal:
    """A candidate in the place of the i-th cause, from some values of its parameters."""
    others = _others(here, i)
    done = tuple(v for c in others for v in c.values)
    first, *more = values
    return Proposal((*others, Cause(candidate, tuple(first))), tuple((*done, *v) for v in more))


def ranked(screen: Screen, here: Fit) -> list[Scored]:
    """All candidates by the linear evidence that they add to a set, best first."""
    about = [marginal(e, here.prior) for e in screen.centred(here.evidence)]
    least = min(misfit for _, _, misfit in about)
    taken = {(c.candidate.effect, p) for c in here.causes for p in c.candidate.places}
    found = []
    for candidate in screen.candidates:
        if any(
            (candidate.effect, p) in taken or (lookup(candidate.effect).plain, p) in taken for p in candidate.places
        ):
            continue  # a law that contains one of the causes takes its place: see `by_widening`
        size = slab(candidate, screen)
        scored = [(*log_evidence(A, b, candidate.directions, size)[:2], misfit - least) for A, b, misfit in about]
        gain, estimate = max(((gain - behind, estimate) for gain, estimate, behind in scored), key=lambda g: g[0])
        found.append((gain, candidate, estimate))
    return sorted(found, key=lambda item: -item[0])


def _further(fitter: Fitter, here: Fit, candidate: Candidate, guess: Guess, gain: float) -> Proposal:
    """The candidate beside the causes."""
    first, *more = starts(fitter.screen, candidate, guess)
    done = [v for c in here.causes for v in c.values]
    return Proposal((*here.causes, Cause(candidate, tuple(first))), tuple((*done, *s) for s in more), gain)


def _alike(fitter: Fitter, here: Fit, cause: Cause) -> list[Cause]:
    """Causes whose sensitivities span what this one does: by the squared cosine of the angle between them."""
    A = np.sum(here.evidence.A, axis=0)
    v = cause.candidate.directions @ np.array([cause.named[n] for n in cause.candidate.linear])
    size = float(v @ A @ v)
    found: list[Scored] = []
    for c in fitter.screen.candidates:
        if size <= 0 or c.names != c.linear or _taken(c, here):
            continue
        D = c.directions
        inside, info = D.T @ A @ v, D.T @ A @ D
        if np.trace(info) <= 0:  # it does nothing where errors count, as in runs that were cut at a fall
            continue
        coefficients = np.linalg.solve(info + 1e-9 * np.trace(info) * np.eye(len(info)), inside)
        share = float(inside @ coefficients) / size
        if share > ALIKE:
            found.append((share - 0.01 * len(c.names), c, coefficients))
    first: dict[tuple, Cause] = {}
    for _, c, x in sorted(found, key=lambda item: -item[0]):  # the simplest form of each
        first.setdefault((c.effect, c.place), Cause(c, tuple(float(value) for value in x)))
    return list(first.values())[:MOST_ALIKE]


def _others(here: Fit, i: int) -> list[Cause]:
    return [c for j, c in enumerate(here.causes) if j != i]


def _taken(c: Candidate, here: Fit) -> bool:
    """Whether a cause is this effect at one of these places."""
    mine = [o.candidate for o in here.causes if o.candidate.effect == c.effect]
    return any(set(o.place) & set(c.place) or not o.place for o in mine)


ADD: Sequence[Propose] = (by_slopes, by_size, by_window, by_simulation, by_widening)
EXCHANGE: Sequence[Propose] = (by_effect, by_likeness, by_simulation_instead)
