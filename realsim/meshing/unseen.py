"""What no camera saw of the ground and the tops, and from where it would come into view."""

from typing import Any

import numpy as np

from realsim.core.types import F64, AlignedScene
from realsim.meshing.surface import Surface

ANGLES, RADII, EYE = 16, (0.8, 1.6), 1.3
"""Places tried about the middle of what is missing: directions, metres away, metres above the ground."""
SAMPLES = 1500


def unseen(aligned: AlignedScene, seen: Surface, invented: Surface, seed: int = 0) -> dict[str, Any]:
    """Areas of what faces up, on the robot's way and in all, and the place for a camera that would see most of what is
    missing (on the way, where that is known).

    Returns:
        JSON-able: `area_m2`, `unseen_m2`; with start and goal also `way_area_m2`, `way_unseen_m2`; where something is
        missing, `look_from` (x, y in the simulation frame, metres) and the `share` of it that is in view from there.
    """
    both = (seen, invented)
    up = [np.maximum(s.crosses()[:, 2], 0) / 2 for s in both]
    out: dict[str, Any] = {"area_m2": float(sum(a.sum() for a in up)), "unseen_m2": float(up[1].sum())}
    way = [aligned.on_way(s.centres()[:, :2]) for s in both]
    weight = up[1]
    if way[0] is not None and way[1] is not None:
        weight = weight * way[1]
        out["way_area_m2"] = float((up[0] * way[0]).sum() + weight.sum())
        out["way_unseen_m2"] = float(weight.sum())
    if weight.sum() > 0:
        out |= _best_place(seen, invented.centres(), weight, aligned.ground_z, seed)
    return out


def _best_place(seen: Surface, centres: F64, weight: F64, ground_z: float, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    target = centres[rng.choice(len(centres), SAMPLES, p=weight / weight.sum())] + [0, 0, 0.02]
    middle = np.average(centres, axis=0, weights=weight)
    turn = 2 * np.pi * np.arange(ANGLES) / ANGLES
    around = np.column_stack([np.cos(turn), np.sin(turn)])
    places = np.concatenate([middle[:2] + r * around for r in RADII])
    rays = seen.rays()
    shares = []
    for place in places:
        way = np.array([*place, ground_z + EYE]) - target
        shares.append(float((rays.cast(target, way)[0] > 1).mean()))  # the place is at 1 length of the ray
    best = int(np.argmax(shares))
    return {"look_from": places[best].tolist(), "share": shares[best]}
