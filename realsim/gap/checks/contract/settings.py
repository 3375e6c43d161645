"""The setting behind a mistake, in the words of the framework that the policy comes from."""

_MJLAB, _ISAAC, _UNITREE, _OWN = "mjlab", "isaaclab", "unitree", "realsim"

_SETTINGS: dict[str, tuple[str, str, str, str]] = {
    # kind: realsim, mjlab, Isaac Lab, Unitree's deploy.yaml
    "joint_order": ("layout.actions of the ONNX metadata", "joint_names of the ONNX metadata",
                    "joint_names of JointPositionActionCfg (preserve_order)", "joint_ids_map"),
    "joint_sign": ("the sign of that joint in your bridge", "the joint's axis in the MJCF against the motor's",
                   "the joint's axis in the USD against the motor's", "the motor's direction in the robot's driver"),
    "zero_offset": ("the encoder's zero in your bridge", "the encoder's zero against the MJCF's",
                    "the encoder's zero against the USD's", "the motor's zero (calibration of the encoder)"),
    "default_pose": ("default of the ONNX metadata", "init_state.joint_pos; default_joint_pos of the metadata",
                     "init_state.joint_pos; use_default_offset", "default_joint_pos, and actions' offset"),
    "action_scale": ("action_scale of the ONNX metadata", "scale of JointPositionActionCfg",
                     "scale of JointPositionActionCfg", "actions.JointPositionAction.scale"),
    "gains": ("kp, kd of the ONNX metadata, sent by `start`", "stiffness, damping of the actuator's config",
              "stiffness, damping of ImplicitActuatorCfg", "stiffness, damping (motor order)"),
    "quaternion_order": ("w x y z in Reading.gravity", "projected_gravity from a w x y z quaternion",
                         "projected_gravity from a w x y z quaternion", "imu_state.quaternion is w x y z"),
    "gravity_frame": ("Reading.gravity: down, base axes", "projected_gravity", "projected_gravity",
                      "observations.projected_gravity; the IMU's frame"),
    "rate_frame": ("Reading.ang_vel: base axes", "base_ang_vel", "base_ang_vel (not root_ang_vel_w)",
                   "observations.base_ang_vel; imu_state.gyroscope"),
    "imu_rotation": ("the mount of the IMU in your bridge", "the site of the IMU", "the offset of ImuCfg",
                     "which IMU is read (pelvis or torso), and its mount"),
    "control_period": ("policy_dt", "decimation x sim.timestep", "decimation x sim.dt", "step_dt"),
    "history_order": ("oldest first, term by term", "history_length; flatten_history_dim",
                      "history_length; flatten_history_dim", "history_length; use_gym_history"),
    "history_length": ("the widths of layout.actor", "history_length", "history_length",
                       "observations.*.history_length"),
    "history_stride": ("one moment a policy step", "history_length", "history_length", "history_length; step_dt"),
    "sensor_delay": ("latency between read and write", "delay_min_lag, delay_max_lag of the observation group",
                          "DelayedPDActuatorCfg, or delayed observations", "the age of lowstate when it is read"),
    "sensor_age": ("the newest sample of that sensor in `read`", "delay_min_lag, delay_max_lag of that term",
                   "a delay of that term (modifiers)", "the age of that topic when it is read"),
    "irregular_readings": ("queue depth 1 and one clock", "queue depth 1 and one clock", "queue depth 1 and one clock",
                           "the thread that copies lowstate"),
    "clipped_action": ("action_limit of the ONNX metadata", "clip_actions of the runner", "clip_actions of the runner",
                       "actions.JointPositionAction.clip"),
    "clipped_target": ("--max-step, or the drive's limits", "joint limits on targets", "clip of the action's config",
                       "the drive's position limits"),
    "action_filter": ("no filter between the policy and `write`", "no filter on targets, or train with it",
                      "alpha of the EMA action's config", "no filter between the policy and motor_cmd.q"),
    "observation_scale": ("units of Reading: rad, rad/s", "scale of the observation's config", "scale of ObsTerm",
                          "observations.*.scale"),
    "observation_offset": ("the gyroscope's bias", "the gyroscope's bias", "the gyroscope's bias",
                           "the gyroscope's bias (calibrate at rest)"),
    "velocity_command": ("steer= of the loop", "the command's order and signs", "the command's order and signs",
                         "commands.base_velocity; the joystick's axes"),
    "last_action": ("the action itself, before scaling", "last_action: raw actions", "last_action: raw actions",
                    "observations.last_action"),
    "term_order": ("the order of layout.actor", "observation_names of the metadata", "the order of the group's terms",
                   "the order of observations"),
}  # fmt: skip
"""Kind of a mistake -> what to change."""


def setting(kind: str, framework: str) -> str:
    """What to change about a mistake of this kind; empty for an unknown one."""
    at = (_OWN, _MJLAB, _ISAAC, _UNITREE).index(framework)
    return _SETTINGS[kind][at] if kind in _SETTINGS else ""
