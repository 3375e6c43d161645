"""Interface of robots."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Robot:
    """A robot that can be attached to a scene."""

    name: str
    spec: Any
    """`mujoco.MjSpec` with one free-floating root body; its origin stands on z = 0 in the key frame `home`."""
    root: str
    """Name of the root body."""
    base_height: float
    """Metres from the ground under the feet to the root body's origin in the pose `home`."""
    home: dict[str, float]
    """Joint name -> radians of the pose `home`; joints that are not named are at 0."""
    files: dict[str, bytes] = field(default_factory=dict)
    """Files that the specification refers to (meshes, textures), by relative name."""

    def placed(self, ground: NDArray[np.float64]) -> Robot:
        """The same robot with the ground under its feet at (3,) `ground`, facing +x, in its key frame too."""
        spec = self.spec.copy()
        spec.body(self.root).pos = spec.body(self.root).pos + ground
        for key in spec.keys:
            key.qpos = np.concatenate([np.asarray(key.qpos)[:3] + ground, np.asarray(key.qpos)[3:]])
        return replace(self, spec=spec)


def holding_ctrl(
    model: Any, qpos: NDArray[np.float64], feet: tuple[str, ...], below_com: bool = True
) -> NDArray[np.float64]:
    """(nu,) target angles at which position servos hold `qpos` (nq,) against gravity, the feet sharing the weight.

    The servos are soft: without this the legs sag, the centre of mass moves ahead of the feet and the robot falls
    within a second. Static balance of a floating base: joint torque = gravity torque - sum of J_foot^T f_foot.

    Args:
        model: a compiled model whose first joint is free and whose actuators are one servo per joint, in joint order.
        feet: names of sites on the soles.
        below_com: the weight acts on the soles below the centre of mass (a biped's flat feet); otherwise at the sites
            themselves (point feet placed evenly around the centre of mass).
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    torque = data.qfrc_bias.copy()
    weight = -model.opt.gravity * model.body_mass.sum()
    for foot in feet:
        site = data.site(foot)
        point = np.array([data.subtree_com[0, 0] if below_com else site.xpos[0], site.xpos[1], site.xpos[2]])
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, model.site(foot).bodyid[0])
        torque -= jacobian.T @ (weight / len(feet))
    joints = model.actuator_trnid[:, 0]
    return qpos[model.jnt_qposadr[joints]] + torque[model.jnt_dofadr[joints]] / model.actuator_gainprm[:, 0]
