"""The task seen in a mirror: left and right swapped. Used for mirror samples and to test the observations."""

import torch
from torch import Tensor

from trainer.robots import TrainedRobot
from trainer.tasks.base import Observation
from trainer.tasks.parkour.observations import mirrored, privileged, proprioception

_POLAR = (1.0, -1.0, 1.0)
_AXIAL = (-1.0, 1.0, -1.0)


class Mirror:
    """Reflects observations and actions about the robot's sagittal plane."""

    def __init__(
        self, robot: TrainedRobot, history: int, device: torch.device | str = "cpu", *, scan: bool = False
    ) -> None:
        joints, feet = len(robot.joints), len(robot.feet)
        index, sign = robot.mirror
        swap = tuple(f ^ 1 for f in range(feet))  # feet come in left-right pairs
        even = (1.0,) * feet
        self._terms: dict[str, tuple[tuple[int, ...], tuple[float, ...]]] = {
            "base_ang_vel": ((0, 1, 2), _AXIAL),
            "gravity": ((0, 1, 2), _POLAR),
            "command": ((0, 1, 2), (1.0, -1.0, -1.0)),
            "joint_pos": (index, sign),
            "joint_vel": (index, sign),
            "last_action": (index, sign),
            "base_lin_vel": ((0, 1, 2), _POLAR),
            "target_velocity": ((0, 1), (1.0, -1.0)),
            "target_yaw_rate": ((0,), (-1.0,)),
            "goal": ((0, 1), (1.0, -1.0)),
            "foot_contact": (swap, even),
            "foot_clearance": (swap, even),
            "foot_edge": (swap, even),
            "height_scan": (mirrored(), (1.0,) * len(mirrored())),
        }
        own = proprioception(joints)
        self._actor = self._vector(own, history, device)
        self._critic = self._vector(own + privileged(feet, scan), 1, device)
        self._action = torch.tensor(index, device=device), torch.tensor(sign, device=device)

    def observation(self, o: Observation) -> Observation:
        """The mirrored observation; of a camera off the middle the image is only nearly right."""
        actor = o.actor[:, self._actor[0]] * self._actor[1]
        critic = o.critic[:, self._critic[0]] * self._critic[1]
        return Observation(actor, critic, None if o.depth is None else o.depth.flip(-1))

    def action(self, a: Tensor) -> Tensor:
        """(N, J) actions of the mirrored robot."""
        return a[:, self._action[0]] * self._action[1]

    def _vector(
        self, terms: tuple[tuple[str, int], ...], history: int, device: torch.device | str
    ) -> tuple[Tensor, Tensor]:
        index: list[int] = []
        sign: list[float] = []
        for name, width in terms:
            order, signs = self._terms[name]
            for _ in range(history):
                base = len(index)
                index += [base + i for i in order]
                sign += signs
            assert len(order) == width
        return torch.tensor(index, device=device), torch.tensor(sign, device=device)
