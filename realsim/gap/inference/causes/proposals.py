"""Where the search looks next: functions of one signature, from a set of causes to sets that may explain more."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import is_gap, leftover
from realsim.gap.inference.causes.score import searched
from realsim.gap.inference.causes.starts import Guess, nested, starts, suggested
from realsim.gap.inference.causes.windows import window_candidates
from realsim.gap.inference.likelihood.linear import Spectrum, log_evidence, marginal
from realsim.gap.inference.likelihood.screen import Candidate, Screen, slab
from realsim.gap.simulation.simulate import measured

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
    misfit: float = -np.inf
    """On the runs that a rough fit looks at, where it was simulated: a fit hardly gets below that."""


Propose = Callable[[Fitter, Fit], Iterator[Proposal]]


def by_slopes(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: the best places of the best effects by the linear screen."""
    order = ranked(fitter.screen, here)
    best = order[0][0] if order else 0.0
    least = max(figures.CLEARLY, figures.WORTH_SHARE * best)  # far behind, only what is far from linear can still win
    chosen: list[tuple[int, list[Scored]]] = []
    for scored in order:
        gain, candidate, _ = scored
        if gain < least:
            break
        forms = next((f for _, f in chosen if nested(candidate, f[0][1])), None)
        alike = sum(f[0][1].effect == candidate.effect for _, f in chosen)
        if forms:
            forms.append(scored)
        elif alike < figures.PLACES:
            chosen.append((alike, [scored]))
    # The best place of every effect first: or places of few effects, whose slopes hold not far, would be all. Where on
    # a link a mass sits, slopes tell badly: with all its parameters each is fitted, too.
    for _, forms in sorted(chosen, key=lambda c: c[0])[: figures.FITTED]:
        richest = max(forms, key=lambda form: len(form[1].names))
        for gain, candidate, estimate in forms[:1] if richest is forms[0] else (forms[0], richest):
            yield _further(fitter, here, candidate, estimate, gain)


