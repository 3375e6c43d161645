"""Joint coefficients, which newer MuJoCo holds as a polynomial whose first term is the linear one."""

import mujoco
import numpy as np


def first(joint: mujoco.MjsJoint, name: str) -> float:
    """The linear coefficient of a joint's `stiffness` or `damping`."""
    return float(np.ravel(getattr(joint, name))[0])


def set_first(joint: mujoco.MjsJoint, name: str, value: float) -> None:
    """Set the linear coefficient, and the others to zero."""
    current = getattr(joint, name)
    if np.isscalar(current):
        setattr(joint, name, value)
    else:
        filled = np.zeros(len(current))
        filled[0] = value
        setattr(joint, name, filled)
