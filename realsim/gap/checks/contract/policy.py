"""A policy and its contract: what it sees, in which order and scale, and what its actions mean."""

from collections.abc import Callable
from dataclasses import dataclass, field

from realsim.core.types import F64

TERMS = {
    "base_ang_vel": "ang_vel", "ang_vel": "ang_vel", "imu_ang_vel": "ang_vel", "gyro": "ang_vel",
    "base_lin_vel": "lin_vel",
    "gravity": "gravity", "projected_gravity": "gravity", "gravity_vec": "gravity",
    "command": "command", "velocity_commands": "command", "commands": "command", "twist": "command",
    "steering_command": "command", "generated_commands": "command", "velocity_command": "command",
    "joint_pos": "joint_pos", "joint_pos_rel": "joint_pos", "dof_pos": "joint_pos",
    "joint_vel": "joint_vel", "joint_vel_rel": "joint_vel", "dof_vel": "joint_vel",
    "last_action": "last_action", "actions": "last_action", "prev_actions": "last_action",
}  # fmt: skip
"""Names of observation terms -> what they hold. Others are unknown inputs: the replay shows zeros there."""
WIDTH = {"ang_vel": 3, "lin_vel": 3, "gravity": 3, "command": 3}


@dataclass(frozen=True)
class Term:
    """One part of the observation vector."""

    name: str
    kind: str
    """A value of TERMS, or `unknown`."""
    width: int
    """Of one moment."""
    history: int = 1
    scale: float | F64 = 1.0
    """One, or one a column."""


@dataclass(frozen=True)
class Camera:
    """The depth input: (frames, rows, columns), newest first, `stride` policy steps apart."""

    shape: tuple[int, int, int]
    stride: int
    near: float
    """m along the optical axis that becomes 0."""
    far: float
    """m that becomes 1; no measurement is 1 too."""


Run = Callable[[F64, F64 | None], F64]
"""(N, A) observations and, of a policy with a camera, (N, M, H, W) depth images -> (N, J) actions."""


@dataclass(frozen=True)
class Contract:
    """The contract of a policy; J joints in the policy's own order."""

    joints: tuple[str, ...]
    terms: tuple[Term, ...]
    default: F64 = field(repr=False)
    """(J,) rad that the observed joint positions are relative to."""
    scale: F64 = field(repr=False)
    kp: F64 = field(repr=False)
    kd: F64 = field(repr=False)
    period: float = 0.02
    clip: float | None = None
    run: Run = field(default=lambda rows, images: rows, repr=False)
    camera: Camera | None = None
    offset: F64 | None = field(default=None, repr=False)
    """(J,) rad: target = offset + scale * action; the default pose if None."""
    alpha: float = 1.0
    """Share of the new one in each target, the rest is the target before: a first-order low pass."""
    framework: str = "realsim"
    """`realsim`, `mjlab`, `isaaclab`, or `unitree`: in whose words settings are named."""

    @property
    def zero(self) -> F64:
        """(J,) rad that an action of zero sends."""
        return self.default if self.offset is None else self.offset

    @property
    def width(self) -> int:
        return sum(t.width * t.history for t in self.terms)

    @property
    def history(self) -> int:
        """Moments of the longest term."""
        return max(t.history for t in self.terms)

    @property
    def memory(self) -> int:
        """Policy steps that one observation covers, depth images included."""
        images = 0 if self.camera is None else (self.camera.shape[0] - 1) * self.camera.stride + 1
        return max(self.history, images)
