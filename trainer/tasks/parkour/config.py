"""Everything that can be set about the parkour task. Defaults are the paper's; docs/paper.md says what is assumed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import Any

from trainer.errors import TrainerError, check_fields

Range = tuple[float, float]
"""(low, high) of a uniform draw."""


def _check(config: object, **limits: Mapping[str, float]) -> None:
    """Refuse numbers beyond their limits (`check_fields`), and ranges that are upside down."""
    for f in fields(config):  # type: ignore[arg-type]
        value = getattr(config, f.name)
        if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
            where = f"{type(config).__name__}.{f.name}"
            raise TrainerError(f"{where} is upside down", expected="(low, high)", found=str(value))
    check_fields(config, **limits)


@dataclass(frozen=True)
class CommandConfig:
    """The goal as a velocity."""

    speed: Range = (0.45, 0.8)
    """m/s to which the velocity towards the goal is clipped, drawn for each episode."""
    gain: float = 2.0
    """1/s: wanted velocity = gain * (goal - position), before clipping; brakes within speed / gain metres."""
    constant: bool = False
    """Whether the actor is told its speed until the end, as on a robot, where nobody knows how far the goal is.
    Otherwise the speed that it is told falls with the distance, so that it stops on the goal platform."""
    heading_gain: float = 1.0
    """1/s: wanted yaw rate = gain * heading error; for rewards; the actor sees it where it is steered."""
    yaw_rate: float = 1.0
    """rad/s to which the wanted yaw rate is clipped."""
    standing: float = 0.0
    """Share of episodes with the command to stand."""

    def __post_init__(self) -> None:
        _check(self, above={"gain": 0}, least={"speed": 0, "standing": 0}, most={"standing": 1})


@dataclass(frozen=True)
class ObservationConfig:
    """Proprioception of the actor; noise is uniform, plus or minus the value, drawn once when measured."""

    history: int = 8
    """Policy steps in the window."""
    noise: bool = True
    """Whether the actor's input is noisy (the critic's never is)."""
    angular_velocity: float = 0.2
    """rad/s."""
    gravity: float = 0.05
    joint_pos: float = 0.01
    """rad."""
    joint_vel: float = 0.5
    """rad/s."""
    steered: bool = False
    """Whether the actor is told which way the goal lies (velocity ahead and to the left, yaw rate), as by somebody who
    steers. The paper's is not: straight ahead at a speed, it finds its way with its camera."""
    scan: bool = True
    """Whether the critic reads a height scan of the terrain around the base; only where there is a camera."""

    def __post_init__(self) -> None:
        _check(self, least={"history": 1})


@dataclass(frozen=True)
class DepthConfig:
    """The depth images of the actor."""

    use: bool = True
    """Whether there are depth images at all (the robot must have a camera)."""
    frames: int = 8
    """Images in the window (m of the paper)."""
    stride: int = 5
    """Policy steps between them (l of the paper)."""
    near: float = 0.15
    """Metres along the optical axis that map to 0."""
    far: float = 2.5
    """Metres that map to 1; nothing seen is 1 too."""
    noise: float = 0.01
    """Standard deviation at 1 m, metres; grows with the square of the distance, as a stereo camera's does."""
    dropout: float = 0.01
    """Share of pixels without a measurement (1, as if nothing was there)."""
    latency: tuple[int, int] = (0, 2)
    """Policy steps by which images are late, drawn for each episode (both ends included)."""
    mount_position: float = 0.01
    """Metres, plus or minus on each axis, drawn for each episode."""
    mount_rotation: float = 0.02
    """Radians, plus or minus about each axis, drawn for each episode."""

    def __post_init__(self) -> None:
        never_negative = dict.fromkeys(("dropout", "latency", "noise", "mount_position", "mount_rotation"), 0)
        _check(
            self,
            above={"near": 0, "far": self.near},
            least={"frames": 1, "stride": 1} | never_negative,
            most={"dropout": 1},
        )

    def exact(self) -> DepthConfig:
        """The camera on its mount, on time, without noise."""
        return replace(self, noise=0.0, dropout=0.0, latency=(0, 0), mount_position=0.0, mount_rotation=0.0)


@dataclass(frozen=True)
class TerminationConfig:
    """Options of terminations."""

    stuck_seconds: float = 4.0
    """Longest time at the start."""
    stuck_radius: float = 0.5
    """Metres around the starting point that count as the start."""
    tilt: float = 1.0
    """Radians by which torso or base may lean from upright."""
    collapsed: float = 0.45
    """Share of the standing height below which the base counts as fallen, where ground contact is allowed; the ground
    itself ends the episode elsewhere."""
    seconds: float = 20.0
    """Longest episode; running out of time is no failure."""
    goal_seconds: float = 1.0
    """Time on the goal platform after which a trial has succeeded; ends the episode like a time-out."""

    def __post_init__(self) -> None:
        _check(self, above=dict.fromkeys(("seconds", "stuck_seconds", "goal_seconds", "tilt"), 0))


@dataclass(frozen=True)
class RewardConfig:
    """Constants inside the reward terms, and changes to the paper's weights."""

    weights: dict[str, float] = field(default_factory=dict)
    """Term -> weight that replaces that of the table; 0 switches a term off."""
    velocity_sigma: float = 0.5
    """m/s and rad/s: width of the tracking kernels."""
    edge_radius: float = 0.05
    """Metres around an edge within which a point of the sole counts as standing on it."""
    edge_epsilon: float = 1e-3
    """m/s added to a point's speed, so that resting on an edge is not free."""
    air_time_limit: float = 0.5
    """Seconds at which a longer phase earns no more: otherwise standing on one leg pays."""
    foot_distance: float = 0.12
    """Metres between left and right foot below which they are too close."""
    contact_force: float = 1.0
    """N from which a foot counts as in contact."""
    soft_limits: float = 0.9
    """Share of a joint's range within which its angle costs nothing."""

    def __post_init__(self) -> None:
        if not all(isinstance(w, int | float) and isfinite(w) for w in self.weights.values()):
            raise TrainerError("weights must be finite numbers", found=f"{self.weights}")
        _check(self, above={"velocity_sigma": 0}, least={"edge_radius": 0})


