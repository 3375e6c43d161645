"""What a MuJoCo model must hold to be simulated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError

NEVER_INFINITE = ("body_", "dof_", "geom_", "jnt_pos", "jnt_axis", "site_", "qpos0", "key_", "actuator_gear", "mesh_")
"""Fields, by how their names begin, of which an infinite one is damage; limits and ranges may be infinite."""
LARGEST = 1e8
"""Of a mass in kg, an inertia, a place in metres: MuJoCo compiles larger ones, and then divides by nothing."""
SIZES = ("body_mass", "body_inertia", "body_pos", "body_ipos", "jnt_pos", "dof_armature", "dof_damping", "opt.gravity")


def odd_number(model: Any) -> str | None:
    """The first field of a compiled mujoco.MjModel with a NaN, or with a number no robot has; None if there is none.

    MuJoCo compiles `damping="nan"` and `mass="1e30"` without a word, and what is simulated with them is not a number.
    """
    fields = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    fields |= {f"opt.{name}": np.asarray(getattr(model.opt, name)) for name in ("timestep", "gravity", "wind")}
    for name, values in fields.items():
        if not (isinstance(values, np.ndarray) and values.dtype.kind == "f"):
            continue
        bad = np.isnan(values) | (name.startswith(NEVER_INFINITE) & np.isinf(values))
        if name in SIZES:
            bad |= np.abs(values) > LARGEST
        if bad.any():
            return f"{name} holds {values[bad].flat[0]:g}"
    return None


def not_compiled(path: Path, error: Exception) -> GapError:
    """What to say of a model that MuJoCo refuses."""
    found = str(error).splitlines()[0][:200]
    missing = "opening file" in found
    hint = "copy the robot's meshes to where the model looks for them, or take out the geoms that need them"
    return GapError("the model does not compile", file=path, found=found, hint=hint if missing else None)
