"""Fields of the GPU model of which every world has a row, and how randomisation writes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from trainer.physics.base import WorldParams
from trainer.physics.edits import friction_share, softened
from trainer.robots import TrainedRobot

TERRAIN_FIELDS = ("geom_size", "geom_rbound", "geom_aabb")
PARAM_FIELDS = (
    "geom_friction",
    "geom_solref",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_subtreemass",
    "actuator_gainprm",
    "actuator_biasprm",
    "dof_armature",
    "dof_frictionloss",
)
BATCHED = TERRAIN_FIELDS + PARAM_FIELDS


class WorldFields:
    """Torch's views of those fields beside their nominal values.

    The softness of constraints (`invweight0`) stays that of the nominal robot: recomputing it for a few worlds would
    cost more than the rest of the reset. Against the CPU engine, which recomputes it, a quadruped with 30 percent more
    armature is 0.2 mm and 8 mrad (at a joint) off after 0.3 s; one with other masses, not measurably.
    """

    def __init__(self, model: Any, host: Any, robot: TrainedRobot, device: torch.device) -> None:
        self._view = {name: wp.to_torch(getattr(model, name)) for name in PARAM_FIELDS}
        self._nominal = {name: view[0].clone() for name, view in self._view.items()}
        self._torso, self._base = host.body(robot.torso).id, host.body(robot.base).id
        self._above = {body: _mask(host, body, device) for body in {self._torso, self._base}}
        self._device = device
        self._share = torch.as_tensor(friction_share(host), dtype=torch.float32, device=device)
        self._soft = torch.as_tensor(np.flatnonzero(softened(host)), device=device)
        self._fastest = 2 * float(host.opt.timestep)

    def set(self, ids: Tensor, params: WorldParams) -> None:
        """Fields that `params` names, of the worlds `ids` (K,); what is not named keeps its value."""
        view, nominal = self._view, self._nominal
        if params.friction is not None:
            view["geom_friction"][ids, :, 0] = self._of(params.friction)[:, None] * self._share
        if params.contact_time is not None:
            slower = nominal["geom_solref"][self._soft, 0] + self._of(params.contact_time)[:, None]
            view["geom_solref"][ids[:, None], self._soft, 0] = slower.clamp_min(self._fastest)
        if params.mass_scale is not None or params.payload is not None:
            self._set_mass(ids, params)
        if params.com_offset is not None:
            view["body_ipos"][ids, self._torso] = nominal["body_ipos"][self._torso] + self._of(params.com_offset)
        if params.kp_scale is not None:
            kp = self._of(params.kp_scale)
            view["actuator_gainprm"][ids, :, 0] = nominal["actuator_gainprm"][:, 0] * kp
            view["actuator_biasprm"][ids, :, 1] = nominal["actuator_biasprm"][:, 1] * kp
        if params.kd_scale is not None:
            kd = self._of(params.kd_scale)
            view["actuator_biasprm"][ids, :, 2] = nominal["actuator_biasprm"][:, 2] * kd
        if params.armature_scale is not None:
            view["dof_armature"][ids, 6:] = nominal["dof_armature"][6:] * self._of(params.armature_scale)
        if params.joint_friction is not None:
            view["dof_frictionloss"][ids, 6:] = self._of(params.joint_friction)

    def _set_mass(self, ids: Tensor, params: WorldParams) -> None:
        """Base and torso scaled, the payload on the torso; every subtree that holds them weighs accordingly.

        The two belong together: a call that names one of them takes the other as unchanged from nominal.
        """
        none = torch.zeros(len(ids), device=self._device)
        scale = none + 1 if params.mass_scale is None else self._of(params.mass_scale)
        payload = none if params.payload is None else self._of(params.payload)
        mass, inertia = self._nominal["body_mass"], self._nominal["body_inertia"]
        subtree = self._nominal["body_subtreemass"].repeat(len(ids), 1)
        for body, above in self._above.items():
            heavier = mass[body] * (scale - 1) + (payload if body == self._torso else 0)
            self._view["body_mass"][ids, body] = mass[body] + heavier
            self._view["body_inertia"][ids, body] = inertia[body] * scale[:, None]
            subtree += heavier[:, None] * above
        self._view["body_subtreemass"][ids] = subtree

    def _of(self, values: Tensor) -> Tensor:
        return values.to(self._device, torch.float32)


def _mask(host: Any, body: int, device: torch.device) -> Tensor:
    """(nbody,) 1 for the body and all that carry it, the world included."""
    mask = torch.zeros(host.nbody, device=device)
    while True:
        mask[body] = 1.0
        if body == 0:
            return mask
        body = int(host.body_parentid[body])
