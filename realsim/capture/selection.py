"""Fewer frames when there are too many: evenly over what changes in the view, the sharpest of each stretch."""

from collections.abc import Sequence

import numpy as np

from realsim.capture.survey import Look
from realsim.core.geometry import angle_deg
from realsim.core.types import F64, Dropped, Frame

FULL_TURN_DEG = 60.0
"""A rotation after which nothing of the first view is left (the field of view of a depth camera)."""
NOT_NEEDED = "not needed"
"""How the reason of a frame begins that is good but not among the picked."""
STILL = 0.01
"""Change counted for a step even if nothing moved, so that a camera at rest still gets a frame now and then."""


def pick(frames: Sequence[Frame], looks: Sequence[Look], limit: int) -> list[Dropped]:
    """The frames to leave out so that at most `limit` (0: all) remain. Deterministic; linear in the frames.

    The path through the capture is cut into stretches of equal view change, and the sharpest frame of each is kept.
    """
    if limit == 0 or len(frames) <= limit:
        return []
    travelled = np.concatenate([[0.0], np.cumsum(view_changes(frames, looks))])
    kept = _best_cut(travelled, [look.sharpness or 0.0 for look in looks], limit)
    reason = f"{NOT_NEEDED}: at most {limit} of {len(frames)} frames are picked by sharpness and view change"
    return [Dropped(frame.name, reason, lost=False) for i, frame in enumerate(frames) if i not in kept]


def view_changes(frames: Sequence[Frame], looks: Sequence[Look]) -> F64:
    """(N-1,) how much of the view changes from one frame to the next: about 0 nothing, 1 everything.

    With poses: translation against the depth of the scene plus rotation against the field of view. Without: how far
    the thumbnails are from being correlated.
    """
    changes = []
    for i in range(1, len(frames)):
        A, B = frames[i - 1].T_world_camera, frames[i].T_world_camera
        if A is not None and B is not None:
            depth = max(np.nanmedian([looks[i - 1].median_depth, looks[i].median_depth]), 1e-3)
            moved = float(np.linalg.norm(B[:3, 3] - A[:3, 3])) / depth
            change = moved + angle_deg(A[:3, :3].T @ B[:3, :3]) / FULL_TURN_DEG
        else:
            change = (1.0 - float((looks[i - 1].thumbnail * looks[i].thumbnail).mean())) / 2
        # A jump of the poses must not use up all stretches: beyond a whole new view, more is not more.
        changes.append(min(max(change, 0.0), 1.0) + STILL)
    return np.array(changes)


def _best_cut(travelled: F64, sharpness: Sequence[float], limit: int) -> set[int]:
    """The finest cut into equal stretches that still keeps at most `limit` frames (some stretches hold none)."""
    best = _sharpest(travelled, sharpness, limit)
    low, high = limit, 64 * limit
    while low <= high:
        stretches = (low + high) // 2
        kept = _sharpest(travelled, sharpness, stretches)
        if len(kept) <= limit:
            best = kept if len(kept) >= len(best) else best
            low = stretches + 1
        else:
            high = stretches - 1
    return best


def _sharpest(travelled: F64, sharpness: Sequence[float], stretches: int) -> set[int]:
    """Index of the sharpest frame of each stretch that holds any; the earlier of equals."""
    stretch = np.minimum((travelled / travelled[-1] * stretches).astype(int), stretches - 1)
    best: dict[int, int] = {}
    for i, s in enumerate(stretch):
        if s not in best or sharpness[i] > sharpness[best[s]]:
            best[int(s)] = i
    return set(best.values())
