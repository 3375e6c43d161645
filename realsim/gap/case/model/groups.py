"""Groups of alike joints: the same joint on another leg or side."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

SIDES = re.compile(r"(^|[_\-. ])(left|right|l|r|fl|fr|hl|hr|rl|rr|lf|rf|lh|rh|front|hind|rear|back)(?=[_\-. ]|$)", re.I)


def kind_of(joint: str) -> str:
    """The joint's name without its side or leg: left_knee_joint and right_knee_joint are of one kind."""
    return SIDES.sub(r"\1", joint).strip("_-. ").lower()


def leg_of(joint: str) -> str | None:
    """The side or leg in a joint's name, or None."""
    found = SIDES.search(joint)
    return found.group(2).lower() if found else None


def like_joints(joints: Sequence[str]) -> list[tuple[str, ...]]:
    """Groups of two or more joints that may share a cause: of one kind, of one leg, all."""
    by_kind, by_leg = defaultdict(list), defaultdict(list)
    for joint in joints:
        by_kind[kind_of(joint)].append(joint)
        leg = leg_of(joint)
        if leg:
            by_leg[leg].append(joint)
    groups = [tuple(g) for g in [*by_kind.values(), *by_leg.values(), list(joints)] if len(g) > 1]
    return list(dict.fromkeys(groups))
