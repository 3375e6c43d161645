"""The rivals of one stage: all candidates by the linear screen, the best of them refitted by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.leftover import leftover
from realsim.gap.causes.linear import marginal, score
from realsim.gap.causes.merit import complexity, heldout
from realsim.gap.causes.probes import alone, foretold, probed, probed_footing, probed_ground
from realsim.gap.causes.screen import Candidate, Screen, slab
from realsim.gap.causes.windows import carried, slid, window_candidates
from realsim.gap.config import DiagnoseConfig
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

GROWN = 3
"""The best rivals of a stage are also tried with all their parameters."""

DUELLISTS = 5

ALONE, MOST_ALONE = 0.3, 2
"""Share of what is left that an effect must explain all by itself to be refitted whatever the screen says, and how many
such effects are."""
MORE_THAN_SMALL = 3.0
"""Mean square in units of the floor from which on they are looked for: less is a matter of small deviations."""


@dataclass(frozen=True)
class Trial:
    """A rival that was looked at, for the ranking table."""

    effect: str
    place: tuple[str, ...]
    names: tuple[str, ...]
    stage: int
    linear_gain: float
    """Log-evidence gain by the linear screen."""
    gain: float | None = None
    """Gain after the nonlinear fit, or None if it was not refitted."""
    heldout_gain: float | None = None
    """Gain per unseen run, the mean over the runs left out in turn."""
    heldout_se: float | None = None
    values: dict[str, float] = field(default_factory=dict)
    outcome: str = "screened"


def ranked(screen: Screen, current: Fit) -> list[tuple[float, Candidate, F64]]:
    """All candidates by the linear evidence they add to `current`, best first."""
    about = [marginal(e, current.prior) for e in screen.centred(current.evidence)]
    least = min(misfit for _, _, misfit in about)
    taken = {(c.candidate.effect, p) for c in current.causes for p in c.candidate.places}
    taken |= {(screen.simulator.twin(effect) or effect, p) for effect, p in taken}
    found = []
    for candidate in screen.candidates:
        if any((candidate.effect, p) in taken for p in candidate.places):
            continue
        size = slab(candidate, screen)
        scored = [(*score(A, b, candidate.directions, size)[:2], misfit - least) for A, b, misfit in about]
        gain, estimate = max(((gain - behind, estimate) for gain, estimate, behind in scored), key=lambda g: g[0])
        found.append((gain, candidate, estimate))
    return sorted(found, key=lambda item: -item[0])


def outstanding(screen: Screen, current: Fit, taken: Sequence[str]) -> list[tuple[float, Candidate, F64]]:
    """The effects that explain most of what is left all by themselves, the best place of each, best first.

    Beside many small deviations the linear screen may see nothing of a gross cause: to first order they imitate it at a
    price that is small against a large gap, but they would have to be absurd.

    Args:
        taken: effects that need not be looked at.
    """
    total = 0.5 * float(sum(current.evidence.c))
    best: dict[str, tuple[float, Candidate, F64]] = {}
    for found in alone(screen, current, [c for c in screen.candidates if c.effect not in taken]):
        gain, candidate, _ = found
        if gain > max(ALONE * total, best.get(candidate.effect, (0.0,))[0]):
            best[candidate.effect] = found
    return sorted(best.values(), key=lambda item: -item[0])[:MOST_ALONE]


def refitted(
    screen: Screen, fitter: Fitter, config: DiagnoseConfig, current: Fit, stage: int, trials: list[Trial]
) -> list[Fit]:
    """The best candidates of the linear screen, refitted together with what is already accepted; best first."""
    order = ranked(screen, current)
    by_slopes = foretold(screen, current, order[0][0] if order else 0.0)
    most = config.finalists + (4 if by_slopes else 0)
    # Far behind the leader by the linear screen, only effects that are far from linear can still win.
    least = max(0.5 * config.min_gain, 0.04 * order[0][0] if order else 0.0)
    finalists: list[tuple[float, Candidate, F64]] = []
    per_effect: dict[str, int] = {}
    for gain, candidate, estimate in order:
        nested = any(_nested(candidate, other) for _, other, _ in finalists)
        if gain > least and len(finalists) < most and not nested:
            count = per_effect.get(candidate.effect, 0)
            # The first few take what is best; then every further effect gets its best place, so none is overlooked.
            if count < 2 or (len(finalists) < 3 and count < 3):
                if len(finalists) >= config.finalists and count:
                    continue
                finalists.append((gain, candidate, estimate))
                per_effect[candidate.effect] = count + 1
                continue
        if len(trials) < 4000:
            trials.append(Trial(candidate.effect, candidate.place, candidate.names, stage, gain))
    fits: list[Fit] = []
    forces = [(g, c, v) for g, c, v in window_candidates(screen, current) if not _has(current, c)]
    everything = [c for _, c, _ in order]
    ground = [(g, c, v) for g, c, v in probed_ground(screen, fitter, current, everything) if g > least]
    footing = probed_footing(screen, fitter, current, everything)
    chosen: list[tuple[float, Candidate, Any]] = [*finalists, *forces, *ground, *footing]
    if not by_slopes:
        known = {(c.effect, c.place) for _, c, _ in chosen}
        chosen += [p for p in probed(screen, fitter, current, everything) if (p[1].effect, p[1].place) not in known]
    if leftover(screen, current).mean() > MORE_THAN_SMALL:
        taken = [c.effect for _, c, _ in chosen] + [c.candidate.effect for c in current.causes]
        chosen += outstanding(screen, current, taken)
    for gain, candidate, estimate in chosen:
        best = min((searched(screen, f) for f in fits), default=np.inf)
        target = best + near(searched(screen, current) - best)
        if isinstance(estimate, dict):
            values = tuple(float(estimate[n]) for n in candidate.names)
            fit = fitter.fit(
                [*current.causes, Cause(candidate, values)], iterations=8, rough=True, coarse=True, target=target
            )
        else:
            fit = refit(screen, fitter, current, candidate, estimate, target)
        if fit is None:
            trials.append(
                Trial(candidate.effect, candidate.place, candidate.names, stage, gain, outcome="fails to run")
            )
            continue
        for found in (fit, _once_more(fitter, fit, target)):
            if found is not None:
                trials.append(tried(screen, current, found, stage, gain))
                fits.append(found)
    fits.sort(key=lambda f: f.misfit + complexity(screen, f))
    if fits and _slides(screen, fits[0].causes[-1].candidate):
        here = slid(fitter, fits[0])
        for push in (here, *(slid(fitter, f) for f in carried(screen, fitter, here))):
            again = fitter.fit(push.causes, iterations=6, rough=True)
            if again is not None:
                trials.append(tried(screen, current, again, stage, 0.0))
                fits.insert(0, again)
        fits.sort(key=lambda f: f.misfit + complexity(screen, f))
    for fit in list(fits[:GROWN]):  # with all its parameters an effect may do what the simple form cannot
        full = _fullest(screen, fit.causes[-1].candidate)
        if full is not None:
            grown = fitter.fit([*current.causes, _extended(screen, fit.causes[-1], full)], iterations=6, rough=True)
            if grown is not None:
                trials.append(tried(screen, current, grown, stage, 0.0))
                fits.append(grown)
    return sorted(fits, key=lambda f: f.misfit + complexity(screen, f))


def duel(screen: Screen, fitter: Fitter, current: Fit, fits: list[Fit]) -> tuple[Fit, list[Fit]]:
    """(current, fits) anew: those that came near the best are fitted again where it counts, on what the best leaves.

    Beside a large gap every tolerance is wide, and rivals look alike that the small rest tells apart.
    """
    best = fits[0]
    close = [f for f in fits if f.misfit - best.misfit <= near(current.misfit - best.misfit)][:DUELLISTS]
    if len(close) < 2:
        return current, fits
    fitter.tighten(best)
    again = [fit for f in close if (fit := fitter.fit(f.causes, iterations=6, rough=True)) is not None]
    return fitter.remeasure(current), sorted(again, key=lambda f: f.misfit + complexity(screen, f))


def tried(screen: Screen, current: Fit, fit: Fit, stage: int, gain: float) -> Trial:
    """What is kept of a refitted rival."""
    mean, error, _ = heldout(screen, current, fit)
    cause = fit.causes[-1]
    return Trial(
        cause.candidate.effect, cause.candidate.place, cause.candidate.names, stage, gain,
        current.misfit - fit.misfit, mean, error, cause.named, "refitted",
    )  # fmt: skip


def _slides(screen: Screen, candidate: Candidate) -> bool:
    """Whether slopes may have found a wrong window: what lifts a foot or sets a robot swinging foretells none."""
    names = candidate.names
    return "since" in names or ("start" in names and screen.simulator.context.touches)


def _nested(a: Candidate, b: Candidate) -> bool:
    """Whether one is the other with further parameters."""
    few, many = sorted((set(a.names), set(b.names)), key=len)
    return a.effect == b.effect and a.place == b.place and few <= many


def _fullest(screen: Screen, candidate: Candidate) -> Candidate | None:
    """The same effect at the same place with the most parameters, if that is more than it has."""
    more = [c for c in screen.candidates if _nested(c, candidate) and len(c.names) > len(candidate.names)]
    return max(more, key=lambda c: len(c.names)) if more else None


def _contains(rich: Candidate, plain: Candidate) -> bool:
    """Whether one law is a richer form of the other, at the same place."""
    return lookup(rich.effect).plain == plain.effect and rich.places == plain.places


def _enriched(
    screen: Screen, fitter: Fitter, current: Fit, plain: Cause, candidate: Candidate, target: float
) -> Fit | None:
    """The richer law in place of the plain one: beside it, both would be friction twice over."""
    full = _fullest(screen, candidate) or candidate
    effect = lookup(full.effect)
    parameters = effect.parameters(screen.simulator.context, full.place)
    shared = {p.name: plain.named[p.like[1]] for p in parameters if p.like is not None}
    values = {p.name: p.default for p in parameters} | shared
    others = [c for c in current.causes if c is not plain]
    start = Cause(full, tuple(values[n] for n in full.names))
    return _once_more(fitter, replace(current, causes=(*others, start)), target)


def _once_more(fitter: Fitter, fit: Fit, target: float) -> Fit | None:
    """A second search from another valley, the best of those that the last cause's effect knows of."""
    cause, others = fit.causes[-1], fit.causes[:-1]
    further = lookup(cause.candidate.effect).further_starts
    valleys = further(cause.named) if further else []
    if not valleys or set(valleys[0]) != set(cause.candidate.names):
        return None
    first, *more = (tuple(values[n] for n in cause.candidate.names) for values in valleys)
    done = [v for c in others for v in c.values]
    starts = [[*done, *values] for values in more]
    return fitter.fit([*others, Cause(cause.candidate, first)], starts, iterations=8, rough=True, target=target)


