"""Observations of the actor and the critic.

The actor's vector is p_(t-7), ..., p_t of the paper, term by term: each term's history from the oldest to the newest.
The critic's is the same step's truth without noise, and what no sensor of the robot measures.
"""

import torch
from torch import Tensor

from trainer.physics import State
from trainer.rays import RayCaster, fall
from trainer.robots import TrainedRobot
from trainer.tasks.base import ObservationLayout
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import ObservationConfig
from trainer.tasks.parkour.draw import symmetric
from trainer.tasks.parkour.signals import Signals
from trainer.tasks.rotations import heading_of

STEERED = "steering_command"
"""Name of the command of `ObservationConfig.steered` in layouts: no other is taken for it."""
SCAN = (17, 11)
"""Points of the critic's height scan ahead and across, 10 cm apart."""
SPACING = 0.1
"""Metres between them."""
BEHIND = 0.4
"""Metres behind the base at which the grid begins."""
LARGEST = 0.5
"""Metres above or below the soles at which heights saturate."""
FAR_GOAL = 10.0
"""Metres at which the critic's goal vector saturates."""


def proprioception(joints: int, steered: bool = False) -> tuple[tuple[str, int], ...]:
    """(term, width) of p_t, in order (paper, sec. III-B). A command that means something else has another name."""
    return (
        ("base_ang_vel", 3),
        ("gravity", 3),
        (STEERED if steered else "command", 3),
        ("joint_pos", joints),
        ("joint_vel", joints),
        ("last_action", joints),
    )


def privileged(feet: int, scan: bool = False) -> tuple[tuple[str, int], ...]:
    """(term, width) of what only the critic knows."""
    heights = (("height_scan", SCAN[0] * SCAN[1]),) if scan else ()
    return (
        ("base_lin_vel", 3),
        ("target_velocity", 2),
        ("target_yaw_rate", 1),
        ("goal", 2),
        ("foot_contact", feet),
        ("foot_clearance", feet),
        ("foot_edge", feet),
        *heights,
    )


def layout(
    robot: TrainedRobot, config: ObservationConfig, depth: tuple[int, int, int] | None, stride: int
) -> ObservationLayout:
    """Names and widths of everything that is observed."""
    terms = proprioception(len(robot.joints), config.steered)
    return ObservationLayout(
        actor=tuple((name, width * config.history) for name, width in terms),
        critic=terms + privileged(len(robot.feet), scan=config.scan and depth is not None),
        depth=depth,
        actions=tuple(robot.joints),
        depth_stride=0 if depth is None else stride,
    )


def measure(s: Signals, body: Body, steered: bool) -> list[Tensor]:
    """The terms of p_t without noise, in the order of `proprioception`; s.action is what was just applied."""
    q = s.state.joint_pos - body.default
    return [s.ang_vel, s.gravity, s.command.observed(steered), q, s.state.joint_vel, s.action]


def critic_view(s: Signals, body: Body, steered: bool = False, scan: Tensor | None = None) -> Tensor:
    """(N, C) the critic's vector; `scan` (N, S) of `HeightScan` where there is one."""
    goal = s.command.velocity / s.command.speed.clamp_min(1e-6)[:, None]
    terms = [
        *measure(s, body, steered),
        s.lin_vel,
        s.command.velocity,
        s.command.yaw_rate[:, None],
        goal * s.command.distance.clamp_max(FAR_GOAL)[:, None],
        s.contact.float(),
        s.footholds.clearance.mean(-1).clamp(-0.5, 0.5),
        s.footholds.edge_depth.sum(-1),
        *([] if scan is None else [scan]),
    ]
    return torch.cat(terms, -1).nan_to_num(0.0, 0.0, 0.0)


