"""The library of effects: a file a kind, one line here an effect; your own packages add more (`realsim.effects`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any

from realsim.core.errors import GapError, RealsimError
from realsim.core.registry import Registry

if TYPE_CHECKING:
    from realsim.gap.effects.base import Effect


class Effects(Registry):
    """Effects by name; those of installed packages are checked when they are first used."""

    @cached_property
    def _foreign(self) -> dict[str, Effect]:
        return {}

    def __getitem__(self, name: str) -> Effect:
        if name in self._foreign:
            return self._foreign[name]
        effect: Effect = super().__getitem__(name)
        if name not in self.own:
            from realsim.gap.effects import base

            if not isinstance(effect, base.Effect) or effect.name != name:
                raise GapError(
                    f"the effect {name!r} of an installed package is none",
                    expected=f"a realsim.gap.effects.base.Effect with the name {name!r}",
                    found=f"an effect {effect.name!r}" if isinstance(effect, base.Effect) else repr(effect)[:80],
                )
            effect = self._foreign[name] = _guarded(effect, self._entries[name])
        return effect


def _guarded(effect: Effect, home: str) -> Effect:
    """A package's effect whose failures name the effect and the package; no GapError, after which a search goes on
    without the effect."""

    def guarded(what: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any) -> Any:
            try:
                return function(*args)
            except RealsimError:
                raise
            except Exception as error:
                raise RealsimError(
                    f"{what} of the effect {effect.name!r} fails",
                    expected="no exception, but GapError where its values make no model",
                    found=f"{type(error).__name__}: {error}, in {home} (entry point of the group realsim.effects)",
                    hint="mend that package and install it again, or uninstall it; --effects names those to consider",
                ) from error

        return call

    return replace(
        effect,
        where=replace(effect.where, find=guarded("`where`", effect.where.find)),
        parameters=guarded("`parameters`", effect.parameters),
        apply=guarded("`apply`", effect.apply),
        excited_by=guarded("`excited_by`", effect.excited_by),
        rivals=replace(effect.rivals, suggest=guarded("`rivals.suggest`", effect.rivals.suggest)),
    )


_FILES = {
    "command_delay": "delays",
    "actuator_lag": "delays",
    "motor_gain": "drives",
    "stiffness_gain": "drives",
    "damping_gain": "drives",
    "torque_limit": "drives",
    "torque_speed_limit": "drives",
    "coulomb_friction": "friction",
    "viscous_friction": "friction",
    "stribeck_friction": "friction",
    "load_friction": "friction",
    "armature": "joints",
    "backlash": "backlash",
    "joint_offset": "joint_offset",
    "joint_compliance": "joints",
    "payload": "bodies",
    "com_offset": "bodies",
    "link_inertia": "bodies",
    "ground_friction": "ground",
    "contact_compliance": "ground",
    "terrain_height": "ground",
    "terrain_tilt": "ground",
    "terrain_scale": "ground",
    "terrain_wobble": "ground",
    "observation_delay": "delays",
    "imu_bias": "imu_bias",
    "camera_delay": "camera",
    "camera_mount": "camera",
    "depth_noise": "camera",
    "external_force": "bodies",
    "link_geometry": "bodies",
    "friction_of_joints": "friction",
    "position_torque": "joints",
    "thrust_gain": "drives",
    "tendon_gain": "drives",
}
"""Effect -> the file of its kind, in which it is a constant of the same name."""
EFFECTS = Effects(
    "effect",
    {name: f"realsim.gap.effects.{file}:{name.upper()}" for name, file in _FILES.items()},
    group="realsim.effects",
)

ON_REQUEST = ("friction_of_joints", "position_torque")
"""Effects that are considered only where they are named. They hold simpler ones as special cases: with them in every
search, dry friction of one joint was no longer told from friction of all (examples/03_diagnose.py)."""
