"""Selects the views that are adjusted together in a dense capture.

A video of thirty frames a second shows everything a hundred times. Views that hardly differ tell a joint adjustment
nothing new, but couple to each other: its cost would grow with the square of the frame rate and more. So only views
that moved on from the last one are adjusted together; the others follow them (localize.py), each on its own.
"""

from collections.abc import Callable, Sequence

import numpy as np

from realsim.core.geometry import invert_T
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import View
from realsim.feedforward.rgbd.matching import is_believable, match_by_features

DENSE = 100
"""Up to this many views all are adjusted together."""
SHIFT, TURN = 0.04, np.radians(3.0)
"""A view is new if it moved by more than this share of the scene's distance (6 cm at 1.5 m), or turned by more."""

Followers = dict[int, tuple[int, F64]]
"""Index of a view -> (index of its keyframe, (4, 4) points of the view into the keyframe's camera)."""


def choose_by_poses(views: Sequence[View], T_world_camera: F64) -> tuple[list[int], Followers]:
    """Keyframes and followers where poses (N, 4, 4) are given."""
    return _swept(views, lambda key, k: invert_T(T_world_camera[key]) @ T_world_camera[k])


def choose_by_matching(views: Sequence[View], seed: int) -> tuple[list[int], Followers]:
    """The same from features alone: one pair per view. What cannot be matched to its keyframe is one itself."""

    def motion(key: int, k: int) -> F64 | None:
        found = match_by_features(views, key, k, seed)
        return found[0].T_i_j if found is not None and is_believable(found[1]) else None

    return _swept(views, motion)


def _swept(views: Sequence[View], motion: Callable[[int, int], F64 | None]) -> tuple[list[int], Followers]:
    """Walk through the sequence; a view is compared with the keyframe before it."""
    if len(views) <= DENSE:
        return list(range(len(views))), {}
    keys, followers = [0], Followers()
    for k in track(range(1, len(views)), "keyframes"):
        key = keys[-1]
        T = motion(key, k) if min(len(views[key].z), len(views[k].z)) else None
        if T is not None and _near(T, views[key]):
            followers[k] = (key, T)
        else:
            keys.append(k)
    return keys, followers


def _near(T: F64, view: View) -> bool:
    known = view.depth[view.depth > 0]
    if not len(known):
        return False
    turn = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
    return bool(turn < TURN and np.linalg.norm(T[:3, 3]) < SHIFT * np.median(known))
