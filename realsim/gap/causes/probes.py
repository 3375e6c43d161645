"""Candidates looked at by simulation, where slopes at the nominal model foretell nothing.

Whether a foot meets higher ground, no slope foretells. And where a robot swings so far from its simulator that the
two share little, every slope is of another motion than the robot's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice

import numpy as np

from realsim.gap.causes.figures import ABRUPT_SIZES, BENT_SIZES, KEPT, KEPT_FEET, PROBED, PROBED_FEET, SIZES, STANDS_OUT
from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.linear import log_evidence
from realsim.gap.causes.screen import Candidate, Screen, slab
from realsim.gap.effects.base import Place
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

Probe = tuple[float, Candidate, dict[str, float]]
"""(gain in log-likelihood, candidate, values to start from) beside the current causes."""


def alone(screen: Screen, current: Fit, candidates: Iterable[Candidate]) -> Iterator[tuple[float, Candidate, F64]]:
    """(gain, candidate, estimate) of each by the linear screen if there were no small deviations beside it."""
    A, b = np.sum(current.evidence.A, axis=0), np.sum(current.evidence.b, axis=0)
    for c in candidates:
        gain, estimate, _ = log_evidence(A, b, c.directions, slab(c, screen))
        yield gain, c, estimate


def probed_ground(screen: Screen, fitter: Fitter, current: Fit, order: Iterable[Candidate]) -> list[Probe]:
    """The best places for higher or lower ground. `order`: all candidates, those to look at first before the others."""
    single = (c for c in order if lookup(c.effect).scope == "terrain" and len(c.places) == len(c.names) == 1)
    return _probed_feet(fitter, current, islice(single, PROBED_FEET))


def probed_footing(screen: Screen, fitter: Fitter, current: Fit, candidates: Iterable[Candidate]) -> list[Probe]:
    """The best places for what moves the feet of a robot that stands: at a gross size other ones carry it."""
    if not screen.simulator.context.touches:
        return []
    moving = (c for c in candidates if len(c.places) == 1 and c.names == lookup(c.effect).footing)
    return _probed_feet(fitter, current, islice(moving, PROBED_FEET))


def _probed_feet(fitter: Fitter, current: Fit, candidates: Iterable[Candidate]) -> list[Probe]:
    def gain(cause: Cause) -> float:  # a foot may meet the ground in one run only: all of them, at the model's own step
        moved = fitter.looked_at(current, (*current.causes, cause))
        return current.misfit - moved.misfit if moved else float("-inf")

    screen = fitter.screen
    forwards = [(c, _along(screen, c, np.zeros(len(c.linear)))) for c in candidates]
    return _probed(fitter, gain, forwards)[:KEPT_FEET]


def probed(screen: Screen, fitter: Fitter, current: Fit, candidates: Iterable[Candidate]) -> list[Probe]:
    """The best places of the best effects, at the sizes that are looked at.

    To first order many small deviations imitate a gross cause, at a price that is small against a large gap; so the
    order here is by what a candidate explains all by itself. Abrupt effects have no slope to be ordered by. Stiff laws
    would take too long, and are refitted from several sizes anyway. Where feet slip and land, a cause may be so far
    from linear that it explains little by itself: there, its deviation that stands out among the others points at it.
    """
    best: dict[tuple[str, Place], tuple[float, Candidate, F64]] = {}
    for by_itself, c, estimate in alone(screen, current, candidates):
        if _worth_a_look(c):
            gain = np.inf if lookup(c.effect).abrupt else by_itself
            if gain > best.get((c.effect, c.place), (-np.inf,))[0]:
                best[c.effect, c.place] = gain, c, estimate
    order = sorted(best.values(), key=lambda item: -item[0])[:PROBED]
    gain_of = partial(fitter.coarse_gain, current.causes)
    probes = _probed(fitter, gain_of, [(c, _along(screen, c, estimate)) for _, c, estimate in order])
    out = standing_out(screen, current)[:PROBED_FEET] if screen.simulator.context.touches else []
    probes += _probed(fitter, gain_of, [(c, _along(screen, c, estimate)) for c, estimate in out], BENT_SIZES)
    found: dict[str, Probe] = {}
    for probe in sorted(probes, key=lambda p: -p[0]):
        found.setdefault(probe[1].effect, probe)
    return list(found.values())[:KEPT]


def standing_out(screen: Screen, current: Fit) -> list[tuple[Candidate, F64]]:
    """(candidate, estimate) of single places by how far their small deviations lie off nothing, the furthest first.

    To first order a gross cause is shared out among many deviations; its own is bent the most.
    """
    x = screen.nuisances(current.evidence, current.prior)
    z = np.divide(x, current.prior, out=np.zeros_like(x), where=current.prior > 0)
    best: dict[tuple[str, Place], tuple[float, Candidate, F64]] = {}
    for c in screen.candidates:
        involved = c.directions.any(axis=1)
        far = float(np.sum(z[involved] ** 2)) - STANDS_OUT**2 * len(c.linear)
        if _worth_a_look(c) and far > best.get((c.effect, c.place), (0.0,))[0]:
            best[c.effect, c.place] = far, c, c.directions.T @ x / np.sum(c.directions**2, axis=0)
    return [(c, estimate) for _, c, estimate in sorted(best.values(), key=lambda item: -item[0])]


def _worth_a_look(c: Candidate) -> bool:
    effect = lookup(c.effect)
    return len(c.places) == 1 and effect.scope != "terrain" and not effect.stiff


def _probed(
    fitter: Fitter,
    gain_of: Callable[[Cause], float],
    candidates: Sequence[tuple[Candidate, F64]],
    sizes: tuple[float, ...] = (),
) -> list[Probe]:
    """Candidates that gain, best first, each at its best size along its direction (m,)."""
    probes = fitter.each(lambda found: _sized(fitter.screen, gain_of, *found, sizes), candidates)
    return sorted((p for p in probes if p[0] > 0), key=lambda p: -p[0])


def _along(screen: Screen, candidate: Candidate, estimate: F64) -> F64:
    """(m,) the direction of an estimate, a step long; that of the first parameter where it is nothing."""
    parameters = lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)
    every = {p.name: abs(p.step) for p in parameters}
    steps = np.array([every[n] for n in candidate.linear])
    size = float(np.linalg.norm(estimate / steps))
    return estimate / size if size else np.eye(len(steps))[0] * steps


def _sized(
    screen: Screen,
    gain_of: Callable[[Cause], float],
    candidate: Candidate,
    unit: F64,
    sizes: tuple[float, ...],
) -> Probe:
    """The best of some sizes; beyond the largest, as long as that gains."""
    effect = lookup(candidate.effect)
    sizes = sizes or (ABRUPT_SIZES if effect.abrupt else SIZES)
    parameters = {p.name: p for p in effect.parameters(screen.simulator.context, candidate.place)}
    start = {n: parameters[n].default for n in candidate.names}

    def values(factor: float) -> dict[str, float]:
        return start | {n: float(v) for n, v in zip(candidate.linear, unit * factor, strict=True)}

    def gain(factor: float) -> float:
        named = values(factor)
        if any(not parameters[n].bounds[0] <= named[n] <= parameters[n].bounds[1] for n in candidate.linear):
            return -np.inf
        return gain_of(Cause(candidate, tuple(named[n] for n in candidate.names)))

    most, best = max((gain(factor), factor) for factor in sizes)
    while abs(best) >= max(sizes) and (further := gain(2 * best)) > most:
        most, best = further, 2 * best
    while screen.simulator.context.touches and most > 0 and (nearer := gain(0.75 * best)) > most:
        most, best = nearer, 0.75 * best  # a little beyond the right height a foot meets other ground
    return most, candidate, values(best)
