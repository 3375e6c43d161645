"""Shares of what a robot would feel that both verdicts, of a mesh and of a capture, check and reject."""

from collections.abc import Iterator, Mapping
from typing import Any


def shares(contact: Mapping[str, Any]) -> Iterator[tuple[str, float, float, float]]:
    """(name, share, check above, reject above) of what was measured.

    The limits to reject are wide of what five real captures have (at most 4 % through), and far below a corridor that
    had lost its walls (99 %).

    Args:
        contact: figures of the measure; `drop` and `sides` may be missing.
    """
    drop, sides = contact.get("drop"), contact.get("sides")
    if drop:
        off = drop["phantom_share"] + drop["missing_share"]
        yield "Places where the collision geometry is off by more than 2 cm in height", off, 0.05, 0.5
    if sides and sides["stopped"] is not None:
        yield "Rays from the side that pass through what was seen", sides["through"], 0.05, 0.25
        yield "Rays from the side that stop in free air", sides["early"], 0.05, 0.5
