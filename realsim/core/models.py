"""What a MuJoCo model must hold to be simulated."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.mjcf import check_mjcf, find_packages

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


REFERRING = ("actuators", "sensors", "tendons", "equalities", "excludes", "pairs")
"""Parts of an MjSpec that name others: a copy of it loses, without a word, those that name nothing."""


def load_mjcf(
    path: Path, root: Path | None = None, prepare: Callable[[Any], None] = lambda spec: None
) -> tuple[Any, Any, str]:
    """(MjSpec, MjModel, text) of an MJCF or URDF file that is safe to read and can be simulated.

    Args:
        root: see `check_mjcf`.
        prepare: changes the spec before it is compiled.

    Raises:
        GapError: it is not safe, does not compile, or holds numbers that no robot has.
    """
    import mujoco

    text = check_mjcf(path, root, GapError)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if root is None:
            find_packages(spec, path)
        copied = spec.copy()
        if any(len(getattr(copied, part)) != len(getattr(spec, part)) for part in REFERRING):
            spec.compile()  # which says what is missing
        prepare(spec)
        model = spec.copy().compile()
    except GapError:
        raise
    except Exception as error:  # MuJoCo raises ValueError and its own types
        found = str(error).splitlines()[0][:200]
        hint = f"mend it until MuJoCo loads it: python -m mujoco.viewer --mjcf={path}"
        if "opening file" in found:
            hint = "copy the robot's meshes to where the model looks for them, or take out the geoms that need them"
        if "balanceinertia" in found:
            hint = 'correct its inertia, or add <mujoco><compiler balanceinertia="true"/></mujoco> to the model'
        raise GapError("the model does not compile", file=path, found=found, hint=hint) from error
    if (odd := odd_number(model)) is not None:
        expected = "finite numbers of a robot's size"
        raise GapError("the model cannot be simulated", file=path, expected=expected, found=odd)
    return spec, model, text
