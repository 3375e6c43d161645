"""Conventions shared by the phone apps: ARKit's axes, its world, its levels of confidence.

ARKit (https://developer.apple.com/documentation/arkit/arconfiguration/worldalignment/gravity): a right-handed world
with y against gravity; the camera's axes are x right, y up, z backward (OpenGL's) for the image as the sensor has it,
in landscape. Depth has a smaller grid than colour over the same view.
"""

import numpy as np
from numpy.typing import ArrayLike

from realsim.core.errors import PoseError
from realsim.core.geometry import make_T, quat_to_R
from realsim.core.types import F64

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""(4, 4) from optical axes (x right, y down, z forward) to OpenGL's (x right, y up, z backward), and back."""
UP = np.array([0.0, 1.0, 0.0])
UP.setflags(write=False)
BEST_CONFIDENCE = 2
"""ARConfidenceLevel: 0 low, 1 medium, 2 high."""
WORLD_NOTE = "the world is ARKit's: y is up"
GRIDS_NOTE = "colour and depth are the same view on two grids; the camera is that of the colour image"
AXES_NOTE = (
    "poses are camera to world in metres with OpenGL camera axes (x right, y up, z backward), turned to OpenCV's"
)


def from_opengl(T_world_camera: ArrayLike) -> F64:
    """A camera-to-world matrix (4, 4) with OpenGL camera axes -> the same with OpenCV's. Only the camera's own axes
    change, so the flip stands on the right.
    """
    return np.asarray(T_world_camera, float) @ OPENGL


def pose_xyzw(numbers: ArrayLike) -> F64:
    """(4, 4) of `tx ty tz qx qy qz qw`. NaN is left in, to be refused with the other unusable poses.

    Raises:
        PoseError: another count, or a quaternion that is none.
    """
    row = np.asarray(numbers, float)
    if row.shape != (7,):
        raise PoseError("a pose of the wrong length", expected="7 numbers: tx ty tz qx qy qz qw", found=f"{row.size}")
    if not np.isfinite(row).all():
        return np.full((4, 4), np.nan)
    if abs(np.linalg.norm(row[3:]) - 1) > 0.05:
        raise PoseError("the pose has no valid quaternion", expected="length 1", found=f"{row[3:].tolist()}")
    # The real part is last in the file, quat_to_R wants it first.
    return make_T(quat_to_R(row[[6, 3, 4, 5]]), row[:3])
