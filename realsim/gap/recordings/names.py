"""Knowledge about names: known message types, words in names of columns, motor tables of robots."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from realsim.core.types import F64

ROLES = (
    "command",
    "enabled",
    "joint_pos",
    "joint_vel",
    "joint_torque",
    "base_pos",
    "base_quat",
    "imu_gyro",
    "imu_acc",
    "contact",
)
"""Arrays of a case."""
JOINTS = ("joint_pos", "joint_vel", "joint_torque")

# Message type (last part) -> member -> (role, unit). `command.` roles say what is commanded.
# Sources: the .msg files of common_interfaces, control_msgs, unitree_ros2 and px4_msgs.
_STATE = {"position": ("joint_pos", "rad"), "velocity": ("joint_vel", "rad/s"), "effort": ("joint_torque", "N m")}
_IMU = {"imu_state.quaternion": ("base_quat", "wxyz"), "imu_state.gyroscope": ("imu_gyro", "rad/s"),
        "imu_state.accelerometer": ("imu_acc", "m/s^2")}  # fmt: skip
_MOTORS = {"motor_state.q": ("joint_pos", "rad"), "motor_state.dq": ("joint_vel", "rad/s"),
           "motor_state.tau_est": ("joint_torque", "N m"), "foot_force": ("contact", "")}  # fmt: skip
_POSE = {"pose.pose.position": ("base_pos", "m"), "pose.pose.orientation": ("base_quat", "xyzw"),
         "pose.position": ("base_pos", "m"), "pose.orientation": ("base_quat", "xyzw"),
         "transform.translation": ("base_pos", "m"), "transform.rotation": ("base_quat", "xyzw")}  # fmt: skip
_CONTROLLER = {
    "feedback.positions": ("joint_pos", "rad"), "feedback.velocities": ("joint_vel", "rad/s"),
    "actual.positions": ("joint_pos", "rad"), "actual.velocities": ("joint_vel", "rad/s"),
    "feedback.effort": ("joint_torque", "N m"), "actual.effort": ("joint_torque", "N m"),
    "reference.positions": ("command.position", "rad"), "desired.positions": ("command.position", "rad"),
}  # fmt: skip
TYPES: dict[str, dict[str, tuple[str, str]]] = {
    "JointState": _STATE,
    "DynamicJointState": {f"interfaces.{i}.{k}": v for i in range(8) for k, v in _STATE.items()},
    "JointTrajectory": {"positions": ("command.position", "rad")},
    "JointTrajectoryControllerState": _CONTROLLER,
    "JointTrajectoryControllerStateStamped": _CONTROLLER,
    "Imu": {"linear_acceleration": ("imu_acc", "m/s^2"), "angular_velocity": ("imu_gyro", "rad/s"),
            "orientation": ("base_quat", "xyzw")},
    "Odometry": _POSE, "PoseStamped": _POSE, "PoseWithCovarianceStamped": _POSE, "TransformStamped": _POSE,
    "LowState": _MOTORS | _IMU,
    "LowState_": _MOTORS | _IMU,
    "LowCmd": {"motor_cmd.q": ("command.position", "rad"), "motor_cmd.tau": ("command.torque", "N m")},
    "LowCmd_": {"motor_cmd.q": ("command.position", "rad"), "motor_cmd.tau": ("command.torque", "N m")},
    "SportModeState": {"position": ("base_pos", "m")} | _IMU,
    "vehicle_attitude": {"q": ("base_quat", "wxyz")},
    "vehicle_local_position": {},
    "sensor_combined": {"gyro_rad": ("imu_gyro", "rad/s"), "accelerometer_m_s2": ("imu_acc", "m/s^2")},
}  # fmt: skip

_SENT = r"cmds?|commands?|commanded|des|desired|targets?|goals?|ref|reference|setpoints?|actions?|ctrl|control"
_NOT = re.compile(r"(^|_)(error|err|temp|temperature|temps|volt|volts|voltage|raw|ddq|kp|kd|limit|min|max|power)(_|$)")
_WORDS: tuple[tuple[str, str], ...] = (
    ("enabled", r"(^|_)(torque_enabled?|torque_on|motors?_enabled?|drives?_enabled?|enabled)(_|$)"),
    ("imu_acc", r"(^|_)(acc|accel|accelerometer|accelerations?_(linear|imu)|linear_accelerations?|imu_acc)(_|$)"),
    ("imu_gyro", r"(^|_)(gyro|gyroscope|angular_velocity|ang_vel|base_ang_vel|omega|imu_gyro)(_|$)"),
    ("base_quat", r"(^|_)(quat|quaternion|orientation|base_quat)(_|$)"),
    ("base_pos", r"(^|_)(base_pos|base_position|root_pos|body_position|mocap_pos|base_xyz|translation)(_|$)"),
    ("contact", r"(^|_)(contacts?|foot_force|foot_contacts?|feet_contacts?)(_|$)"),
    ("joint_torque", r"(^|_)(tau|taus|torques?|efforts?|current|load|tau_est)(_|$)"),
    ("joint_vel", r"(^|_)(dq|qd|qdot|qvel|vel|velocity|velocities|speeds?|dof_vel)(_|$)"),
    ("joint_pos", r"(^|_)(q|qpos|pos|position|positions|angles?|joints|dof_pos|state|encoders?)(_|$)"),
)
_CLOCK = re.compile(
    r"^(t|time|times|timestamps?|stamp|tick|ticks|clock|time_boot|timestamp_sample|ros_time|log_time|elapsed|rectime)"
    r"(_?(s|sec|secs|seconds|ms|us|ns|usec|msec|nsec|micros|millis))?$"
)
_UNITS = (
    ("deg/s", r"(deg_?p?e?r?_?s|dps|degs)$"), ("deg", r"(_|\[|\()deg(rees)?[\])]?$"), ("rad/s", r"rad_?(per_)?s$"),
    ("rpm", r"rpm$"), ("mN m", r"mnm$"), ("mm", r"_mm$"), ("g", r"_g$"), ("rad", r"_rad$"), ("N m", r"_nm$"),
)  # fmt: skip
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
RATES = (5.0, 5000.0)
"""Hz that a log of a robot is likely to have."""
CLOCK_UNITS = {"ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "us": 1e-6, "usec": 1e-6, "micros": 1e-6, "ns": 1e-9,
               "nsec": 1e-9, "s": 1.0, "sec": 1.0, "secs": 1.0, "seconds": 1.0}  # fmt: skip


def known_type(kind: str) -> bool:
    """Whether it is known what the members of a message type mean."""
    return bool(TYPES.get(kind.replace("::", "/").rsplit("/", 1)[-1].rsplit(".", 1)[-1]))


def plain(name: str) -> str:
    """A name in lower case with one kind of separator: `Goal Position (deg)` -> `goal_position_deg`."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")


