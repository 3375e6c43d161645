"""From what the search found to the answer: what lasts on left-out runs, what is as good, the check, the verdict.

The held-out runs are first looked at in `_checked`. All before it (which causes last, which rivals are as good, the
intervals of values) rests on the fitted runs. The verdict is decided with the check, which is therefore a validation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import Z90
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.check import Check, check, errors, mean_square
from realsim.gap.answer.horizons import over_horizons
from realsim.gap.answer.leaveout import LeftOut, better, leave_out
from realsim.gap.answer.stays import laws_left
from realsim.gap.answer.verdict import Fitted, Judgement, judge
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.causes.fitted import (
    Cause,
    Fit,
    Trial,
    at_an_end,
    imitates,
    implausible,
    is_gap,
    leftover,
    nuisance_settings,
    values_of,
    with_errors,
)
from realsim.gap.inference.causes.score import gained, holds, score
from realsim.gap.inference.causes.select import Selection
from realsim.gap.inference.causes.starts import contains, suggested
from realsim.gap.inference.evidence.onsets import find_onsets
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.verdicts import GapVerdict

NO_GAP_THERE = (
    "the run that was held out shows nothing of the gap, so it checks nothing: the fitted runs, each left out in turn, "
    "take its place"
)


@dataclass(frozen=True)
class Conclusion:
    """The answer, and what it rests on."""

    fit: Fit
    """The causes with their values."""
    sigmas: F64
    """(m,) standard errors of all values in a row."""
    equivalent: tuple[Fit, ...]
    check: Check
    judgement: Judgement
    left_out: LeftOut | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    lead: Fit | None = None
    """Where no cause is named: the nearest one, whose size robots of one kind may differ by."""


def conclude(config: DiagnoseConfig, selection: Selection, held: Sequence[int], nominal: Sequence[F64]) -> Conclusion:
    """The causes that last, sets as good as them, the check, the verdict.

    Args:
        selection: of the search, on the fitted runs.
        held: runs that nothing above has looked at.
        nominal: (T, C) a run, of the nominal simulator, all runs of the case.
    """
    notes, fitter, screen = list(selection.notes), selection.fitter, selection.fitter.screen
    fit, left, others, dropped = _held_against_others(fitter, selection, notes)
    fit, warnings = _with_onsets(screen, fit, held, nominal)
    checked, more = _checked(config, screen, fit, selection.nominal, left, held, nominal)
    fitted = _fitted(screen, fit, selection.nominal, nominal)
    sigmas = fit.sigmas if left is None else np.maximum(fit.sigmas, left.sigmas)
    ends = [name for c in fit.causes for name in at_an_end(c)]  # of strengths: a law's shape may be at one
    doubts = _doubts(screen, fit, sigmas, dropped, selection.trials)
    doubts += ["the search was cut short"] if selection.cut_short and fit.causes else []
    if not all(at_an_end(c) for c in fit.causes):  # the others may still be what they are
        doubts += [f"{name}: as far as the library goes, so it stands for something else" for name in ends]
        ends = []

    def judged() -> Judgement:
        share, count = config.unexplained_share, len(fit.causes)
        return judge(fitted, checked, count, len(others), ends, share, doubts)

    judgement = judged()
    if judgement.verdict is GapVerdict.PARTLY_EXPLAINED and left is not None and not selection.cut_short:
        others = _as_good(fitter, selection.trials, fit, left)
        judgement = judged()
    only_imitates = imitates(fit) and not is_gap(leftover(screen, selection.nominal))
    if (
        judgement.verdict is GapVerdict.UNEXPLAINED
        and fit.causes
        and (only_imitates or not any(_told_from_none(fit, sigmas)))
    ):
        why = "larger than plausible beside no gap" if only_imitates else "not told from none"
        kept = tuple(c for c in fit.causes if only_imitates and not imitates(replace(fit, causes=(c,))))
        gone = [c for c in fit.causes if c not in kept]
        notes.append(f"{', '.join(map(_name, gone))}: {why}, so it is not named as the nearest")
        plain = fitter.fit(kept) if kept else None
        without = replace(
            selection, fit=fitter.spread(plain) if plain else selection.nominal, equivalent=[], notes=notes
        )
        return conclude(config, without, held, nominal)
    lead = None if fit.causes else _lead(fitter, selection)
    alike = tuple(other.under(onsets=fit.conditions.onsets) for other in others)
    return Conclusion(fit, sigmas, alike, checked, judgement, left, tuple(notes), (*warnings, *more), lead)


def _held_against_others(
    fitter: Fitter, selection: Selection, notes: list[str]
) -> tuple[Fit, LeftOut | None, list[Fit], list[Cause]]:
    """(the causes that last, left-out runs, sets as good as them, what was dropped); of a search that was cut short,
    what it came to."""
    if selection.cut_short:
        return selection.fit, leave_out(fitter, selection.fit) if selection.fit.causes else None, [], []
    fit, left, dropped = _lasting(fitter, selection, notes)
    if fit is selection.fit:
        given = [f for f in selection.equivalent if not _again(fitter.screen, f, fit)]
    else:  # the search compared other sets: what is as good as what lasts is looked for anew
        fit, left, given = _simplest(fitter, selection.trials, fit, left)
    return *beside_imitations(fitter, fit, left, given, notes), dropped


def _doubts(screen: Screen, fit: Fit, sigmas: F64, dropped: Sequence[Cause], trials: Sequence[Trial]) -> list[str]:
    """What keeps the causes from being identified although they explain the runs."""
    if not fit.causes:
        return []
    found = implausible(fit.causes)
    for cause, told in zip(fit.causes, _told_from_none(fit, sigmas), strict=True):
        if not told:
            found.append(f"{_name(cause)}: its 90 % interval holds zero")
    kept = min(_gained(trials, c) for c in fit.causes)
    found += [f"{_name(c)} was taken out, and had gained more" for c in dropped if _gained(trials, c) > kept]
    if leftover(screen, fit).mean() > figures.LAWFUL:
        found += [f"{e['joint']}: what stays looks {e['what']}" for e in laws_left(screen, fit)]
    return found


def _gained(trials: Sequence[Trial], cause: Cause) -> float:
    """Nats that a cause gained in the search, at most."""
    return max((t.gain or 0.0 for t in trials if t.candidate.key == cause.candidate.key), default=0.0)


def _lead(fitter: Fitter, selection: Selection) -> Fit | None:
    """The nearest single cause at its best values, if it gains anything clearly; it is no finding."""
    first = [t for t in selection.trials if t.stage == 0 and (t.gain or 0.0) > figures.CLEARLY and t.values]
    if not first:
        return None
    best = max(first, key=lambda t: t.gain or 0.0)
    causes, iterations = [Cause(best.candidate, best.values)], 0 if selection.cut_short else 6
    found = fitter.fit(causes, (), iterations, fitter.rough(selection.nominal, every=True))
    return fitter.spread(found) if found is not None and not imitates(found) else None


# ---------------------------------------------------------------- on the fitted runs


def _lasting(fitter: Fitter, selection: Selection, notes: list[str]) -> tuple[Fit, LeftOut | None, list[Cause]]:
    """(the causes without those that do not help the others to predict left-out runs, these runs, what was dropped).

    Of several that left-out runs do not need, the one goes that explains least: two that do much the same (dry and
    viscous friction) are hardly needed beside each other, and the larger one is the cause. Where it is a law that holds
    a plainer one as a special case, that one stays if it is needed."""
    fit, dropped = selection.fit, list[Cause]()
    left = leave_out(fitter, fit) if fit.causes else None
    while left is not None and len(fit.causes) > 1 and len(fitter.screen.runs) > 1:
        each = [(fitter.fit([c for c in fit.causes if c is not cause]), cause) for cause in fit.causes]
        found = [(less, leave_out(fitter, less), cause) for less, cause in each if less is not None]
        spare = [one for one in found if not _needed(left, one[1])]
        if not spare:
            break
        fit, left, cause = min(spare, key=lambda one: one[0].misfit)
        if plain := _plainer(selection.trials, cause):
            other = fitter.fit([*fit.causes, plain])
            if other is not None and _needed(beside := leave_out(fitter, other), left):
                notes.append(f"{_name(plain)} takes the place of {_name(cause)}: left-out runs need no more")
                fit, left = other, beside
                continue
        notes.append(f"{_name(cause)} was taken out again: left-out runs do not need it")
        dropped.append(cause)
    return fit, left, dropped


def _needed(fit: LeftOut, less: LeftOut) -> bool:
    """Whether left-out runs need what one set has and the other has not."""
    return holds(gained(less.after, fit.after), figures.LEAST)


def _plainer(trials: Sequence[Trial], cause: Cause) -> Cause | None:
    """The law that a cause holds as a special case, with the values that the search found for it there."""
    found = [t for t in trials if t.values and contains(cause.candidate, t.candidate)]
    best = max(found, key=lambda t: t.gain or 0.0, default=None)
    return Cause(best.candidate, best.values) if best else None


def beside_imitations(
    fitter: Fitter, fit: Fit, left: LeftOut | None, given: Sequence[Fit], notes: list[str]
) -> tuple[Fit, LeftOut | None, list[Fit]]:
    """(fit, left-out runs, others) once each cause was compared with what its effect is taken for."""
    others, screen = list(given), fitter.screen
    if left is None or len(screen.runs) < 2:
        return fit, left, others
    for cause in list(fit.causes):
        rest_of = [c for c in fit.causes if c is not cause]
        taken_for = lookup(cause.candidate.effect).rivals.compared
        for candidate, (start, *_) in suggested(screen, cause) if taken_for else ():
            known = any(c.candidate.effect == candidate.effect for f in others for c in f.causes)
            rival = None
            if candidate.effect in taken_for and not known:
                rival = fitter.fit([*rest_of, Cause(candidate, tuple(start))], few=fitter.rough(fit, every=True))
            if rival is None:
                continue
            theirs = leave_out(fitter, rival)
            gain, error = better(screen.comparison, list(screen.runs), left.residuals, theirs.residuals)
            if gain < -Z90 * error:
                notes.append(
                    f"{_name(cause)}: {_name(rival.causes[-1])} predicts left-out runs better, and stands for it"
                )
                fit, left = rival, theirs
                break
            beside, by = gained(theirs.after, left.after)
            if gain <= Z90 * error or beside <= Z90 * by:  # what differs may be an everyday deviation
                others.append(rival)
    return fit, left, others


def _simplest(
    fitter: Fitter, trials: Sequence[Trial], fit: Fit, left: LeftOut | None
) -> tuple[Fit, LeftOut | None, list[Fit]]:
    """(the set with the lowest score of those that left-out runs cannot tell from this one, its runs, the others): one
    whose sizes the runs determine goes before one that could be none."""
    others = _as_good(fitter, trials, fit, left) if left is not None else []

    def order(one: Fit) -> tuple[bool, bool, float]:
        return imitates(one), not all(_told_from_none(one, fitter.spread(one).sigmas)), score(fitter, one)

    best, *rest = sorted([fit, *others], key=order)
    return (fit, left, others) if best is fit else (fitter.spread(best), leave_out(fitter, best), rest)


def _as_good(fitter: Fitter, trials: Sequence[Trial], fit: Fit, left: LeftOut) -> list[Fit]:
    """Single causes that left-out runs cannot tell from the one named, with what both leave counted as noise."""
    screen = fitter.screen
    if len(fit.causes) != 1 or len(screen.runs) < 2:
        return []
    own = fit.causes[0].candidate
    tried = [t for t in trials if t.stage == 0 and t.gain is not None and t.candidate.effect != own.effect]
    # Of the forms of an effect at one place the one that gains most.
    best = {(t.candidate.effect, t.candidate.places): t for t in sorted(tried, key=lambda t: t.gain or 0.0)}
    found: list[Fit] = []
    most = figures.PLACES if screen.slow else figures.FITTED
    for trial in sorted(best.values(), key=lambda t: -(t.gain or 0.0))[:most]:
        rival = fitter.fit([Cause(trial.candidate, trial.values)], few=fitter.rough(fit, every=True))
        if rival is None or _again(screen, rival, fit):
            continue
        theirs = leave_out(fitter, rival)
        gain, error = better(screen.comparison, list(screen.runs), left.residuals, theirs.residuals)
        if gain <= Z90 * error:
            found.append(rival)
    return found


def _again(screen: Screen, rival: Fit, fit: Fit) -> bool:
    """Whether a rival says nothing new: one of its causes does nothing, or contains one that is named, or it is the set
    itself with its values at further places, which the runs do not show."""
    runs, simulator, comparison = list(screen.runs), screen.simulator, screen.comparison
    nothing = [screen.comparison.residual(r, y) for r, y in zip(runs, screen.nominal, strict=True)]
    for cause in rival.causes:
        own = errors(simulator, comparison, cause.settings(), runs, fit.conditions.onsets)
        if own and mean_square(comparison, [x - y for x, y in zip(own, nothing, strict=True)], runs) < figures.LEAST:
            return True
    return any(contains(c.candidate, o.candidate) for c in rival.causes for o in fit.causes) or _wider(rival, fit)


def _wider(rival: Fit, fit: Fit) -> bool:
    """Whether a rival has all causes of a set, at the same places and further ones, with values that agree."""
    same = [
        c
        for o in fit.causes
        for c in rival.causes
        if (c.candidate.effect, c.candidate.names) == (o.candidate.effect, o.candidate.names)
        and set(c.candidate.places) >= set(o.candidate.places)
    ]
    if len(same) != len(fit.causes):
        return False
    return bool((np.abs(values_of(same) - values_of(fit.causes)) <= Z90 * fit.sigmas).all())


def _fitted(screen: Screen, fit: Fit, nothing: Fit, nominal: Sequence[F64]) -> Fitted:
    comparison, runs = screen.comparison, list(screen.runs)
    before = mean_square(comparison, [comparison.residual(r, nominal[r]) for r in runs], runs)
    left, gap = leftover(screen, fit), np.maximum(leftover(screen, nothing) - 1, 1e-9)
    shares, weight = np.clip((left - 1) / gap, 0, 1), np.log1p(gap)
    return Fitted(before, left, float((weight * shares).sum() / weight.sum()))


def _told_from_none(fit: Fit, sigmas: F64) -> list[bool]:
    """Of each cause, whether the 90 percent interval of some strength leaves out zero, where nothing is changed."""
    rows = [zip(c.candidate.parameters, c.values, own, strict=True) for c, own in with_errors(fit, sigmas)]
    return [any(p.strength and abs(value) > Z90 * sigma for p, value, sigma in row) for row in rows]


# ---------------------------------------------------------------- on the runs of the check


def _checked(
    config: DiagnoseConfig,
    screen: Screen,
    fit: Fit,
    nothing: Fit,
    left: LeftOut | None,
    held: Sequence[int],
    nominal: Sequence[F64],
) -> tuple[Check, list[str]]:
    """The check on the runs held out; where there is none, or it shows no gap, on the fitted runs left out in turn."""
    warnings = list[str]()
    ahead = over_horizons(screen, fit, left, held, config.seed) if fit.causes else None
    if held:
        found = replace(_check_on(config, screen, fit, nothing, held, "validation", nominal, None), horizons=ahead)
        if not fit.causes or is_gap(np.array([found.before])):
            return found, warnings
        warnings.append(NO_GAP_THERE)
    runs = list(screen.runs)
    kind = "left_out_in_turn" if len(runs) > 1 else "fitted"
    if not held:
        warnings.append(
            "no run was held out: the check is on the fitted runs"
            + (", each predicted by values fitted to the others" if len(runs) > 1 else "")
        )
    after = None if left is None else list(left.residuals)
    return replace(_check_on(config, screen, fit, nothing, runs, kind, nominal, after), horizons=ahead), warnings


def _check_on(
    config: DiagnoseConfig,
    screen: Screen,
    fit: Fit,
    nothing: Fit,
    runs: Sequence[int],
    kind: str,
    nominal: Sequence[F64],
    after: Sequence[F64] | None,
) -> Check:
    simulator, comparison = screen.simulator, screen.comparison
    before = [comparison.residual(r, nominal[r]) for r in runs]
    if not all(np.isfinite(nominal[r]).all() for r in runs):
        raise GapError("the nominal simulator explodes on the runs of the check")
    if after is None:
        after = errors(simulator, comparison, fit.settings(), runs, fit.conditions.onsets) if fit.causes else before
        after = before if after is None else after  # a patch that does not run there is none
    beside = _beside(screen, fit, runs) or after
    alone = _beside(screen, nothing, runs) if fit.causes else None
    return check(comparison, runs, kind, before, after, beside, config.bootstrap, config.seed, alone)


def _beside(screen: Screen, fit: Fit, runs: Sequence[int]) -> list[F64] | None:
    """Residuals with the causes and the everyday deviations of the fitted runs, which shrink until they can be run."""
    for scale in (1.0, 0.5):
        settings = [*fit.settings(), *nuisance_settings(screen, fit, scale)]
        found = errors(screen.simulator, screen.comparison, settings, list(runs), fit.conditions.onsets)
        if found is not None:
            return found
    return None


def _with_onsets(screen: Screen, fit: Fit, held: Sequence[int], nominal: Sequence[F64]) -> tuple[Fit, tuple[str, ...]]:
    """When a passing force begins in a run held out cannot be foretold: that alone is read off it, and reported."""
    passing = any("lasts" in c.candidate.names for c in fit.causes)
    if not passing or not held:
        return fit, ()
    known = find_onsets(screen.comparison, nominal)
    names = [screen.simulator.case.runs[i].name for i in held]
    new = {name: known[name] for name in names if name in known}
    read = ", ".join(f"{run} at {at:.2f} s" for run, at in new.items()) or "in none"
    warning = f"when the force begins in the runs of the check was read off them ({read}); nothing else was"
    return fit.under(onsets={**fit.conditions.onsets, **new}), (warning,)


def _name(cause: Cause) -> str:
    place = ", ".join(cause.candidate.place)
    return f"{cause.candidate.effect} {place}".strip()
