"""Robots of the trainer: those of `realsim.robots` with gains, limits and names that tasks need."""

from dataclasses import dataclass

from realsim.core.types import F64
from realsim.robots import Robot


@dataclass(frozen=True)
class DepthMount:
    """A depth camera on a body: a pinhole that looks along +x of its frame, y to the left, z up."""

    body: str
    pos: F64
    """(3,) in the body's frame, metres."""
    quat: F64
    """(4,) w x y z, mount to body."""
    fovy_deg: float
    """Vertical opening of the full image."""
    full: tuple[int, int] = (480, 270)
    """(width, height) as delivered by the camera."""
    small: tuple[int, int] = (64, 36)
    """(width, height) after downsampling."""
    crop: tuple[int, int] = (32, 18)
    """(width, height) of the bottom-centre patch that the policy sees."""


@dataclass(frozen=True)
class TrainedRobot:
    """A robot that can be trained. Joint arrays are in the order of `joints`, which is the order of its actuators."""

    robot: Robot
    joints: tuple[str, ...]
    default: F64
    """(J,) radians: the pose that action 0 asks for."""
    action_scale: F64
    """(J,) radians a unit of action: target = default + scale * action."""
    kp: F64
    """(J,) N m/rad."""
    kd: F64
    """(J,) N m s/rad."""
    effort: F64
    """(J,) N m, the servo's limit."""
    velocity: F64
    """(J,) rad/s, the motor's limit."""
    lower: F64
    """(J,) rad."""
    upper: F64
    """(J,) rad."""
    base: str
    """Name of the root body; its frame is the base frame (x forward, z up)."""
    torso: str
    """Body whose tilt ends an episode; the root body itself for a quadruped."""
    feet: tuple[str, ...]
    """Bodies that may touch the terrain."""
    soles: tuple[F64, ...]
    """For each foot (P, 3) points on the sole in the foot body's frame, metres: edge and height terms look there."""
    legs: tuple[int, ...]
    """Indices into `joints`."""
    hips: tuple[int, ...]
    """Indices of the joints that the hip deviation term looks at."""
    upper_body: tuple[int, ...]
    """Indices of arms and waist; empty for a quadruped."""
    groups: dict[str, tuple[int, ...]]
    """Joints by part of the body (legs, waist, arms), for the log."""
    standing_height: float
    """Metres from the soles to the base in the default pose."""
    camera: DepthMount | None
    mirror: tuple[tuple[int, ...], tuple[float, ...]]
    """Left-right symmetry: joint i of the mirrored robot is sign[i] * joint index[i]."""
