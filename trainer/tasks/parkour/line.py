"""Commands that wait for whole policy steps before they reach the robot: what is longer than an engine's own delay."""

from __future__ import annotations

import torch
from torch import Tensor


class Line:
    """The last targets of N worlds, each of which is behind by its own number of policy steps.

    Args:
        latest: policy steps that a world may be behind.
    """

    def __init__(self, latest: int, worlds: int, joints: int, device: torch.device) -> None:
        self._ring = torch.zeros(latest + 1, worlds, joints, device=device)
        self._late = torch.zeros(worlds, dtype=torch.long, device=device)
        self._worlds = torch.arange(worlds, device=device)

    def __call__(self, targets: Tensor) -> Tensor:
        """Take new targets (N, J) in rad; those that arrive now (N, J)."""
        self._ring.copy_(torch.cat([targets[None], self._ring[:-1]]))
        return self._ring[self._late, self._worlds]

    def reset(self, ids: Tensor, pose: Tensor, late: Tensor) -> None:
        """Worlds `ids` (K,) begin anew in the pose (K, J) in rad, which they hold until commands arrive.

        Args:
            late: (K,) policy steps.
        """
        self._ring[:, ids] = pose
        self._late[ids] = late
