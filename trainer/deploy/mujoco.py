"""MuJoCo in the loop: the simulated robot behind the interface of a real one."""

import numpy as np
import torch

from trainer.deploy.robot import F64, Reading
from trainer.errors import TrainerError
from trainer.physics import ENGINES, PhysicsConfig
from trainer.rays import CASTERS
from trainer.robots import TrainedRobot
from trainer.tasks.parkour.commands import GoalCommand
from trainer.tasks.parkour.config import CommandConfig, DepthConfig
from trainer.tasks.parkour.depth import DepthCamera
from trainer.tasks.parkour.resets import Course
from trainer.tasks.rotations import rotate_back
from trainer.terrain import Terrain


class MujocoRobot:
    """One simulated robot on a terrain. Simulated time passes with `write`: one policy step each.

    Args:
        robot: its figures.
        terrain: where it stands, on the start platform.
        depth: whether the camera is read.
        far: metres beyond which the camera sees nothing.
        seed: of where on the start platform it stands, up to 5 cm beside its middle; 0 is the middle.
    """

    def __init__(
        self, robot: TrainedRobot, terrain: Terrain, *, depth: bool = True, far: float = 5.0, seed: int = 0
    ) -> None:
        self.robot, self.terrain = robot, terrain
        self.physics = ENGINES["mujoco"](robot, [terrain], 1, PhysicsConfig(threads=1))
        self.policy_dt = self.physics.policy_dt
        self.camera: DepthCamera | None = None
        if depth and robot.camera is not None:
            rays, cpu = CASTERS["embree"]([terrain], "cpu"), torch.device("cpu")
            self.camera = DepthCamera(robot.camera, DepthConfig(far=far).exact(), rays, 1, cpu)
        ground = terrain.start.centre
        base = torch.tensor([[ground[0], ground[1], ground[2] + robot.standing_height]], dtype=torch.float32)
        if seed:
            base[0, :2] += torch.tensor(np.random.default_rng(seed).uniform(-0.05, 0.05, 2), dtype=torch.float32)
        pose = torch.tensor(robot.default, dtype=torch.float32)[None]
        here = torch.zeros(1, dtype=torch.long)
        self.physics.reset(here, base, torch.tensor([[1.0, 0, 0, 0]]), pose, here)
        self._course = Course.of([terrain], torch.device("cpu"))
        self.stopped = True
        self._steps = 0

    def start(self, kp: F64, kd: F64) -> None:
        """See `Robot.start`. The simulated servos have the gains of the table: others are refused."""
        for name, given, own in (("kp", kp, self.robot.kp), ("kd", kd, self.robot.kd)):
            if not np.allclose(given, own, rtol=1e-6):
                raise TrainerError(
                    f"the policy was trained with another {name}", expected=f"{own.tolist()}", found=f"{given.tolist()}"
                )
        self.stopped = False

    def read(self) -> Reading:
        """See `Robot.read`: the exact state, no noise."""
        s = self.physics.state
        down = rotate_back(s.base_quat, torch.tensor([0.0, 0.0, -1.0]))
        ang_vel, gravity, joints, speeds = (
            t[0].double().numpy() for t in (s.base_ang_vel, down, s.joint_pos, s.joint_vel)
        )
        pose = [t[0].double().numpy().copy() for t in (s.base_pos, s.base_quat, s.joint_torque)]
        contact = (s.foot_force[0] > 1.0).double().numpy()
        passed, moves = self._steps * self.policy_dt, s.base_lin_vel[0].double().numpy().copy()
        return Reading(
            ang_vel, gravity, joints, speeds, self._depth(), pose[0], pose[1], contact, pose[2], passed, moves
        )

    def write(self, targets: F64) -> None:
        """See `Robot.write`; advances the simulation by a policy step."""
        if self.stopped:
            raise TrainerError("the robot has not been started", hint="call start before write")
        self.physics.step(torch.as_tensor(targets, dtype=torch.float32)[None])
        self._steps += 1

    def stop(self) -> None:
        """See `Robot.stop`."""
        self.stopped = True

    @property
    def position(self) -> F64:
        """(3,) m of the base in the terrain's frame; what no sensor of a real robot tells."""
        return self.physics.state.base_pos[0].double().numpy()

    def arrived(self) -> bool:
        """Whether base and feet are over the goal platform, as a trial has it."""
        s = self.physics.state
        here = torch.zeros(1, dtype=torch.long)
        return bool(self._course.on_goal(s.base_pos[:, :2], s.foot_pos[..., :2], here)[0])

    def steer(self, speed: float) -> F64:
        """(3,) velocity ahead and to the left in m/s and yaw rate in rad/s towards the goal, as in training: what
        somebody who sees the robot would tell a policy that is steered."""
        command = GoalCommand(CommandConfig(), 1, torch.device("cpu"))
        command.goal[:] = torch.as_tensor(self.terrain.goal.centre[:2], dtype=torch.float32)
        command.limit[:] = speed
        return command(self.physics.state).observed(steered=True)[0].double().numpy()

    def _depth(self) -> F64 | None:
        if self.camera is None:
            return None
        depth = self.camera.measure(self.physics.state, torch.zeros(1, dtype=torch.long))
        return depth.view(self.camera.height, self.camera.width).double().numpy()
