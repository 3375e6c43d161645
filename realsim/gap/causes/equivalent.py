"""Sets of causes that the runs cannot tell from the one that was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.merit import PRICE, complexity, deviation, heldout, holds, no_better, price
from realsim.gap.causes.rivals import near, ranked
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.config import DiagnoseConfig
from realsim.gap.simulation.simulate import lookup

ALIKE, MOST_ALIKE = 0.95, 3
"""Squared cosine from which on two footprints count as one, and how many such rivals are refitted."""

TOLD = 0.5
"""Share of what a cause brings that slopes must foretell, for them to say what else would bring as much."""
NO_PREFERENCE = 4.0
"""Log-likelihood below which the runs prefer neither."""
SAME = 0.5
"""Log-likelihood below which two sets do the very same."""
NOT_HELD = 4.0
"""A preference that unseen runs do not share may be so many times larger: one lively run is no witness."""
CLEARLY_BETTER = 0.975
"""Quantile of Student's t, over the runs, that the mean gain on unseen runs must exceed in its standard errors."""


def equivalents(
    screen: Screen,
    fitter: Fitter,
    config: DiagnoseConfig,
    fit: Fit,
    nominal: Fit,
    stages: Sequence[tuple[Fit, list[Fit]]],
) -> list[Fit]:
    """Sets that explain the runs as well: each cause exchanged for its rivals, everything refitted."""
    found: dict[tuple, Fit] = {}
    removed = nominal.misfit - fit.misfit
    nearer = not screen.simulator.context.touches  # where feet slip and land, nearer slopes say less
    for i, cause in enumerate(fit.causes):
        others = [c for j, c in enumerate(fit.causes) if j != i]
        found |= _twins(screen, fitter, cause, others)
        near_by = [r for r in _close_rivals(stages, fit) if deviation(screen, r) >= config.min_deviation]
        plain, at_an_end = _plain(screen, cause), _at_an_end(fit, cause)
        natural = [*plain, *_same_motion(screen, cause)]
        by_slopes = [*_alike(screen, fit, cause), *_as_likely(screen, fitter, fit, cause)]
        for rival in [*natural, *by_slopes, *_elsewhere(screen, cause), *near_by]:
            key = (cause.candidate.key, rival.candidate.effect, rival.candidate.place)
            if key in found or lookup(rival.candidate.effect).plain == cause.candidate.effect:
                continue
            trial = fitter.fit([*others, rival], iterations=8, target=fit.misfit + near(removed), nearer=nearer)
            if trial is None:
                continue
            worse = trial.misfit - fit.misfit
            hardly = screen.simulator.context.touches and worse < no_better(screen, removed)
            spared = rival in plain and (at_an_end or hardly)  # a law that is bent to its end stands for something else
            if spared or _as_good(screen, config, fit, trial, removed):
                found[key] = trial
    return sorted(found.values(), key=lambda f: f.misfit)


def simplest(fit: Fit, rivals: list[Fit], least: float) -> tuple[Fit, list[Fit]]:
    """(fit, rivals) with a law in place of the richer one that contains it, where the richer wins by less than `least`.

    Nor is the richer one believed where it fits as well only at an end of its range.
    """
    for rival in rivals:
        law = rival.causes[-1].candidate
        richer = [
            c for c in fit.causes if lookup(c.candidate.effect).plain == law.effect and c.candidate.place == law.place
        ]
        undetermined = any(_at_an_end(fit, c) for c in richer)
        worse = rival.misfit - fit.misfit
        if richer and len(rival.causes) == len(fit.causes) and (worse < least or undetermined):
            return rival, [r for r in rivals if r is not rival]
    return fit, rivals


def _at_an_end(fit: Fit, cause: Cause) -> bool:
    return any(name in fit.at_bounds for name in cause.candidate.names)


def likelier(fit: Fit, rivals: list[Fit]) -> tuple[Fit, list[Fit]]:
    """(fit, rivals) with the more usual or simpler cause first, where the runs do not prefer either."""
    for rival in rivals:
        theirs = {c.candidate.effect for c in rival.causes}
        ours = {c.candidate.effect for c in fit.causes}
        usual = any(lookup(e).usual in theirs - ours for e in ours - theirs)
        worse = rival.misfit - fit.misfit
        simpler = worse < SAME and _size(rival) < _size(fit)
        if len(rival.causes) == len(fit.causes) and ((usual and worse < NO_PREFERENCE) or simpler):
            return rival, [fit, *(r for r in rivals if r is not rival)]
    return fit, rivals


def _size(fit: Fit) -> int:
    return sum(len(c.values) for c in fit.causes)


def _alike(screen: Screen, fit: Fit, cause: Cause) -> list[Cause]:
    """Rivals whose sensitivities span what this cause does: by their angle, however usual or unusual their size is.

    With v the cause's footprint, D a rival's and A the information, the share of v within D's span is
    v'AD (D'AD)^-1 D'Av / v'Av, the squared cosine of the angle between them.
    """
    A = np.sum(fit.evidence.A, axis=0)
    values = np.array([cause.named[n] for n in cause.candidate.linear])
    v = cause.candidate.directions @ values
    size = float(v @ A @ v)
    found = []
    for c in screen.candidates:
        if size <= 0 or any(_same_thing(c, other.candidate) for other in fit.causes) or c.names != c.linear:
            continue
        D = c.directions
        inside = D.T @ A @ v
        info = D.T @ A @ D
        if np.trace(info) <= 0:  # it does nothing where errors count, as in runs that were cut at a fall
            continue
        coefficients = np.linalg.solve(info + 1e-9 * np.trace(info) * np.eye(len(info)), inside)
        share = float(inside @ coefficients) / size
        if share > ALIKE:
            found.append((share - 0.01 * len(c.names), Cause(c, tuple(float(x) for x in coefficients))))
    found.sort(key=lambda item: -item[0])
    first: dict[tuple, Cause] = {}
    for _, rival in found:  # the simplest form of each
        first.setdefault((rival.candidate.effect, rival.candidate.place), rival)
    return list(first.values())[:MOST_ALIKE]


