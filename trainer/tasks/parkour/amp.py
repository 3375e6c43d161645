"""Input of the motion discriminator: two successive poses, independent of position and heading."""

import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.signals import Signals


def pose(
    gravity: Tensor, lin_vel: Tensor, ang_vel: Tensor, joint_pos: Tensor, joint_vel: Tensor, feet: Tensor
) -> Tensor:
    """(N, S/2) features of one pose.

    Args:
        gravity, lin_vel, ang_vel: (N, 3) base axes. joint_pos: (N, J) minus the default pose. joint_vel: (N, J).
        feet: (N, F, 3) from the base, in the base's heading frame.
    """
    return torch.cat([gravity, lin_vel, ang_vel, joint_pos, joint_vel, feet.flatten(1)], -1)


def of_signals(s: Signals, body: Body) -> Tensor:
    """The features of a step."""
    q = s.state.joint_pos - body.default
    return pose(s.gravity, s.lin_vel, s.ang_vel, q, s.state.joint_vel, s.foot_offset).nan_to_num(0.0, 0.0, 0.0)


class Transitions:
    """Pairs of successive poses; a reset begins anew, so no pair spans two episodes."""

    def __init__(self, worlds: int, joints: int, feet: int, device: torch.device) -> None:
        self.last = torch.zeros(worlds, 9 + 2 * joints + 3 * feet, device=device)

    def advance(self, s: Signals, body: Body) -> Tensor:
        """(N, S) from the pose before to this one."""
        now = of_signals(s, body)
        pair = torch.cat([self.last, now], -1)
        self.last.copy_(now)
        return pair

    def restart(self, ids: Tensor, s: Signals, body: Body) -> None:
        """Worlds `ids` are in a new pose; `s` has their rows only."""
        self.last.index_copy_(0, ids, of_signals(s, body))
