"""The one interface between a task and an engine. The task is written once, in torch, against this."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

from realsim.core.registry import Registry
from trainer.robots import TrainedRobot
from trainer.terrain import Terrain

ENGINES = Registry(
    "physics engine",
    {
        "mujoco": "trainer.physics.mujoco:MujocoPhysics",
        "elliptic": "trainer.physics.mujoco:elliptic",
        "warp": "trainer.physics.warp:WarpPhysics",
    },
)
"""name -> `(robot, terrains, worlds, config: PhysicsConfig) -> Physics`. `elliptic` is another contact model than
policies are trained in: elliptic friction cones, half the timestep, another solver."""


MAX_SPEED = 100.0
"""m/s of the base; ten times as many rad/s of anything. What walks gets nowhere near, a diverging solver beyond."""


@dataclass(frozen=True)
class PhysicsConfig:
    """Options of the engine."""

    timestep: float = 0.005
    """Seconds a physics step."""
    decimation: int = 4
    """Physics steps a policy step (4 x 5 ms: 50 Hz)."""
    self_collision: bool = False
    """Whether the robot's own capsules collide with each other; a task may ask for it too (`ParkourConfig`)."""
    device: str = "cpu"
    """torch device of the state; `warp` needs a CUDA device to be fast."""
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    """Friction cones of contacts; the GPU engine has pyramids."""
    solver: Literal["newton", "cg", "pgs"] = "newton"
    """Solver of the constraints."""
    softness: float = 1.0
    """Ratio on the time constant with which contacts push back (MuJoCo's solref, 20 ms): above 1 softer."""
    iterations: int = 10
    """Newton iterations of the constraint solver, at most."""
    ls_iterations: int = 20
    """Line search steps an iteration, at most."""
    threads: int = 0
    """CPU engine: threads of mujoco.rollout; 0 takes all cores."""
    contacts_per_world: int = 64
    """GPU engine: contacts (and candidate pairs) that there is room for, on average over the worlds."""
    constraints_per_world: int = 448
    """GPU engine: rows of constraints that there is room for in every world (a contact takes four). G1 needed 112 at
    most on `stake3`, 272 on its reconstruction (134 parts), 380 on one of a mixed course (383); 320 dropped some."""
    broadphase: Literal["auto", "nxn", "sap"] = "auto"
    """GPU engine: how pairs of geoms that may touch are found; all pairs is fastest for some hundred of them."""
    jacobian: Literal["auto", "dense", "sparse"] = "auto"
    """How constraint Jacobians are stored; `auto` is the engine's own choice."""
    seed: int = 0


@dataclass
class State:
    """State of all worlds after a policy step, as tasks see it. float32 on the engine's device; rows are worlds.

    Positions are in the frame of the world's own terrain. Tensors may be overwritten in place by the next step.
    """

    base_pos: Tensor
    """(N, 3) m."""
    base_quat: Tensor
    """(N, 4) w x y z, base to world."""
    base_lin_vel: Tensor
    """(N, 3) m/s, world axes, of the base body's origin."""
    base_ang_vel: Tensor
    """(N, 3) rad/s, base axes."""
    joint_pos: Tensor
    """(N, J) rad."""
    joint_vel: Tensor
    """(N, J) rad/s."""
    joint_acc: Tensor
    """(N, J) rad/s^2, finite difference over the policy step."""
    joint_torque: Tensor
    """(N, J) N m applied by the servos at the last physics step."""
    torso_pos: Tensor
    """(N, 3) m."""
    torso_quat: Tensor
    """(N, 4) w x y z."""
    camera_pos: Tensor
    """(N, 3) m of the camera mount's body; equals the torso's without a camera."""
    camera_quat: Tensor
    """(N, 4) w x y z of that body."""
    foot_pos: Tensor
    """(N, F, 3) m, origin of the foot bodies."""
    foot_quat: Tensor
    """(N, F, 4) w x y z."""
    foot_lin_vel: Tensor
    """(N, F, 3) m/s, world axes, of the foot bodies' origins."""
    foot_ang_vel: Tensor
    """(N, F, 3) rad/s, world axes."""
    foot_force: Tensor
    """(N, F) N, total contact force magnitude on each foot."""
    ground_contact: Tensor
    """(N,) bool, any body touches the ground plane now or did during the policy step."""
    other_contact: Tensor
    """(N,) bool, any body that is not a foot touches terrain or (if on) itself."""
    diverged: Tensor
    """(N,) bool, the state is not finite or absurdly fast; such a world must be reset."""


