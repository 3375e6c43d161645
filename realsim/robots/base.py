"""Interface of robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import R_to_quat, exp_so3


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


LOOK = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
"""Columns: right, up and back of a MuJoCo camera (it looks along -z with y up) that faces +x of its mount."""


def add_body(parent: Any, row: dict[str, Any]) -> Any:
    """A body by a row of a robot's table: place in its parent, mass, centre of mass, principal inertia."""
    names = {"com": "ipos", "inertia_quat": "iquat", "inertia_diag": "inertia"}
    return parent.add_body(explicitinertial=True, **{names.get(k, k): v for k, v in row.items() if k != "parent"})


def add_servo(spec: Any, joint: str, kp: float, kd: float, effort: float) -> None:
    """A position servo of the joint's name: ctrl is the target angle, rad.

    Args:
        kp: N m/rad.
        kd: N m s/rad.
        effort: N m, to which its torque is limited.
    """
    import mujoco

    spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=[kp] + [0] * 9,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        biasprm=[0, -kp, -kd] + [0] * 7,
        forcerange=[-effort, effort],
        forcelimited=True,
        ctrllimited=False,
    )


def add_camera(body: Any, name: str, pos: Sequence[float], pitch_rad: float, fovy_deg: float) -> None:
    """A camera that looks along +x of the body, pitched down; vertical opening in degrees."""
    quat = R_to_quat(exp_so3([0, pitch_rad, 0]) @ LOOK)
    body.add_camera(name=name, pos=pos, quat=quat, fovy=fovy_deg)


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
