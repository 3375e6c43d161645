"""The library of effects: one file an effect, one line here."""

from realsim.core.registry import Registry

EFFECTS = Registry(
    "effect",
    {
        name: f"realsim.gap.effects.{name}:EFFECT"
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
)

ON_REQUEST = ("friction_of_joints", "position_torque")
"""Effects that are considered only where they are named. They hold simpler ones as special cases: with them in every
search, dry friction of one joint was no longer told from friction of all (examples/diagnose.py)."""
