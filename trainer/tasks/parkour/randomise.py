"""Domain randomisation: what differs between worlds, and what a gap diagnosis replaces it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trainer.physics import Physics, PhysicsConfig, WorldParams
from trainer.tasks.parkour.config import RandomisationConfig, Range
from trainer.tasks.parkour.draw import randint, symmetric, uniform
from trainer.terrain import Terrain

_G1_KG = 33.3
"""The mass for which the payload range is meant."""
LONGEST_DELAY = 10
"""Policy steps by which commands can be late: 0.2 s, the longest delay that `realsim diagnose` considers."""

_MANY = 13
"""Terrains from which on one size each is enough: a generated grid is random already."""


@dataclass(frozen=True)
class Known:
    """What was found on the robot. None, or an absent joint, leaves the range of the config.

    Joint quantities map a joint's index to its range (the 90 percent interval of the diagnosis).
    """

    alternatives: tuple[Known, ...] = ()
    """Sets of causes that the data cannot tell apart, this one the first: each world draws one. () if there is one."""
    model: dict[str, Any] | None = None
    """Patch of the robot's model with what ranges cannot hold; the ranges are about the patched model."""

    friction: Range | None = None
    contact_time: Range | None = None
    heights: dict[str, Range] = field(default_factory=dict)
    """Piece of terrain -> metres by which it is higher; of the first alternative."""
    payload: Range | None = None
    com: tuple[Range, Range, Range] | None = None
    delay: Range | None = None
    terrain_scale: Range | None = None
    kp: dict[int, Range] = field(default_factory=dict)
    kd: dict[int, Range] = field(default_factory=dict)
    armature: dict[int, Range] = field(default_factory=dict)
    joint_friction: dict[int, Range] = field(default_factory=dict)
    encoder: dict[int, Range] = field(default_factory=dict)
    servo: frozenset[int] = frozenset()
    """Joints whose servo reads the offset in `encoder` too, so that they stand elsewhere than they are told."""
    gyro: tuple[Range, Range, Range] | None = None
    depth_latency: Range | None = None
    """Seconds."""
    depth_noise: Range | None = None
    """Ratio on the noise of the config."""
    mount: tuple[Range, ...] | None = None
    """Turns (rad) and shifts (m) of the depth camera, each about or along its x (right), y (down), z (forward)."""
    unused: tuple[str, ...] = ()
    """Effects of the diagnosis, or parts, that this task cannot express: reported, not dropped silently."""


@dataclass(frozen=True)
class Drawn:
    """What the task, not the engine, has to simulate of K worlds' parameters."""

    encoder: Tensor
    """(K, J) rad, offset of the joint readings."""
    servo: Tensor
    """(K, J) rad of it that the servos read too."""
    gyro: Tensor
    """(K, 3) rad/s, offset of the angular velocity."""
    late: Tensor
    """(K,) policy steps that commands wait before they reach the engine, which may delay them by one more."""