def _as_likely(screen: Screen, fitter: Fitter, fit: Fit, cause: Cause) -> list[Cause]:
    """Rivals that explain as much of what is left without this cause, when small deviations make up for the rest."""
    without = fitter.looked_at(fit, [c for c in fit.causes if c is not cause])
    order = ranked(screen, without) if without else []
    own = next((gain for gain, candidate, _ in order if candidate.key == cause.candidate.key), 0.0)
    if not without or own < TOLD * (without.misfit - fit.misfit):
        return []
    first: dict[tuple, Cause] = {}
    for gain, c, estimate in order:
        if gain < own - near(own) or len(first) == MOST_ALIKE:
            break
        if c.names == c.linear and not any(_same_thing(c, other.candidate) for other in fit.causes):
            first.setdefault((c.effect, c.place), Cause(c, tuple(float(x) for x in estimate)))
    return list(first.values())


def _elsewhere(screen: Screen, cause: Cause) -> list[Cause]:
    """The same effect where it does nearly the same, if all its parameters are known."""
    effect = lookup(cause.candidate.effect)
    context, (first, *more) = screen.simulator.context, cause.candidate.places
    names = {p.name for p in effect.parameters(context, first)}
    if effect.elsewhere is None or more or names != set(cause.candidate.names):
        return []
    moved = dict(effect.elsewhere(context, first, cause.named))
    same = [c for c in screen.candidates if c.effect == effect.name and set(c.names) == names and c.place in moved]
    return [Cause(c, tuple(moved[c.place][n] for n in c.names)) for c in same]


def _twins(screen: Screen, fitter: Fitter, cause: Cause, others: list[Cause]) -> dict[tuple, Fit]:
    """The effect that does exactly the same by its nature: no preference of the runs is believed, only refitted."""
    c = cause.candidate
    twin = screen.simulator.twin(c.effect)
    same = [x for x in screen.candidates if (x.effect, x.places, x.names) == (twin, c.places, c.names)]
    fits = {(c.key, x.effect, x.place): fitter.fit([*others, Cause(x, cause.values)], iterations=3) for x in same}
    return {key: fit for key, fit in fits.items() if fit is not None}


def _same_motion(screen: Screen, cause: Cause) -> list[Cause]:
    """Effects that move the robot the same way by their nature: beside slipping feet, slopes may not show it."""
    context, c = screen.simulator.context, cause.candidate
    if context.case.has("joint_torque"):
        return []
    same = lookup(c.effect).same_motion(context, c.place, cause.named)
    rivals = [x for x in screen.candidates if x.places == c.places and x.effect in same]
    return [Cause(x, tuple(same[x.effect][n] for n in x.names)) for x in rivals if set(x.names) == set(same[x.effect])]


def _plain(screen: Screen, cause: Cause) -> list[Cause]:
    """The plain law that a richer one contains, at the same place."""
    c, shared = cause.candidate, {}
    for p in lookup(c.effect).parameters(screen.simulator.context, c.place):
        if p.like is not None and p.name in cause.named:
            shared[p.like[1]] = cause.named[p.name]
    plain = [
        x
        for x in screen.candidates
        if (x.effect, x.places) == (lookup(c.effect).plain, c.places) and set(x.names) == set(shared)
    ]
    return [Cause(x, tuple(shared[n] for n in x.names)) for x in plain]


def _close_rivals(stages: Sequence[tuple[Fit, list[Fit]]], fit: Fit) -> list[Cause]:
    """Rivals that came near the winner of their stage; the others cannot catch up by a joint refit."""
    rivals: dict[tuple, Cause] = {}
    for before, fits in stages:
        best = min(f.misfit for f in fits)
        for f in fits:
            cause = f.causes[-1]
            if f.misfit - best > near(before.misfit - best):
                continue
            if any(_same_thing(cause.candidate, c.candidate) for c in fit.causes):
                continue
            rivals.setdefault(cause.candidate.key, cause)
    return list(rivals.values())[:5]


def _same_thing(a: Candidate, b: Candidate) -> bool:
    return (a.effect == b.effect and bool(set(a.place) & set(b.place))) or (a.effect == b.effect and not a.place)


def _as_good(screen: Screen, config: DiagnoseConfig, best: Fit, rival: Fit, removed: float) -> bool:
    """Within a small share of what the best removes, and no run by run preference beyond its scatter."""
    loss = price(screen, rival) - price(screen, best)
    if loss < NO_PREFERENCE:
        return True
    mean, error, positive = heldout(screen, rival, best)
    richer = complexity(screen, rival) > complexity(screen, best) + PRICE / 2
    if richer and not holds(-mean, error, 1 - positive):
        return False  # a richer effect that is no better only mimics the simpler one, if unseen runs do not gain by it
    allowed = config.equivalent_loss * (NOT_HELD if mean <= 0 else 1.0) * removed
    return loss < max(allowed, 8.0) and mean < float(student.ppf(CLEARLY_BETTER, len(screen.runs) - 1 or 1)) * error
