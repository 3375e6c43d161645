"""Readings to the inputs of a policy, by the layout that stands in its metadata: numpy only, for a small computer."""

import numpy as np
from numpy.typing import NDArray

from trainer.deploy.robot import Reading
from trainer.errors import TrainerError
from trainer.ppo.export import Deployment
from trainer.tasks.parkour.observations import STEERED, proprioception

F32 = NDArray[np.float32]


class Observer:
    """Keeps the histories. The same numbers as the simulated task gives without noise (a test holds this)."""

    def __init__(self, facts: Deployment) -> None:
        self.facts = facts
        self.default = np.asarray(facts.default)
        widths = dict(proprioception(len(facts.layout.actions))) | {STEERED: 3}
        unknown = [name for name, _ in facts.layout.actor if name not in widths]
        uneven = [name for name, width in facts.layout.actor if name in widths and width % widths[name]]
        if unknown or uneven:
            raise TrainerError(
                f"the policy needs observations that this loop does not have: {', '.join(unknown + uneven)}",
                expected=f"multiples of {widths}",
                found=str(facts.layout.actor),
            )
        self.steered = any(name == STEERED for name, _ in facts.layout.actor)
        """Whether the policy is told which way to go, and not only how fast."""
        self.history = {name: width // widths[name] for name, width in facts.layout.actor}
        self.terms: dict[str, list[F32]] = {name: [] for name in self.history}
        self.images: list[F32] = []

    def __call__(self, reading: Reading, command: NDArray[np.float64], last_action: F32) -> dict[str, F32]:
        """Inputs of the ONNX policy, each with a leading axis of one.

        Args:
            reading: the newest one.
            command: (3,) velocity ahead and to the left in m/s, yaw rate in rad/s; of a policy that is not steered the
                last two are 0.
            last_action: (J,) what the policy gave a step ago; zeros at first.
        """
        now = {
            "base_ang_vel": reading.ang_vel,
            "gravity": reading.gravity,
            "command": command,
            STEERED: command,
            "joint_pos": reading.joint_pos - self.default,
            "joint_vel": reading.joint_vel,
            "last_action": last_action,
        }
        parts = []
        for name, length in self.history.items():
            parts += _window(self.terms[name], np.asarray(now[name], np.float32), length)
        inputs = {"vector": np.concatenate(parts)[None]}
        if self.facts.layout.depth is not None:
            inputs["depth"] = self.stack(reading.depth)[None]
        return inputs

    def stack(self, depth: NDArray[np.float64] | None) -> F32:
        """(M, H, W), newest first; before the first image there was the first image."""
        assert self.facts.layout.depth is not None
        count, *shape = self.facts.layout.depth
        if depth is None or depth.shape != tuple(shape):
            raise TrainerError(
                "the depth image does not fit the policy",
                expected=f"{shape[0]} rows x {shape[1]} columns, cropped as in training",
                found="no image" if depth is None else f"{depth.shape}",
            )
        near, far = self.facts.depth_near, self.facts.depth_far
        measured = np.isfinite(depth) & (depth > 0)
        image = np.where(measured, np.clip((np.nan_to_num(depth) - near) / (far - near), 0, 1), 1).astype(np.float32)
        stride = max(self.facts.layout.depth_stride, 1)
        kept = _window(self.images, image, (count - 1) * stride + 1)
        return np.stack(kept[::-1][::stride])


def _window(past: list[F32], now: F32, length: int) -> list[F32]:
    """The last `length` values, oldest first; at the start as if it had always been like now."""
    past.extend([now] * (1 if past else length))
    del past[: len(past) - length]
    return past
