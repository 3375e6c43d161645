"""One robot on one terrain as a MuJoCo specification. Both engines are built from it, so that they simulate the same.

Terrain made of boxes becomes a fixed number of box slots, the unused ones parked out of reach: worlds on different
terrain then have models of the same size, which lets one batch hold them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from realsim.core.geometry import R_to_quat
from realsim.core.types import F64
from trainer.errors import TrainerError
from trainer.robots import TrainedRobot
from trainer.terrain import Terrain

if TYPE_CHECKING:
    from trainer.physics.base import PhysicsConfig


GROUND, SLOT, SCENE = "ground", "slot", "scene"
PARKED_Z = -1000.0
"""Height of unused slots, metres: nothing ever gets there."""
TERRAIN_BIT, ROBOT_BIT = 1, 2
"""Collision bits: terrain never collides with terrain; the robot with terrain, and with itself when requested."""


def slots_for(terrains: Sequence[Terrain]) -> int:
    """Box slots that every world needs, so that each of these terrains fits."""
    return max((len(t.boxes) for t in terrains), default=0)


def box_poses(terrain: Terrain, slots: int) -> tuple[F64, F64, F64]:
    """Half edges (K, 3), centres (K, 3) and rotations (K, 3, 3) of the K slots; metres, terrain frame."""
    half, pos, R = np.full((slots, 3), 0.01), np.zeros((slots, 3)), np.tile(np.eye(3), (slots, 1, 1))
    pos[:, 2] = PARKED_Z
    for k, box in enumerate(terrain.boxes):
        half[k], pos[k], R[k] = np.asarray(box.size) / 2, box.T[:3, 3], box.T[:3, :3]
    return half, pos, R


def world_spec(
    robot: TrainedRobot,
    terrain: Terrain,
    slots: int,
    config: PhysicsConfig,
    contacts: Sequence[Any] | None = None,
) -> Any:
    """`mujoco.MjSpec` of the robot, the ground plane, `slots` boxes and the contact geoms of reconstructed scenes.

    Geom `ground` is the plane, `slot0` ... the boxes; geoms of scene i are named `scene<i>/...`.

    Args:
        contacts: the scenes' own contact specifications (None among them for terrain made of boxes); left out, the
            terrain's own.
    """
    spec = robot.robot.spec.copy()
    # Newton with few iterations: contacts of capsules on boxes converge within them, and the batch keeps in step.
    spec.option.timestep = config.timestep
    # The servos' damping acts implicitly: explicit integration of kd / armature = 250 / s at 5 ms would ring.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{config.cone.upper()}")
    spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{config.solver.upper()}")
    spec.option.iterations = config.iterations
    spec.option.ls_iterations = config.ls_iterations
    spec.option.jacobian = getattr(mujoco.mjtJacobian, f"mjJAC_{config.jacobian.upper()}")
    # A world that went wrong is reported by the engine, not silently restarted from the zero pose.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for geom in spec.geoms:
        if not (geom.contype or geom.conaffinity):
            continue  # only drawn
        geom.contype = ROBOT_BIT if config.self_collision else 0
        geom.conaffinity = TERRAIN_BIT | ROBOT_BIT if config.self_collision else TERRAIN_BIT
    _add_terrain_geom(
        spec.worldbody, name=GROUND, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, terrain.floor_z]
    )
    for k, (half, pos, R) in enumerate(zip(*box_poses(terrain, slots), strict=True)):
        _add_terrain_geom(
            spec.worldbody, name=f"{SLOT}{k}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=pos, quat=R_to_quat(R)
        )
    for i, contact in enumerate([terrain.contact] if contacts is None else contacts):
        if contact is not None:
            _attach_contact(spec, contact, f"{SCENE}{i}/")
    for key in list(spec.keys):
        spec.delete(key)
    if config.softness != 1.0:
        for geom in spec.geoms:
            geom.solref = [config.softness * geom.solref[0], geom.solref[1]]
    return spec


def check_order(robot: TrainedRobot, model: Any) -> None:
    """Joint j of the robot is qpos[7 + j], qvel[6 + j] and ctrl[j]: engines rely on it.

    Raises:
        TrainerError: it is not.
    """
    joints = [model.joint(i).name for i in range(1, model.njnt)]
    actuated = [model.joint(i).name for i in model.actuator_trnid[:, 0]]
    if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE or not joints == actuated == list(robot.joints):
        raise TrainerError(
            f"the robot {robot.robot.name} cannot be simulated",
            expected="a free joint, then one actuator per hinge in the order of the body tree",
            found=f"joints {joints}, actuators on {actuated}",
        )


def _add_terrain_geom(parent: Any, **fields: Any) -> None:
    parent.add_geom(contype=TERRAIN_BIT, conaffinity=0, rgba=[0.55, 0.55, 0.6, 1], **fields)


def _attach_contact(spec: Any, contact: Any, prefix: str) -> None:
    """A reconstructed scene's contact geoms, meshes and all."""
    child = contact.copy()
    for k, geom in enumerate(child.geoms):
        geom.name = geom.name or f"geom{k}"
    for geom in child.geoms:
        geom.contype, geom.conaffinity = TERRAIN_BIT, 0
        if geom.friction[0] != 1.0:
            geom.priority = 1  # its own friction acts, where MuJoCo would take the larger of two
    for key in list(child.keys):
        child.delete(key)
    # A scene's clipping planes are for its own viewer; attached, they would only be warned about.
    child.visual.map.znear, child.visual.map.zfar = spec.visual.map.znear, spec.visual.map.zfar
    spec.attach(child, prefix=prefix, frame=spec.worldbody.add_frame())