@dataclass
class WorldParams:
    """Per-world changes against the nominal robot, for domain randomisation and gap patches. None leaves it alone."""

    friction: Tensor | None = None
    """(N,) sliding friction of terrain and feet (absolute mu); a scene's geoms have their own friction as a share."""
    contact_time: Tensor | None = None
    """(N,) s added to the time constant of contacts of the terrain (MuJoCo's solref; two physics steps at least)."""
    mass_scale: Tensor | None = None
    """(N,) ratio on the base/torso mass and inertia."""
    payload: Tensor | None = None
    """(N,) kg added to the torso."""
    com_offset: Tensor | None = None
    """(N, 3) m, on the torso's centre of mass."""
    kp_scale: Tensor | None = None
    """(N, J)."""
    kd_scale: Tensor | None = None
    """(N, J)."""
    armature_scale: Tensor | None = None
    """(N, J)."""
    joint_friction: Tensor | None = None
    """(N, J) N m, Coulomb friction (absolute)."""
    delay_steps: Tensor | None = None
    """(N,) int, physics steps by which commands arrive late, 0 to decimation."""


def empty_state(robot: TrainedRobot, worlds: int, device: torch.device) -> State:
    """A state of zeros (quaternions of no rotation) with the shapes that this robot needs."""
    joints, feet = len(robot.joints), len(robot.feet)

    def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(worlds, *shape, dtype=dtype, device=device)

    def quats(*shape: int) -> Tensor:
        identity = zeros(*shape, 4)
        identity[..., 0] = 1.0
        return identity

    return State(
        base_pos=zeros(3),
        base_quat=quats(),
        base_lin_vel=zeros(3),
        base_ang_vel=zeros(3),
        joint_pos=zeros(joints),
        joint_vel=zeros(joints),
        joint_acc=zeros(joints),
        joint_torque=zeros(joints),
        torso_pos=zeros(3),
        torso_quat=quats(),
        camera_pos=zeros(3),
        camera_quat=quats(),
        foot_pos=zeros(feet, 3),
        foot_quat=quats(feet),
        foot_lin_vel=zeros(feet, 3),
        foot_ang_vel=zeros(feet, 3),
        foot_force=zeros(feet),
        ground_contact=zeros(dtype=torch.bool),
        other_contact=zeros(dtype=torch.bool),
        diverged=zeros(dtype=torch.bool),
    )


class Physics(Protocol):
    """N worlds of one robot, each on one of the terrains."""

    robot: TrainedRobot
    terrains: Sequence[Terrain]
    num_worlds: int
    config: PhysicsConfig
    device: torch.device
    policy_dt: float
    state: State
    overflowed: int
    """Policy steps of a world in which contacts or constraints were dropped because a buffer was full: reported."""
    solver_limited: int
    """Policy steps of a world in which the solver stopped at its iteration limit. Harmless where it is rare."""

    def step(self, targets: Tensor) -> State:
        """Hold the joint targets (N, J) in rad for one policy step; servo torques are clipped to the effort limits."""

    def reset(
        self,
        ids: Tensor,
        base_pos: Tensor,
        base_quat: Tensor,
        joint_pos: Tensor,
        terrain_ids: Tensor,
    ) -> None:
        """Put the worlds `ids` (K,) at rest in the given pose (K, 3), (K, 4), (K, J) on terrains (K,)."""

    def set_velocity(self, ids: Tensor, base_lin_vel: Tensor, base_ang_vel: Tensor) -> None:
        """Overwrite base velocities (K, 3) world axes and (K, 3) base axes: pushes."""

    def set_params(self, ids: Tensor, params: WorldParams) -> None:
        """Apply per-world parameters; rows of `params` belong to `ids` (K rows)."""