class Proprioception:
    """The actor's noisy measurements and their history."""

    def __init__(self, config: ObservationConfig, joints: int, worlds: int, device: torch.device) -> None:
        self.config = config
        self.widths = [width for _, width in proprioception(joints)]
        self.window = torch.zeros(worlds, config.history, sum(self.widths), device=device)
        self.encoder_offset = torch.zeros(worlds, joints, device=device)
        self.gyro_offset = torch.zeros(worlds, 3, device=device)

    def push(self, s: Signals, body: Body, generator: torch.Generator) -> None:
        """Append the newest measurement of every world."""
        newest = self._measured(s, body, generator)
        self.window.copy_(torch.cat([self.window[:, 1:], newest[:, None]], 1))

    def restart(self, ids: Tensor, s: Signals, body: Body, generator: torch.Generator) -> None:
        """Worlds `ids` begin as if they had always been like this; `s` has their rows only."""
        self.window[ids] = self._measured(s, body, generator, ids)[:, None]

    def read(self, ids: Tensor | None = None) -> Tensor:
        """(N, A), or (K, A) of worlds `ids`."""
        window = self.window if ids is None else self.window[ids]
        return torch.cat([part.flatten(1) for part in window.split(self.widths, -1)], -1)

    def _measured(self, s: Signals, body: Body, generator: torch.Generator, ids: Tensor | None = None) -> Tensor:
        gyro, gravity, command, q, dq, action = measure(s, body, self.config.steered)
        gyro = gyro + (self.gyro_offset if ids is None else self.gyro_offset[ids])
        q = q + (self.encoder_offset if ids is None else self.encoder_offset[ids])
        if self.config.noise:
            c = self.config
            gyro = gyro + symmetric(c.angular_velocity, tuple(gyro.shape), generator)
            gravity = gravity + symmetric(c.gravity, tuple(gravity.shape), generator)
            q = q + symmetric(c.joint_pos, tuple(q.shape), generator)
            dq = dq + symmetric(c.joint_vel, tuple(dq.shape), generator)
        # A world that has diverged is reset at this very step; until then it must not poison a normaliser.
        return torch.cat([gyro, gravity, command, q, dq, action], -1).nan_to_num(0.0, 0.0, 0.0)


class HeightScan:
    """The critic's view of the terrain around the base, as no sensor of the robot has it: heights on a grid in the
    heading frame, by rays straight down."""

    def __init__(self, caster: RayCaster, standing_height: float, device: torch.device) -> None:
        ahead = torch.arange(SCAN[0], device=device) * SPACING - BEHIND
        left = (torch.arange(SCAN[1], device=device) - (SCAN[1] - 1) / 2) * SPACING
        self.points = torch.stack(torch.meshgrid(ahead, left, indexing="ij"), -1).reshape(-1, 2)
        """(S, 2) m, row by row from behind, each from right to left."""
        self.caster, self.standing_height = caster, standing_height

    def __call__(self, state: State, terrain_ids: Tensor) -> Tensor:
        """(N, S) m of the terrain over where the soles of a standing robot would be, within +-`LARGEST`."""
        c, s = heading_of(state.base_quat).unbind(-1)
        x, y = self.points.unbind(-1)
        level = torch.stack([c[:, None] * x - s[:, None] * y, s[:, None] * x + c[:, None] * y], -1)
        origins = torch.cat([level, torch.zeros_like(level[..., :1])], -1) + state.base_pos[:, None]
        below = fall(self.caster, origins, terrain_ids, self.standing_height + LARGEST)
        return (self.standing_height - below).clamp(-LARGEST, LARGEST)


def mirrored() -> tuple[int, ...]:
    """Index of the point that each point of the grid has for its image in the mirror."""
    rows, columns = SCAN
    return tuple(i * columns + (columns - 1 - j) for i in range(rows) for j in range(columns))


def pose(
    gravity: Tensor, lin_vel: Tensor, ang_vel: Tensor, joint_pos: Tensor, joint_vel: Tensor, feet: Tensor
) -> Tensor:
    """(N, S/2) features of one pose for the motion discriminator, independent of position and heading.

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
