"""The library of effects: a file a law, one line here an effect; your own packages add more (`realsim.effects`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from realsim.core.errors import GapError
from realsim.core.registry import Registry

if TYPE_CHECKING:
    from realsim.gap.effects.base import Effect


class Effects(Registry):
    """Effects by name; those of installed packages are checked when they are first used."""

    def __getitem__(self, name: str) -> Effect:
        effect = super().__getitem__(name)
        if name not in self.own:
            from realsim.gap.effects.base import Effect

            if not isinstance(effect, Effect) or effect.name != name:
                raise GapError(
                    f"the effect {name!r} of an installed package is none",
                    expected=f"a realsim.gap.effects.base.Effect with the name {name!r}",
                    found=f"an effect {effect.name!r}" if isinstance(effect, Effect) else repr(effect)[:80],
                )
        return effect


_SHARED = {
    "command_delay": "delays:COMMAND",
    "observation_delay": "delays:OBSERVATION",
    **{name: f"camera:{name.upper()}" for name in ("camera_delay", "camera_mount", "depth_noise")},
}
"""Effects of one law, in one file."""
EFFECTS = Effects(
    "effect",
    {
        name: f"realsim.gap.effects.{_SHARED.get(name, f'{name}:EFFECT')}"
        for name in (
            "command_delay",
            "motor_gain",
            "stiffness_gain",
            "damping_gain",
            "torque_limit",
            "torque_speed_limit",
            "coulomb_friction",
            "viscous_friction",
            "stribeck_friction",
            "load_friction",
            "armature",
            "backlash",
            "joint_offset",
            "joint_compliance",
            "payload",
            "com_offset",
            "link_inertia",
            "ground_friction",
            "contact_compliance",
            "terrain_height",
            "terrain_tilt",
            "terrain_scale",
            "terrain_wobble",
            "observation_delay",
            "imu_bias",
            "camera_delay",
            "camera_mount",
            "depth_noise",
            "external_force",
            "link_geometry",
            "friction_of_joints",
            "position_torque",
            "thrust_gain",
        )
    },
    group="realsim.effects",
)

ON_REQUEST = ("friction_of_joints", "position_torque")
"""Effects that are considered only where they are named. They hold simpler ones as special cases: with them in every
search, dry friction of one joint was no longer told from friction of all (examples/03_diagnose.py)."""
