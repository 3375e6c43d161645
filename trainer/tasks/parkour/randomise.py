"""Domain randomisation: what differs between worlds, and what a gap diagnosis replaces it by."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from trainer.physics import Physics, PhysicsConfig, WorldParams
from trainer.tasks.parkour.config import RandomisationConfig, Range
from trainer.tasks.parkour.draw import symmetric, uniform

_G1_KG = 33.3
"""The mass for which the payload range is meant."""


@dataclass(frozen=True)
class Known:
    """What was identified on the robot. None, or an absent joint, leaves the range of the config.

    Joint quantities map a joint's index to its range (the 90 percent interval of the diagnosis).
    """

    friction: Range | None = None
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
    depth_noise: float | None = None
    """Metres."""
    unused: tuple[str, ...] = ()
    """Effects of the diagnosis, or parts, that this task cannot express: reported, not dropped silently."""


class Randomiser:
    """Draws the parameters of worlds and hands them to the engine."""

    def __init__(self, config: RandomisationConfig, known: Known, physics: Physics) -> None:
        self.config, self.known, self.physics = config.at_strength(), limited(known, physics.config), physics
        self.timestep = physics.config.timestep
        ranges = self._ranges()
        self._widths = [len(bounds) for bounds in ranges.values()]
        table = torch.tensor([b for bounds in ranges.values() for b in bounds], device=physics.device)
        self._low, self._span = table[:, 0], table[:, 1] - table[:, 0]
        self._pushed = torch.arange(physics.num_worlds, device=physics.device)

    @property
    def active(self) -> bool:
        return self.config.use

    def reset(self, ids: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """New parameters for worlds `ids` (K,); returns their (K, J) encoder and (K, 3) gyro offsets."""
        # One draw for everything: on a GPU each of a dozen small ones would cost as much.
        drawn = self._low + self._span * uniform((0.0, 1.0), (len(ids), len(self._low)), generator)
        friction, mass, payload, delay, com, gyro, kp, kd, armature, joint_friction, encoder = drawn.split(
            self._widths, -1
        )
        steps = (delay[:, 0] / self.timestep).round().clamp(0, self.physics.config.decimation).long()
        params = WorldParams(
            friction=friction[:, 0],
            mass_scale=mass[:, 0],
            payload=payload[:, 0],
            com_offset=com,
            kp_scale=kp,
            kd_scale=kd,
            armature_scale=armature,
            joint_friction=joint_friction,
            delay_steps=steps,
        )
        self.physics.set_params(ids, params)
        return encoder, gyro

    def _ranges(self) -> dict[str, list[Range]]:
        """Quantity -> the ranges of its entries, in the order in which `reset` takes them apart."""
        c, known, joints = self.config, self.known, range(len(self.physics.robot.joints))
        ratio = _mass(self.physics) / _G1_KG

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
        }

    def push(self, step: int, generator: torch.Generator) -> None:
        """Kick every world once in `push_seconds`, a different few at each step: fixed sizes, nothing to look up."""
        period = round(self.config.push_seconds / self.physics.policy_dt)
        if period <= 0 or self.config.push <= 0:
            return
        ids = self._pushed[step % period :: period]
        if len(ids) == 0:
            return
        state = self.physics.state
        velocity = state.base_lin_vel[ids].clone()
        velocity[:, :2] += symmetric(self.config.push, (len(ids), 2), generator)
        self.physics.set_velocity(ids, velocity, state.base_ang_vel[ids].clone())


def _mass(physics: Physics) -> float:
    model = physics.robot.robot.spec.copy().compile()
    return float(model.body_subtreemass[0])


def limited(known: Known, settings: PhysicsConfig) -> Known:
    """The same, with a command delay named in `unused` that the engine cannot have in full."""
    if known.delay is None or all(0 <= round(t / settings.timestep) <= settings.decimation for t in known.delay):
        return known
    longest = settings.timestep * settings.decimation
    part = f"command_delay (outside 0 to {1e3 * longest:g} ms)"
    return known if part in known.unused else replace(known, unused=(*known.unused, part))


def informed(config: RandomisationConfig, known: Known) -> RandomisationConfig:
    """The config with the terrain scale of the diagnosis, which has to be known before worlds are made."""
    return config if known.terrain_scale is None else replace(config, terrain_scale=known.terrain_scale)
