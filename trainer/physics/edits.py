"""Per-world changes of a CPU model: domain randomisation and gap patches."""

from dataclasses import fields
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trainer.physics.base import WorldParams
from trainer.robots import TrainedRobot

Edit = dict[str, NDArray[np.float64]]
"""Field of `WorldParams` -> this world's value; what is left alone is absent."""


def rows(params: WorldParams) -> list[Edit]:
    """One edit a row of `params`."""
    given = {f.name: getattr(params, f.name) for f in fields(params) if getattr(params, f.name) is not None}
    arrays = {name: value.detach().cpu().numpy().astype(float) for name, value in given.items()}
    count = len(next(iter(arrays.values()))) if arrays else 0
    return [{name: value[i] for name, value in arrays.items()} for i in range(count)]


def apply(model: Any, nominal: Any, robot: TrainedRobot, edit: Edit, data: Any) -> None:
    """Make `model`, a copy of the compiled `nominal`, its nominal self with one world's changes.

    Every field that an edit can touch is written, so that a copy can serve one world after another. `data` is scratch
    for recomputing what depends on the changes.
    """

    def scale(name: str) -> Any:
        return edit.get(name, 1.0)

    torso, base = model.body(robot.torso).id, model.body(robot.base).id
    model.geom_friction[:] = nominal.geom_friction
    if "friction" in edit:
        model.geom_friction[:, 0] = edit["friction"] * friction_share(nominal)
    model.geom_solref[:] = nominal.geom_solref
    if "contact_time" in edit:
        soft = softened(nominal)
        slower = nominal.geom_solref[soft, 0] + edit["contact_time"]
        model.geom_solref[soft, 0] = np.maximum(slower, 2 * nominal.opt.timestep)
    for body in {torso, base}:
        model.body_mass[body] = nominal.body_mass[body] * scale("mass_scale")
        model.body_inertia[body] = nominal.body_inertia[body] * scale("mass_scale")
    model.body_mass[torso] += edit.get("payload", 0.0)
    model.body_ipos[torso] = nominal.body_ipos[torso] + edit.get("com_offset", 0.0)
    model.actuator_gainprm[:, 0] = nominal.actuator_gainprm[:, 0] * scale("kp_scale")
    model.actuator_biasprm[:, 1] = nominal.actuator_biasprm[:, 1] * scale("kp_scale")
    model.actuator_biasprm[:, 2] = nominal.actuator_biasprm[:, 2] * scale("kd_scale")
    model.dof_armature[6:] = nominal.dof_armature[6:] * scale("armature_scale")
    model.dof_frictionloss[6:] = edit.get("joint_friction", nominal.dof_frictionloss[6:])
    mujoco.mj_setConst(model, data)


def friction_share(nominal: Any) -> NDArray[np.float64]:
    """(ngeom,) share of a world's friction that a geom has: slippery or rough places of a scene stay so."""
    return np.where(nominal.geom_bodyid == 0, nominal.geom_friction[:, 0], 1.0)


def softened(nominal: Any) -> NDArray[np.bool_]:
    """(ngeom,) whether a geom is terrain whose contacts have a time constant."""
    return (nominal.geom_bodyid == 0) & (nominal.geom_solref[:, 0] > 0)
