"""Where a foot meets the ground."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.geometry import quat_to_R


def sole_points(spec: Any, foot: str) -> NDArray[np.float64]:
    """(P, 3) lowest points of a foot's collision primitives in the foot body's frame, metres.

    Two a capsule (below its ends) and one a sphere; the sole of a foot made of parallel capsules is covered by these.

    Args:
        spec: `mujoco.MjSpec` that holds the body.
        foot: name of the body; its z axis points up when the foot is level.
    """
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