class Line:
    """Commands that wait for whole policy steps, more than an engine itself delays them: the last targets of N worlds,
    each of which is behind by its own number of steps.

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


class Randomiser:
    """Draws the parameters of worlds and hands them to the engine."""

    def __init__(self, config: RandomisationConfig, known: Known, physics: Physics) -> None:
        self.config, self.known, self.physics = config.at_strength(), limited(known, physics.config), physics
        self.timestep = physics.config.timestep
        sets = self.known.alternatives or (self.known,)
        ranges = [self._ranges(known) for known in sets]
        if all(r["contact_time"] == [(0.0, 0.0)] for r in ranges):
            ranges = [r | {"contact_time": []} for r in ranges]  # nothing to draw, and nothing to write
        self._widths = [len(bounds) for bounds in ranges[0].values()]
        table = torch.tensor([[b for bounds in r.values() for b in bounds] for r in ranges], device=physics.device)
        self._low, self._span = table[..., 0], table[..., 1] - table[..., 0]
        self._servo = torch.zeros(len(sets), len(physics.robot.joints), device=physics.device)
        for row, known in zip(self._servo, sets, strict=True):
            row[sorted(known.servo)] = 1.0
        longest = max(r["delay"][0][1] for r in ranges)
        self.latest = int(self._late(torch.tensor(self._steps(longest)))) if self.active else 0
        """Policy steps that commands wait at most, see `Drawn.late`."""

    @property
    def active(self) -> bool:
        return self.config.use

    @property
    def misread(self) -> bool:
        """Whether the servos of any world may read an offset."""
        return self.active and bool(self._servo.any())

    def reset(self, ids: Tensor, generator: torch.Generator) -> Drawn:
        """New parameters for worlds `ids` (K,)."""
        # One draw for everything: on a GPU each of a dozen small ones would cost as much.
        share = uniform((0.0, 1.0), (len(ids), self._low.shape[1]), generator)
        which = torch.zeros(len(ids), dtype=torch.long, device=share.device)
        if len(self._low) > 1:
            which = randint(0, len(self._low), len(ids), generator)
        drawn = self._low[which] + self._span[which] * share
        friction, mass, payload, delay, com, gyro, kp, kd, armature, joint_friction, encoder, time = drawn.split(
            self._widths, -1
        )
        steps = (delay[:, 0] / self.timestep).round().clamp(0, self._steps()).long()
        late = self._late(steps)
        params = WorldParams(
            friction=friction[:, 0],
            contact_time=time[:, 0] if time.shape[1] else None,
            mass_scale=mass[:, 0],
            payload=payload[:, 0],
            com_offset=com,
            kp_scale=kp,
            kd_scale=kd,
            armature_scale=armature,
            joint_friction=joint_friction,
            delay_steps=steps - late * self.physics.config.decimation,
        )
        self.physics.set_params(ids, params)
        return Drawn(encoder, encoder * self._servo[which], gyro, late)

    def _steps(self, seconds: float | None = None) -> int:
        """Physics steps of a delay, within what can be simulated; of the longest if None."""
        most = LONGEST_DELAY * self.physics.config.decimation
        return most if seconds is None else min(max(round(seconds / self.timestep), 0), most)

    def _late(self, steps: Tensor) -> Tensor:
        """Whole policy steps of delays in physics steps; the engine delays by the rest, up to a whole policy step."""
        return (steps - 1).clamp_min(0) // self.physics.config.decimation

    def _ranges(self, known: Known) -> dict[str, list[Range]]:
        """Quantity -> the ranges of its entries, in the order in which `reset` takes them apart."""
        c, joints = self.config, range(len(self.physics.robot.joints))
        model = self.physics.robot.robot.spec.copy().compile()
        ratio = float(model.body_subtreemass[0]) / _G1_KG

        def each(everywhere: Range, own: dict[int, Range]) -> list[Range]:
            return [own.get(j, everywhere) for j in joints]

        return {
            "friction": [known.friction or c.friction],
            "mass": [c.mass],
            "payload": [known.payload or (c.payload[0] * ratio, c.payload[1] * ratio)],
            "delay": [known.delay or c.delay],
            "com": list(known.com or (c.com,) * 3),
            "gyro": list(known.gyro or ((-c.gyro, c.gyro),) * 3),
            "kp": each(c.kp, known.kp),
            "kd": each(c.kd, known.kd),
            "armature": each(c.armature, known.armature),
            "joint_friction": each(c.joint_friction, known.joint_friction),
            "encoder": each((-c.encoder, c.encoder), known.encoder),
            "contact_time": [known.contact_time or c.contact_time],
        }

    def pushes(self, step: int | None = None) -> int:
        """How many worlds are kicked at a step; at most if None."""
        period = round(self.config.push_seconds / self.physics.policy_dt)
        if not self.active or period <= 0 or self.config.push <= 0:
            return 0
        return len(range(0 if step is None else step % period, self.physics.num_worlds, period))

    def push(self, step: Tensor, count: int, generator: torch.Generator) -> None:
        """Kick every world once in `push_seconds`, a different few at each step ().

        Args:
            count: `pushes` of this step, or the most of any step.
        """
        period, worlds = round(self.config.push_seconds / self.physics.policy_dt), self.physics.num_worlds
        ids = step % period + period * torch.arange(count, device=step.device)
        kick = symmetric(self.config.push, (count, 2), generator) * (ids < worlds)[:, None]
        ids = ids % worlds  # beyond the last world another one takes part that gets no kick
        state = self.physics.state
        velocity = state.base_lin_vel[ids].clone()
        velocity[:, :2] += kick
        self.physics.set_velocity(ids, velocity, state.base_ang_vel[ids].clone())


def limited(known: Known, settings: PhysicsConfig) -> Known:
    """The same, with a command delay named in `unused` that cannot be simulated in full."""
    most = LONGEST_DELAY * settings.decimation
    delays = [k.delay for k in (known.alternatives or (known,)) if k.delay is not None]
    if all(0 <= round(t / settings.timestep) <= most for delay in delays for t in delay):
        return known
    part = f"command_delay (outside 0 to {1e3 * most * settings.timestep:g} ms)"
    return known if part in known.unused else replace(known, unused=(*known.unused, part))


def hull(known: Known, name: str) -> Range | None:
    """The range of what is set once for all worlds, over all alternatives; None if one says nothing about it."""
    found: list[Range | None] = [getattr(k, name) for k in (known.alternatives or (known,))]
    given = [bounds for bounds in found if bounds is not None]
    return (min(b[0] for b in given), max(b[1] for b in given)) if len(given) == len(found) else None


def informed(config: RandomisationConfig, known: Known) -> RandomisationConfig:
    """The config with the terrain scale of the diagnosis, which has to be known before worlds are made."""
    scale = hull(known, "terrain_scale")
    return config if scale is None else replace(config, terrain_scale=scale)


def sizes(terrains: Sequence[Terrain], config: RandomisationConfig) -> list[float]:
    """The scales in which every terrain is made, the true one in the middle."""
    count = config.terrain_variants or (5 if len(terrains) <= _MANY else 1)
    return [1.0] if count == 1 or not config.use else np.linspace(*config.terrain_scale, count).tolist()