@dataclass(frozen=True)
class ResetConfig:
    """Options of episode starts."""

    position: float = 0.1
    """Metres along x and y around the centre of the start platform."""
    yaw: float = 0.2
    """Radians around the direction to the goal."""
    joints: float = 0.1
    """Radians around the default pose (clipped to the limits)."""
    along: float = 0.0
    """Share of episodes that begin somewhere on the course, where both soles are supported, instead of on the start
    platform. They move no world of a curriculum and do not count in the log."""
    by_failure: float = 0.5
    """Share of new episodes whose terrain is drawn by how often it is failed lately, the others evenly, where several
    terrains have no order of difficulty. In a graded grid worlds move from row to row instead. Beside 0, the one value
    that was tried, on the thirteen tests at once (benchmarks/training/ttt.py, `ttt13f`)."""
    keep_last: float = 0.0
    """Share of the worlds that master the last row of a curriculum which stay in it; the others are sent to a random
    row. Above 0, worlds begin in all rows, otherwise in the easier half."""
    spread_ages: bool = True
    """Whether the first episodes begin at random ages, so that they do not end together. Such an episode that runs out
    of time moves no world of a curriculum and is no failure in the log."""

    def __post_init__(self) -> None:
        _check(self, least={"by_failure": 0, "keep_last": 0}, most={"by_failure": 1, "keep_last": 1})


@dataclass(frozen=True)
class RandomisationConfig:
    """Domain randomisation, drawn at each reset. A diagnosis replaces ranges by what it identified."""

    use: bool = True
    strength: float = 1.0
    """Ratio on the width of all ranges below (about what is nominal) and on offsets and pushes."""
    friction: Range = (0.5, 1.25)
    """Sliding friction of soles on terrain."""
    contact_time: Range = (0.0, 0.0)
    """Seconds added to the time constant with which the terrain pushes back (0.02): above 0 it gives, as a mat does."""
    mass: Range = (0.9, 1.1)
    """Ratio on the torso's mass and inertia."""
    payload: Range = (-1.0, 2.0)
    """kg on the torso; scaled with the robot's mass / 33 kg."""
    com: Range = (-0.03, 0.03)
    """Metres on each axis of the torso's centre of mass."""
    kp: Range = (0.9, 1.1)
    kd: Range = (0.9, 1.1)
    armature: Range = (0.8, 1.2)
    joint_friction: Range = (0.0, 0.3)
    """N m."""
    delay: Range = (0.0, 0.02)
    """Seconds by which commands are late, at most 0.2; rounded to physics steps."""
    encoder: float = 0.01
    """rad: plus or minus, constant offset of the joint readings."""
    gyro: float = 0.02
    """rad/s: plus or minus, constant offset of the angular velocity."""
    push_seconds: float = 6.0
    """Time between two pushes of one world; 0 for none."""
    push: float = 0.5
    """m/s added at most to the base velocity along x and y by a push."""
    terrain_scale: Range = (0.95, 1.05)
    """Ratio on a terrain's size, where it comes in more than one variant."""
    terrain_variants: int = 0
    """Scaled copies of each terrain; 0 takes 5 for up to 13 terrains and 1 (as it is) for a generated grid."""

    def __post_init__(self) -> None:
        _check(
            self,
            above=dict.fromkeys(("friction", "mass", "kp", "kd", "armature", "terrain_scale"), 0),
            least=dict.fromkeys(("joint_friction", "delay", "terrain_variants", "strength"), 0),
            most={"strength": 2},
        )

    def at_strength(self) -> RandomisationConfig:
        """The same draws as a config of strength 1: ranges of robot, soles and pushes narrowed or widened."""
        s, nominal = self.strength, {"friction": (self.friction[0] + self.friction[1]) / 2}
        nominal |= dict.fromkeys(("mass", "kp", "kd", "armature"), 1.0)
        nominal |= dict.fromkeys(("contact_time", "payload", "com", "joint_friction", "delay"), 0.0)
        ranges: dict[str, Any] = {n: tuple(v + s * (b - v) for b in getattr(self, n)) for n, v in nominal.items()}
        return replace(self, strength=1.0, encoder=s * self.encoder, gyro=s * self.gyro, push=s * self.push, **ranges)


@dataclass(frozen=True)
class ParkourConfig:
    """The whole task."""

    command: CommandConfig = field(default_factory=CommandConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
    termination: TerminationConfig = field(default_factory=TerminationConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    reset: ResetConfig = field(default_factory=ResetConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    self_collision: bool = False
    """Whether the robot's links collide with each other; feet that touch each other then cost nothing, all else is an
    undesired contact. A policy that was trained without loses most where feet pass close by each other."""
    amp: bool = False
    """Whether transition features for a motion discriminator are made."""
    action_limit: float = 20.0
    """Largest magnitude of an action; beyond it is clipped (a wide net: joint limits are the simulator's)."""
    log_every: int = 24
    """Policy steps between two logs; figures stay on the device in between."""
    divergence_limit: float = 0.01
    """Share of world steps in a log interval that may diverge before training stops."""

    def __post_init__(self) -> None:
        _check(self, above={"action_limit": 0}, least={"log_every": 1})
