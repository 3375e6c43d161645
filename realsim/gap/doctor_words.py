"""What to change about a finding, in the words of mjlab, Isaac Lab and Unitree's deployment."""

from __future__ import annotations

from realsim.gap.checks.contract.settings import setting

FRAMEWORKS = {"mjlab": "mjlab", "Isaac Lab": "isaaclab", "Unitree": "unitree"}
"""Name for a reader -> name in `contract.settings`."""

_ACTUATOR = ("the actuator's config", "ImplicitActuatorCfg or DCMotorCfg", "the simulator's MJCF")
_JOINT = (
    "the joint in the MJCF, or an event term",
    "joint properties of the USD, or an event term",
    "the MJCF's joint",
)
_BODY = ("the body in the MJCF, or randomize_body_mass", "randomize_rigid_body_mass", "the MJCF's body")

_PHYSICS: dict[str, tuple[str, str, str]] = {
    "command_delay": ("delay_min_lag, delay_max_lag of the actuator", "DelayedPDActuatorCfg: min_delay, max_delay",
                      "the loop's period and the age of lowcmd"),
    "observation_delay": ("delay_min_lag, delay_max_lag of the observations", "delayed observations (modifiers)",
                          "the age of lowstate when it is read"),
    "stiffness_gain": ("stiffness of the actuator", "stiffness of the actuator", "stiffness in deploy.yaml"),
    "damping_gain": ("damping of the actuator", "damping of the actuator", "damping in deploy.yaml"),
    "coulomb_friction": ("frictionloss of the joint", "friction of the actuator", "frictionloss in the MJCF"),
    "viscous_friction": ("damping of the joint (passive)", "viscous_friction of the actuator", "damping in the MJCF"),
    "armature": ("armature of the actuator", "armature of the actuator", "armature in the MJCF"),
    "torque_limit": ("effort_limit of the actuator", "effort_limit of the actuator", "the drive's torque limit"),
    "torque_speed_limit": ("effort and velocity limits of the actuator", "DCMotorCfg: saturation_effort",
                           "the drive's torque and speed limits"),
    "motor_gain": _ACTUATOR, "joint_offset": ("the encoder's zero", "the encoder's zero", "the motor's zero"),
    "payload": _BODY, "com_offset": ("the body's com, or randomize_body_com", "randomize_rigid_body_com",
                                     "the MJCF's inertial pos"),
    "link_inertia": _BODY, "backlash": _JOINT, "joint_compliance": _JOINT, "stribeck_friction": _JOINT,
    "load_friction": _JOINT, "imu_bias": ("noise and bias of base_ang_vel", "noise and bias of base_ang_vel",
                                          "calibrate the IMU at rest"),
    "ground_friction": ("geom friction of feet and terrain, or its randomisation", "physics_material of the terrain",
                        "the MJCF's friction"),
    "contact_compliance": ("solref, solimp of feet and terrain", "compliant_contact_stiffness", "the MJCF's solref"),
    "camera_delay": ("latency of the depth observation", "update_period and a delay of the camera's term",
                     "the age of the depth frame"),
    "camera_mount": ("pos and quat of the camera", "OffsetCfg of the camera", "the camera's extrinsics"),
    "depth_noise": ("noise of the depth observation", "noise of the camera's term", "the depth filter"),
    "terrain_height": ("the terrain: import the corrected scene.xml", "the terrain: import the corrected scene as USD",
                       "none: the simulator's terrain"),
}  # fmt: skip
"""Effect -> what to change in mjlab, Isaac Lab, Unitree's deployment."""


def setting_of(kind: str, framework: str) -> str:
    """What to change; for an effect without a setting of its own, what a patch of model.xml does."""
    name = FRAMEWORKS[framework]
    if kind in _PHYSICS:
        return _PHYSICS[kind][list(FRAMEWORKS).index(framework)]
    return setting(kind, name) or f"{kind}: the patch of `realsim diagnose` (model.xml)"