def words(name: str) -> list[str]:
    """The words of a name, numbers apart: `FL_hip_joint2` -> fl, hip, joint, 2."""
    return re.findall(r"[a-z]+|[0-9]+", plain(name))


def is_clock(name: str) -> bool:
    """Whether a column or member is a time or a counter, by its name."""
    return bool(_CLOCK.match(plain(name)))


def clock_unit(name: str) -> float | None:
    """Seconds per unit of this clock, if its name gives it."""
    found = _CLOCK.match(plain(name))
    last = found.group(3) if found else None
    return CLOCK_UNITS.get(last) if last else None


def seconds_of(name: str, raw: F64) -> tuple[F64, str]:
    """(a clock in s, its unit): as its name says, else as gives a likely rate, s before ms, us, ns."""
    factor = clock_unit(name)
    if factor is None:
        step = float(np.median(np.abs(np.diff(raw)))) if len(raw) > 1 else 1.0
        fits = [f for f in UNITS.values() if RATES[0] <= 1 / max(step * f, 1e-12) <= RATES[1]]
        factor = fits[0] if fits else 1.0
    unit = next(u for u, f in UNITS.items() if f == factor)
    return raw * factor, unit


def named_unit(name: str) -> str:
    """The unit that a name ends in, or nothing."""
    text = name.lower().strip()
    return next((unit for unit, pattern in _UNITS if re.search(pattern, text)), "")