def by_window(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: a force that acts for a while."""
    for gain, candidate, values in window_candidates(fitter.screen, here):
        if not here.has(candidate.effect, candidate.place):
            yield _further(fitter, here, candidate, values, gain)


def by_simulation(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: what no slope foretells (whether a foot meets other ground, whether a drive saturates), looked at
    by simulation at a few sizes. What stays beside a cause and is no gap has none of these in it."""
    if here.causes and not is_gap(leftover(fitter.screen, here)):
        return
    abrupt: dict[str, list[tuple[Candidate, F64]]] = {}
    for _, c, estimate in ranked(fitter.screen, here):
        effect = lookup(c.effect)
        stands = fitter.screen.simulator.context.touches and set(c.names) <= set(effect.law.footing)
        if len(c.places) == 1 and (effect.law.abrupt or stands):
            abrupt.setdefault(c.effect, []).append((c, estimate))
    fitter.rough(here)  # once, before many threads ask for it
    before = searched(fitter, here)
    for candidates in abrupt.values():
        looks = fitter.each(lambda item: _sized(fitter, here, *item), candidates[: figures.PROBED])
        for gain, cause in sorted(looks, key=lambda item: -item[0])[: figures.PLACES]:
            if gain > figures.CLEARLY:
                yield replace(_further(fitter, here, cause.candidate, cause.named, gain), misfit=before - gain)


def _sized(fitter: Fitter, here: Fit, candidate: Candidate, estimate: F64) -> tuple[float, Cause]:
    """(gain in log-likelihood, the candidate at the best of some sizes along its estimate); beyond the largest, as long
    as that gains, and nearer: a little beyond the right height a foot meets other ground."""
    steps = np.array([abs(p.step) for p in candidate.parameters if p.name in candidate.linear])
    size = np.linalg.norm(estimate / steps)
    unit = dict(
        zip(candidate.linear, estimate / size if size > 1e-3 else steps * (np.arange(len(steps)) == 0), strict=True)
    )

    before, few = searched(fitter, here), fitter.rough(here)

    def cause(factor: float) -> Cause:
        return Cause(candidate, tuple(p.default + factor * float(unit.get(p.name, 0.0)) for p in candidate.parameters))

    def gain(factor: float) -> float:
        there = cause(factor)
        if any(not p.bounds[0] <= v <= p.bounds[1] for p, v in zip(candidate.parameters, there.values, strict=True)):
            return -np.inf
        moved = fitter.misfit((*here.causes, there), few)
        return before - moved if moved is not None else -np.inf

    most, best = max((gain(factor), factor) for factor in figures.SIZES)
    for further in (2.0, 0.75):
        while most > 0 and (more := gain(further * best)) > most:
            most, best = more, further * best
    return most, cause(best)


def by_effect(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """Another cause in the place of each: with all its effect's parameters, or what the effect suggests, which is a law
    that contains it, one that does the same by its nature, the same at another place, or other values of its own."""
    for i, cause in enumerate(here.causes):
        others = [c for j, c in enumerate(here.causes) if j != i]
        done = tuple(v for c in others for v in c.values)
        for candidate, (first, *more) in suggested(fitter.screen, cause):
            yield Proposal((*others, Cause(candidate, tuple(first))), tuple((*done, *v) for v in more))


def ranked(screen: Screen, here: Fit) -> list[Scored]:
    """All candidates by the linear evidence that they add to a set, with all runs or the better half; best first.

    The set's own values go along: fitted alone, they have taken over what they can of what is missing beside them.
    """
    found: list[Scored] = screen.ranked.get(id(here), lambda: (here, _ranked(screen, here)))[1]
    return found


def _ranked(screen: Screen, here: Fit) -> list[Scored]:
    about, prior = [], here.prior / here.scale
    for c in here.causes:
        for i in screen.atoms_of(c.candidate):
            prior[i] = 2.0 * abs(screen.atoms[i].parameter.step)
    for look in here.evidence.looks():
        spectrum = Spectrum.of(np.sum(look.A, axis=0), prior)
        sides = [(e, s) for e in screen.centred(look) for s in figures.SCALES]
        looks = [(*marginal(e, s * prior, figures.REASONABLE * s * prior), spectrum.occam(s)) for e, s in sides]
        least = min(misfit + cost for _, _, misfit, cost in looks)
        about += [(A, b, misfit + cost - least) for A, b, misfit, cost in looks]
    taken = {(c.candidate.effect, p) for c in here.causes for p in c.candidate.places}
    A, b, behind = map(np.array, zip(*about, strict=True))
    found = []
    for candidate in screen.candidates:
        if any((candidate.effect, p) in taken for p in candidate.places):
            continue
        if lookup(candidate.effect).rivals.special_case in screen.effects:
            continue  # it takes the plainer law's place, where that one is a cause: see `by_effect`
        gains, estimates = log_evidence(A, b, candidate.directions, slab(candidate))
        best = int(np.argmax(gains - behind))
        found.append((float(gains[best] - behind[best]), candidate, estimates[best]))
    return sorted(found, key=lambda item: -item[0])


def _further(fitter: Fitter, here: Fit, candidate: Candidate, guess: Guess, gain: float) -> Proposal:
    """The candidate beside the causes."""
    first, *more = starts(fitter.screen, candidate, guess)
    done = [v for c in here.causes for v in c.values]
    return Proposal((*here.causes, Cause(candidate, tuple(first))), tuple((*done, *s) for s in more), gain)


def by_lag(fitter: Fitter, here: Fit) -> Iterator[Proposal]:
    """One more cause: a delay so long that no slope foretells it, by the shift at which the prediction fits the log."""
    screen = fitter.screen
    late = [c for c in screen.candidates if c.names == ("delay",) and not here.has(c.effect, c.place)]
    if late and (lag := best_lag(screen, here, max(c.parameters[0].bounds[1] for c in late))):
        done, width = tuple(v for c in here.causes for v in c.values), screen.comparison.config.bin_seconds
        for candidate in late:  # slopes may have proposed it, from elsewhere
            near = tuple((*done, lag + k * width) for k in (-1, 1))
            yield Proposal((*here.causes, Cause(candidate, (lag,))), near)


def best_lag(screen: Screen, here: Fit, longest: float) -> float:
    """s by which the log is behind the prediction; 0 where slopes say as much, or where it is no good explanation."""
    width = screen.comparison.config.bin_seconds
    lags = np.arange(0.0, longest, width)
    left = np.zeros(len(lags))
    for run, predicted in zip(screen.runs, here.predictions, strict=True):
        one = screen.simulator.case.runs[run]
        real = measured(one, screen.comparison.channels)
        for c, channel in enumerate(screen.comparison.channels):
            if channel.signal in ("joint_pos", "base_pos"):
                then = np.maximum(one.time - lags[:, None], 0.0)
                shifted = np.interp(then, one.time, predicted[:, c])
                left += np.nanmean((real[:, c] - shifted) ** 2, axis=1) / max(float(np.nanvar(real[:, c])), 1e-12)
    k = int(np.argmin(left))
    return float(lags[k]) if lags[k] > figures.LONG_LAG and left[k] < (1 - figures.NAMED_SHARE) * left[0] else 0.0


ADD: Sequence[Propose] = (by_slopes, by_window, by_simulation, by_lag)
EXCHANGE: Sequence[Propose] = (by_effect,)
