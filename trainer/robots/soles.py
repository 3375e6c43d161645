"""Where a foot meets the ground."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import quat_to_R

GRID = (9, 4)
"""Points along and across a sole. Even spacing matters: with points only under the ends of G1's capsules, an edge below
the arch of the foot was invisible, and sliding off a small stake paid."""


def sole_points(spec: Any, foot: str) -> NDArray[np.float64]:
    """(P, 3) points on the sole of a foot in the foot body's frame, metres.

    An even grid over the rectangle around the lowest points of the foot's collision primitives, at their mean height;
    the lowest point itself for a foot that is a sphere.

    Args:
        spec: `mujoco.MjSpec` that holds the body.
        foot: name of the body; its z axis points up when the foot is level.
    """
    lowest = _lowest_points(spec, foot)
    if len(lowest) == 1:
        return lowest
    (x0, y0, _), (x1, y1, _) = lowest.min(0), lowest.max(0)
    x, y = np.meshgrid(np.linspace(x0, x1, GRID[0]), np.linspace(y0, y1, GRID[1]), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, lowest[:, 2].mean())], -1)


def _lowest_points(spec: Any, foot: str) -> NDArray[np.float64]:
    """(Q, 3) two a capsule (below its ends) and one a sphere."""
    import mujoco

    points = []
    for geom in spec.body(foot).geoms:
        radius, half = float(geom.size[0]), float(geom.size[1])
        centre = np.asarray(geom.pos, float)
        if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            axis = quat_to_R(np.asarray(geom.quat, float))[:, 2] * half
            ends = [centre - axis, centre + axis]
        else:
            ends = [centre]
        points += [end - [0, 0, radius] for end in ends]
    return np.array(points)