def meaning(stream: str, kind: str, member: str) -> tuple[str, str, str]:
    """(role, unit, why) that names suggest; the role is empty where they suggest none.

    A command's role is `command.position`, `command.velocity`, `command.torque`, or `command` if unspecified.
    """
    last = kind.replace("::", "/").rsplit("/", 1)[-1].rsplit(".", 1)[-1]
    sent = re.search(rf"(^|_)({_SENT})(_|$)", plain(stream)) is not None
    known = TYPES.get(last, {}).get(member)
    if known is not None:
        role, unit = known
        if sent and role in JOINTS:
            role = {"joint_pos": "command.position", "joint_vel": "command.velocity"}.get(role, "command.torque")
            return role, unit, f"{member} of {kind} on a topic named for commands"
        return role, unit, f"{member} of {kind}"
    if known_type(kind):
        return "", "", ""  # the type is known, and this member is none of these
    ending = member.rpartition(".")[2]
    text = plain(member if ending in ("data", "values", "value") else ending)
    if _NOT.search(text):
        return "", "", ""
    unit = named_unit(member)
    role = next((r for r, pattern in _WORDS if re.search(pattern, re.sub(rf"(^|_)({_SENT})(?=_|$)", "", text))), "")
    asked = sent or re.search(rf"(^|_)({_SENT})(_|$)", text) is not None
    above = plain(member.rpartition(".")[0].rpartition(".")[2])  # motor_cmd of motor_cmd.q
    below_sent = re.search(rf"(^|_)({_SENT})(_|$)", above) is not None
    if (asked and role in ("", *JOINTS)) or (below_sent and role in JOINTS):
        kinds = {"joint_pos": ".position", "joint_vel": ".velocity", "joint_torque": ".torque"}
        return f"command{kinds.get(role, '')}", unit, f"the name {member!r}" + (f" in {stream!r}" if sent else "")
    return role, unit, f"the name {member!r}" if role else ""


# ---------------------------------------------------------------- motor tables

_LEGS = [f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
_ARM = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"]
_LEG = ["hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"]
MOTOR_TABLES: dict[str, list[str]] = {
    # Unitree's SDK: index of motor_state and motor_cmd -> joint; empty where the robot has no such motor.
    "Unitree Go1, Go2, A1, B2": _LEGS,
    "Unitree G1 (29)": [f"{side}_{j}" for side in ("left", "right") for j in _LEG]
    + ["waist_yaw", "waist_roll", "waist_pitch"]
    + [f"{side}_{j}" for side in ("left", "right") for j in _ARM],
    "Unitree G1 (23)": [f"{side}_{j}" for side in ("left", "right") for j in _LEG]
    + ["waist_yaw", "", ""]
    + [f"left_{j}" for j in _ARM[:5]]
    + ["", ""]
    + [f"right_{j}" for j in _ARM[:5]],
    "Unitree H1": [f"{side}_{j}" for side in ("right", "left") for j in ("hip_roll", "hip_pitch", "knee")]
    + ["torso", "left_hip_yaw", "right_hip_yaw", "", "left_ankle", "right_ankle"]
    + [f"{side}_{j}" for side in ("right", "left") for j in _ARM[:4]],
    # unitree_sdk2, example/h1/low_level/h1_27dof_example.cpp: H1JointIndex. The torso is named as in h1_2_description.
    "Unitree H1-2": [
        f"{side}_{j}"
        for side in ("left", "right")
        for j in ("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
    ]
    + ["torso"]
    + [f"{side}_{j}" for side in ("left", "right") for j in _ARM],
    # unitree_sdk2, example/r1/low_level/r1_ankle_swing_example.cpp: slots are joint_idx_in_idl at the places of
    # R1JointIndex, in which RightShoulderPitch stands at 19 (and says 29).
    "Unitree R1": [f"{side}_{j}" for side in ("left", "right") for j in _LEG]
    + ["waist_roll", "waist_yaw", ""]
    + [f"left_{j}" for j in _ARM[:5]]
    + ["", ""]
    + [f"right_{j}" for j in _ARM[:5]]
    + ["", "", "head_pitch", "head_yaw"],
    "LeRobot SO-100, SO-101": ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"],
}
FEET: dict[str, list[str]] = {"Unitree Go1, Go2, A1, B2": ["FR", "FL", "RR", "RL"]}


def same_joint(label: str, joint: str) -> bool:
    """Whether a label in a log means this joint of a model: the same words, without `joint`, `motor`, `pos`."""
    a, b = _core(label), _core(joint)
    return bool(a) and a == b


def match_joints(labels: Sequence[str], joints: Sequence[str]) -> dict[int, str]:
    """Column -> joint, where the label names exactly one; a prefix of all labels (a namespace) does not matter."""
    found: dict[int, str] = {}
    for column, label in enumerate(labels):
        alike = [j for j in joints if j == label] or [j for j in joints if same_joint(label, j)]
        alike = alike or [j for j in joints if _ends(label, j)]
        if len(alike) == 1 and alike[0] not in found.values():
            found[column] = alike[0]
    return found


def _core(name: str) -> list[str]:
    found = [w for w in words(name) if w not in ("joint", "motor", "servo", "pos", "dof")]
    return found if any(not w.isdigit() for w in found) else words(name)


def _ends(label: str, joint: str) -> bool:
    a, b = _core(label), _core(joint)
    return len(b) > 0 and len(a) > len(b) and a[-len(b) :] == b
