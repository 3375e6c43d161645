"""The verdict, with its reasons: from what stays in the fitted runs, and from a check on runs that no fit has seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.check import Check
from realsim.gap.inference.causes.fitted import is_gap
from realsim.gap.verdicts import GapVerdict

RIGHT = "what a right model leaves by sensor noise and small errors"
USUAL = "the usual differences between robots of one kind (a few per cent of friction, gains, masses)"


@dataclass(frozen=True)
class Fitted:
    """What stays in the fitted runs, in units of the floor."""

    before: float
    """Mean square of the nominal simulator."""
    left: F64
    """(K,) mean square a run beside causes and everyday deviations."""
    share: float
    """Share of the gap, which everyday deviations alone leave above the floor, that stays beside causes; run by run, so
    that one that diverges does not speak for all."""


@dataclass(frozen=True)
class Judgement:
    verdict: GapVerdict
    reasons: tuple[str, ...]
    at_an_end: tuple[str, ...] = ()
    """Strengths of the causes that lie at an end of their range."""
    stays: bool = False
    """Whether a good part of the gap stays beside the causes."""
    doubts: tuple[str, ...] = ()
    """What keeps the causes from being identified, where nothing stays."""


def judge(
    fitted: Fitted,
    checked: Check,
    causes: int,
    others: int,
    at_an_end: Sequence[str],
    unexplained_share: float,
    doubts: Sequence[str] = (),
) -> Judgement:
    """No gap, identified, ambiguous, partly explained or unexplained, with the reasons.

    Args:
        causes: how many are named.
        others: other sets that explain the runs as well.
        at_an_end: strengths at an end of their range, where a cause stands for something else.
        unexplained_share: share of the gap from which on a rest is reported as left.
        doubts: what keeps the causes from being all that there is: a size that no such robot has, an interval that
            holds zero, a law that the rest still looks like, a stronger cause that was dropped.
    """
    ends = tuple(at_an_end)
    allowed = f"{'the causes and ' if causes else ''}{USUAL} are allowed for"
    came = f"the simulator's error is {times(fitted.before)} {RIGHT}, and {times(fitted.left.mean())} once {allowed}"
    if not causes:
        verdict = GapVerdict.UNEXPLAINED if is_gap(fitted.left / figures.EXCESS) else GapVerdict.NO_GAP
        return Judgement(verdict, (came,))
    low, high = checked.ci90
    if not checked.holds:
        doubt = f"the causes do not hold: of the check's squared error {checked.fraction:z.0%} goes, 90 % interval "
        return Judgement(GapVerdict.UNEXPLAINED, (came, f"{doubt}{low:z.0%} to {high:z.0%}"), ends)
    if not checked.follows:
        doubt = "what stays is as large as the motion: were these the commands that this robot was given?"
        return Judgement(GapVerdict.UNEXPLAINED, (came, doubt), ends)
    if ends:
        doubt = f"{', '.join(ends)}: as far as the library goes, so it stands for something else"
        return Judgement(GapVerdict.UNEXPLAINED, (came, doubt), ends)
    stays = rest(fitted, checked, unexplained_share)
    acts = max(checked.where_it_acts, checked.horizons.fraction if checked.horizons else 0.0)
    if stays and acts < figures.NAMED_SHARE:
        doubt = f"only {acts:z.0%} of the check's error is removed in what the causes change"
        return Judgement(GapVerdict.UNEXPLAINED, (came, stays, doubt))
    reasons = tuple(r for r in (came, stays, *doubts) if r)
    if others:
        return Judgement(GapVerdict.AMBIGUOUS, reasons, (), bool(stays), tuple(doubts))
    if stays or doubts:
        return Judgement(GapVerdict.PARTLY_EXPLAINED, reasons, (), bool(stays), tuple(doubts))
    return Judgement(GapVerdict.IDENTIFIED, (came,))


def rest(fitted: Fitted, checked: Check, unexplained_share: float) -> str:
    """What stays beside causes and everyday deviations, in words; empty where that is nothing to speak of."""
    if is_gap(fitted.left) and fitted.share > unexplained_share:
        return f"{fitted.share:.0%} of the gap stays in the fitted runs"
    if (stays := _but_the_worst(fitted.left)) > figures.EXPLAINED:
        return f"in the fitted runs an error of {times(stays)} {RIGHT} stays"
    if checked.beside > figures.EXPLAINED and checked.unexplained > unexplained_share:
        return f"in the check {checked.unexplained:.0%} of the gap stays, {times(checked.beside)} {RIGHT}"
    return ""


def times(mean_square: float) -> str:
    """A mean square in units of the floor as words: 2.4 times."""
    return f"{mean_square**0.5:.2g} times"


def _but_the_worst(left: F64) -> float:
    """Mean of what stays, without the run that may have diverged where there are several."""
    return float(np.sort(left)[: max(len(left) - 1, 1)].mean())
