"""What a diagnosis concludes, and how each conclusion is worded: one table for terminal, page, JSON and exit code."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

Level = Literal["good", "look", "bad"]


class GapVerdict(StrEnum):
    """What a diagnosis concludes."""

    NO_GAP = "no_gap"
    IDENTIFIED = "identified"
    AMBIGUOUS = "ambiguous"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Wording:
    """How a verdict is shown."""

    word: str
    headline: str
    level: Level
    """`good`: act on it; `look`: read on first; `bad`: do not use the patched model."""


WORDINGS = {
    GapVerdict.NO_GAP: Wording("No gap", "the runs show no gap beyond noise and everyday deviations", "good"),
    GapVerdict.IDENTIFIED: Wording("Identified", "what is named holds on the check", "good"),
    GapVerdict.AMBIGUOUS: Wording("Cannot tell apart", "several causes explain these runs equally well", "look"),
    GapVerdict.PARTLY_EXPLAINED: Wording(
        "Partly explained", "what is named holds on the check, and part of the gap stays", "look"
    ),
    GapVerdict.UNEXPLAINED: Wording(
        "Unexplained", "no known effect explains the gap: do not use the patched model", "bad"
    ),
}