def _extended(screen: Screen, cause: Cause, full: Candidate) -> Cause:
    """The cause's values as the start of the fuller form."""
    parameters = lookup(full.effect).parameters(screen.simulator.context, full.place)
    defaults = {p.name: p.default for p in parameters}
    return Cause(full, tuple(cause.named.get(n, defaults[n]) for n in full.names))


def _has(fit: Fit, candidate: Candidate) -> bool:
    return any(c.candidate.effect == candidate.effect and c.candidate.place == candidate.place for c in fit.causes)


def searched(screen: Screen, fit: Fit) -> float:
    """Misfit on the runs that a rough fit looks at."""
    few = screen.varied
    seen = fit.predictions if few is None else [fit.predictions[k] for k in few]
    return screen.misfit(screen.evidence(seen, few, fit.about), fit.prior)


def near(gain: float) -> float:
    """A rival that stays further than this behind the best of a stage cannot catch up by a joint refit."""
    return max(0.15 * gain, 20.0) if np.isfinite(gain) else np.inf


def refit(
    screen: Screen, fitter: Fitter, current: Fit, candidate: Candidate, estimate: F64, target: float = np.inf
) -> Fit | None:
    plain = next((c for c in current.causes if _contains(candidate, c.candidate)), None)
    if plain is not None:
        return _enriched(screen, fitter, current, plain, candidate, target)
    parameters = {p.name: p for p in lookup(candidate.effect).parameters(screen.simulator.context, candidate.place)}
    linear = dict(zip(candidate.linear, estimate, strict=True))
    starts = []
    for factor in (1.0, 0.4):
        values = []
        for name in candidate.names:
            p = parameters[name]
            guess = linear.get(name, 0.0) * (factor if p.default == 0 else 0.0) + p.default
            if candidate.effect == "payload" and name in "xyz":
                mass = linear.get("mass", 1.0) or 1.0
                body = screen.simulator.case.model.body(candidate.place[0])
                guess = p.default + float(np.clip(linear.get(name, 0.0) * body.mass[0] / mass, -0.3, 0.3))
            if p.bounds[0] == 0 and guess < 0.1 * p.step:
                guess = 0.3 * p.step * factor
            values.append(float(guess))
        starts.append(values)
    first = parameters[candidate.names[0]]
    if first.bounds[0] == 0:  # one-sided effects are the least linear: start small and large too
        for factor in (0.25, 1.0, 2.0):
            starts.append([factor * first.step, *starts[0][1:]])
    elif lookup(candidate.effect).scope == "global" and len(candidate.names) == 1:  # slipping sets in at a threshold
        starts += [[factor * first.step] for factor in (0.5, 1.0, 1.5)]
    done = [v for c in current.causes for v in c.values]
    causes = [*current.causes, Cause(candidate, tuple(starts[0]))]
    return fitter.fit(causes, [[*done, *s] for s in starts[1:]], rough=True, coarse=True, target=target)
