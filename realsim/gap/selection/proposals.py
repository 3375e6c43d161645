"""Where to look next: functions of one signature, from a set of causes to others that may be more probable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from realsim.gap.causes.fitted import Cause
from realsim.gap.causes.linear import score
from realsim.gap.causes.screen import Candidate, slab
from realsim.gap.causes.windows import _by_place, clocks
from realsim.gap.selection.figures import OCCAM_WINDOW, PROPOSED
from realsim.gap.selection.fitting import Fit, Fitter
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64


@dataclass(frozen=True)
class Proposal:
    """A set of causes with values to start from."""

    causes: tuple[Cause, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    """Further values of all causes in a row."""
    foretold: float = 0.0
    """Gain in evidence that slopes foretell."""
    by: str = ""


Propose = Callable[[Fitter, Fit], Iterator[Proposal]]


def ranked(fitter: Fitter, fit: Fit) -> list[tuple[float, Candidate, F64]]:
    """(gain, candidate, estimate) of all further causes to first order, best first; the variance is estimated anew."""
    screen, like = fitter.screen, fitter.likelihood
    prior = fitter.prior_beside([c.candidate for c in fit.causes])
    moments = like.moments(like.residual(fit.predictions, np.where(prior > 0, fit.about, 0.0)))
    base = like.marginal(moments, prior)
    A, w = base.information, base.weights
    AC = A @ base.covariance
    b = w @ moments.b
    info, gradient = A - AC @ A, b - A @ (base.covariance @ b)
    taken = {(c.candidate.effect, p) for c in fit.causes for p in c.candidate.places}
    open_ = [c for c in screen.candidates if not any((c.effect, p) in taken for p in c.places)]
    flat = 1.0 / np.maximum(like.floor, moments.c / np.maximum(like.counts, 1.0))  # as if there were no deviations
    plain_A, plain_b = like.information(flat), flat @ moments.b
    first = {}
    for A_, b_ in ((info, gradient), (plain_A, plain_b)):
        gains = sorted(
            ((score(A_, b_, c.directions, slab(c, screen))[0], i) for i, c in enumerate(open_)), reverse=True
        )
        for _, i in gains[: 6 * PROPOSED]:
            first[i] = open_[i]
    found = []
    for candidate in first.values():
        inside = candidate.directions.any(axis=1)
        sd = np.where(inside, 0.0, prior)
        size = slab(candidate, screen)
        F = np.concatenate([np.diag(sd)[:, sd > 0], candidate.directions * size], axis=1)
        marginal = like.marginal(moments, F, rounds=5)
        estimate = candidate.directions.T @ marginal.x / np.sum(candidate.directions**2, axis=0)
        found.append((marginal.value - base.value, candidate, estimate))
    return sorted(found, key=lambda item: -item[0])


def by_slopes(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """One more cause, the best to first order: of every effect its best places."""
    counts: dict[str, int] = {}
    chosen: list[Candidate] = []
    for gain, candidate, estimate in ranked(fitter, fit):
        nonlinear = lookup(candidate.effect).abrupt or lookup(candidate.effect).stiff
        if gain < 0 and not nonlinear:
            continue
        if counts.get(candidate.effect, 0) >= 2 or any(_nested(candidate, c) for c in chosen):
            continue
        counts[candidate.effect] = counts.get(candidate.effect, 0) + 1
        chosen.append(candidate)
        if len(chosen) > 2 * PROPOSED:
            return
        first, *more = starts(fitter, candidate, estimate)
        done = tuple(v for c in fit.causes for v in c.values)
        yield Proposal((*fit.causes, Cause(candidate, first)), tuple((*done, *s) for s in more), gain, "slopes")


def by_dropping(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """One cause less."""
    for i in range(len(fit.causes)):
        yield Proposal(tuple(c for j, c in enumerate(fit.causes) if j != i), foretold=0.0, by="drop")


def by_widening(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """The same causes with more parameters or fewer."""
    for i, cause in enumerate(fit.causes):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        c = cause.candidate
        for other in fitter.screen.candidates:
            if other.effect == c.effect and other.places == c.places and other.names != c.names:
                parameters = {p.name: p for p in fitter.parameters([other])}
                values = tuple(cause.named.get(n, parameters[n].default) for n in other.names)
                yield Proposal((*others, Cause(other, values)), by="widen")


def by_angle(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """Each cause exchanged for what does the same to first order, when the deviations make up for the rest."""
    screen, A = fitter.screen, fit.marginal.information
    covariance = fit.marginal.covariance
    A = A - A @ covariance @ A
    for i, cause in enumerate(fit.causes):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        v = cause.candidate.directions @ np.array([cause.named[n] for n in cause.candidate.linear])
        size = float(v @ A @ v)
        found = []
        for c in screen.candidates:
            if c.names != c.linear or any(
                (c.effect, c.place) == (o.candidate.effect, o.candidate.place) for o in fit.causes
            ):
                continue
            info, inside = c.directions.T @ A @ c.directions, c.directions.T @ A @ v
            if size <= 0 or np.trace(info) <= 0:
                continue
            x = np.linalg.solve(info + 1e-9 * np.trace(info) * np.eye(len(info)), inside)
            lost = 0.5 * (size - float(inside @ x)) + 1.0 * len(c.names)
            found.append((lost, Cause(c, tuple(float(t) for t in x))))
        seen: set[tuple[str, tuple[str, ...]]] = set()
        for lost, other in sorted(found, key=lambda f: f[0]):
            slot = (other.candidate.effect, other.candidate.place)
            if slot in seen or lost > OCCAM_WINDOW:
                continue
            seen.add(slot)
            if len(seen) > PROPOSED:
                break
            yield Proposal((*others, other), foretold=-lost, by="angle")


def by_window(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """A force that acts for a while, where that says much more than one that acts always."""
    screen, like = fitter.screen, fitter.likelihood
    if len(like.positions) < len(screen.runs):
        return
    left, weights = [], []
    for k, (run, y) in enumerate(zip(screen.runs, fit.predictions, strict=True)):
        r = screen.comparison.residual(run, y)
        weights.append(np.where(np.isfinite(r), screen.comparison.weights[run], 0.0))
        left.append(np.nan_to_num(r) - screen.fitted(k, fit.marginal.x - fit.about))
    for clock in clocks(screen):
        found = sorted(_by_place(screen, clock, left, weights), key=lambda item: -item[0])
        for gain, candidate, values in found[:2]:
            if (candidate.effect, candidate.place) not in fit.named:
                cause = Cause(candidate, tuple(values[n] for n in candidate.names))
                yield Proposal((*fit.causes, cause), foretold=gain, by="window")


def by_effect(fitter: Fitter, fit: Fit) -> Iterator[Proposal]:
    """What the effects themselves know: who does the same, where else, from which other values to search."""
    screen, simulator = fitter.screen, fitter.screen.simulator
    context = simulator.context
    for i, cause in enumerate(fit.causes):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        c, effect = cause.candidate, lookup(cause.candidate.effect)
        suggested: list[tuple[str, tuple[str, ...], dict[str, float]]] = []
        twin = simulator.twin(c.effect)
        if twin:
            suggested.append((twin, c.place, cause.named))
        if not context.case.has("joint_torque"):
            suggested += [(n, c.place, v) for n, v in effect.same_motion(context, c.place, cause.named).items()]
        if effect.elsewhere is not None and len(c.places) == 1 and "x" in cause.named:
            suggested += [(c.effect, p, v) for p, v in effect.elsewhere(context, c.place, cause.named)]
        for p in effect.parameters(context, c.place):
            if effect.plain and p.like is not None and p.like[0] == effect.plain and p.name in cause.named:
                suggested.append((effect.plain, c.place, {p.like[1]: cause.named[p.name]}))
        for other in screen.candidates:  # the richer law that this one is a part of
            if lookup(other.effect).plain == c.effect and other.places == c.places:
                shared = {p.name: cause.named[p.like[1]] for p in fitter.parameters([other])
                          if p.like is not None and p.like[1] in cause.named}  # fmt: skip
                values = {p.name: p.default for p in fitter.parameters([other])} | shared
                further = lookup(other.effect).further_starts
                valleys = [v for v in (further(values) if further else []) if set(v) == set(other.names)]
                if valleys:
                    done = [v for o in others for v in o.values]
                    more = tuple((*done, *(v[n] for n in other.names)) for v in valleys[1:])
                    first = Cause(other, tuple(valleys[0][n] for n in other.names))
                    yield Proposal((*others, first), more, by="effect")
        for name, place, values in suggested:
            for other in screen.candidates:
                if (other.effect, other.place) == (name, place) and set(other.names) == set(values):
                    yield Proposal((*others, Cause(other, tuple(values[n] for n in other.names))), by="effect")


def starts(fitter: Fitter, candidate: Candidate, estimate: F64) -> list[tuple[float, ...]]:
    """Values of the candidate's parameters to search from: the estimate, less of it, and where slopes say little, its
    steps."""
    body_mass = None
    parameters = fitter.parameters([candidate])
    linear = dict(zip(candidate.linear, estimate, strict=True))
    found = []
    for factor in (1.0, 0.4):
        values = []
        for p in parameters:
            slope = linear.get(p.name, 0.0)
            guess = p.default + (slope * factor if p.default == 0 else 0.0)
            if p.shape:
                body_mass = body_mass or float(fitter.screen.simulator.case.model.body(candidate.place[0]).mass[0])
                lever = slope * body_mass / (linear.get("mass", 1.0) or 1.0)
                guess = p.default + float(np.clip(lever, -0.3, 0.3))
            if p.bounds[0] == 0 and guess < 0.1 * p.step:
                guess = 0.3 * p.step * factor
            values.append(float(guess))
        found.append(tuple(values))
    first = parameters[0]
    if first.bounds[0] == 0:
        found += [(factor * first.step, *found[0][1:]) for factor in (0.25, 1.0, 2.0)]
    elif lookup(candidate.effect).scope == "global" and len(parameters) == 1:
        found += [(factor * first.step,) for factor in (0.5, 1.0, 1.5)]
    return found


def _nested(a: Candidate, b: Candidate) -> bool:
    return a.effect == b.effect and a.place == b.place


PROPOSALS: tuple[Propose, ...] = (by_slopes, by_window, by_dropping, by_widening, by_effect, by_angle)
