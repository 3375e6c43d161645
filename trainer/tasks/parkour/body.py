"""The robot's figures as tensors on the device, once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.robots import TrainedRobot


@dataclass(frozen=True)
class Body:
    """A `TrainedRobot` in float32 on a device; joints and feet in its order."""

    default: Tensor
    action_scale: Tensor
    kp: Tensor
    effort: Tensor
    velocity: Tensor
    lower: Tensor
    upper: Tensor
    legs: Tensor
    hips: Tensor
    upper_body: Tensor
    soles: Tensor
    """(F, P, 3) points on the soles in the foot bodies' frames, metres."""
    sole_depth: Tensor
    """(F,) metres from the sole up to the foot body's origin (0.035 for G1)."""
    standing_height: float

    @staticmethod
    def of(robot: TrainedRobot, device: torch.device | str) -> Body:
        """Tensors of a robot.

        Raises:
            TrainerError: its feet have different numbers of sole points.
        """
        counts = {len(points) for points in robot.soles}
        if len(counts) != 1:
            raise TrainerError("the feet need equally many sole points", found=f"{sorted(counts)}")

        def floats(value: np.ndarray) -> Tensor:
            return torch.as_tensor(np.asarray(value), dtype=torch.float32, device=device)

        def indices(value: tuple[int, ...]) -> Tensor:
            return torch.tensor(value, dtype=torch.long, device=device)

        soles = floats(np.stack(robot.soles))
        vectors = ("default", "action_scale", "kp", "effort", "velocity", "lower", "upper")
        return Body(
            **{name: floats(getattr(robot, name)) for name in vectors},
            **{name: indices(getattr(robot, name)) for name in ("legs", "hips", "upper_body")},
            soles=soles,
            sole_depth=-soles[..., 2].mean(-1),
            standing_height=robot.standing_height,
        )
