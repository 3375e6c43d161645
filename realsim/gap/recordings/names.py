"""What names mean: known message types, words in names of columns, motor tables of robots."""

import re
from collections.abc import Sequence

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.units import ANGLE, TORQUE, TURNING
from realsim.gap.recordings.vocabulary import (
    KINDS,
    SIDES,
    SIGNALS,
    TIMES,
    english,
    plain,
    split_unit,
    time_unit,
    unit_of,
)

JOINTS = ("joint_pos", "joint_vel", "joint_torque")
ROLES = ("command", "enabled", *JOINTS, "base_pos", "base_quat", "imu_gyro", "imu_acc", "contact", "policy_command")
"""Arrays of a case."""

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

IN_TURNS = {"pos_estimate": "rev", "vel_estimate": "rev/s", "input_pos": "rev", "input_vel": "rev/s"}
IN_TURNS |= {"pos_vel_mapper_pos": "rev", "pos_vel_mapper_vel": "rev/s"}
"""Names of an ODrive's signals, which count turns (docs.odriverobotics.com, ODrive.Axis)."""
_NOT = {
    word
    for words in (
        "error temperature voltage raw ddq qdd kp kd ki limit limits min max power fric friction gravity",
        "grav comp compensation ff feedforward std var status mode tcp tool ee eef flange cartesian flux",
    )
    for word in words.split()
}
"""Words of what is no signal of a joint: bounds, settings, parts of a command that a controller adds, the tool."""
_WORDS: tuple[tuple[str, str], ...] = (
    ("enabled", r"(^|_)(torque_enabled?|torque_on|joint_enabled?|drives?_enabled?|enabled)(_|$)"),
    ("imu_acc", r"(^|_)(acc|accel|accelerometer|accelerations?_(linear|imu)|linear_accelerations?|imu_acc)(_|$)"),
    ("imu_gyro", r"(^|_)(gyro|gyroscope|angular_velocity|ang_velocity|omega|imu_gyro)(_|$)"),
    ("base_quat", r"(^|_)(quat|quaternion|orientation|base_quat)(_|$)"),
    ("base_pos", r"(^|_)((base|root|body|mocap)_position|base_xyz|translation)(_|$)"),
    ("contact", r"(^|_)(contacts?|foot_force|foot_contacts?|feet_contacts?)(_|$)"),
    ("joint_torque", r"(^|_)(torque|electric)(_|$)"),
    ("joint_vel", r"(^|_)velocity(_|$)"),
    ("joint_pos", r"(^|_)position(_|$)"),
)
"""Role and the English words (`vocabulary.english`) that suggest it."""
_BY_UNIT = dict.fromkeys(ANGLE, "joint_pos") | dict.fromkeys(TURNING, "joint_vel")
_BY_UNIT |= dict.fromkeys((*TORQUE, "A", "mA"), "joint_torque")
"""What a signal without a telling word is, by its unit."""
RATES = (5.0, 5000.0)
"""Hz that a log of a robot is likely to have."""


def known_type(kind: str) -> bool:
    """Whether it is known what the members of a message type mean."""
    return bool(TYPES.get(_last(kind)))


def _last(kind: str) -> str:
    return kind.replace("::", "/").rsplit("/", 1)[-1].rsplit(".", 1)[-1]


def seconds_of(name: str, raw: F64) -> tuple[F64, str]:
    """(a clock in s, its unit): as its name says, else as gives a likely rate, s before ms, us, ns."""
    factor = TIMES.get(time_unit(name))
    if factor is None:
        step = float(np.median(np.abs(np.diff(raw)))) if len(raw) > 1 else 1.0
        fits = [f for f in TIMES.values() if RATES[0] <= 1 / max(step * f, 1e-12) <= RATES[1]]
        factor = fits[0] if fits else 1.0
    unit = next(u for u, f in TIMES.items() if f == factor)
    return raw * factor, unit


def is_sent(name: str) -> bool:
    """Whether a name of a topic, column or file is one of commands."""
    return "target" in english(name)


def is_other(name: str) -> bool:
    """Whether a name is that of no signal of a joint: a temperature, a gain, the tool."""
    return bool(set(english(name)) & _NOT)


def is_electric(name: str) -> bool:
    """Whether a name is that of a current, or of a load in no unit or in percent: a torque up to an unknown factor."""
    return "electric" in english(name) or "load" in plain(name).split("_") or unit_of(name) in ("A", "mA", "%")


def rawness(name: str) -> int:
    """0 for what is named measured, 2 for what was filtered or estimated, which comes late, else 1."""
    found = english(name)
    return 2 if "filtered" in found else 0 if "measured" in found else 1


def meaning(stream: str, kind: str, member: str) -> tuple[str, str, str]:
    """(role, unit, why) that names suggest; the role is empty where they suggest none.

    A command's role is `command.position`, `command.velocity`, `command.torque`, or `command` if unspecified.
    """
    sent = is_sent(stream)
    known = TYPES.get(_last(kind), {}).get(member)
    if known is not None:
        role, unit = known
        if sent and role in JOINTS:
            return f"command{_COMMANDS[role]}", unit, f"{member} of {kind} on a topic named for commands"
        return role, unit, f"{member} of {kind}"
    if known_type(kind):
        return "", "", ""  # the type is known, and this member is none of these
    unit = unit_of(member) or next((u for name, u in IN_TURNS.items() if name in plain(member)), "")
    above, _, ending = split_unit(member)[0].rpartition(".")  # `J3.ist.mm`
    over = set(english(above.rpartition(".")[2])) & {"target", *KINDS} or len(plain(ending)) < 2  # Ist.A of Ist.A1
    over = over and not set(english(ending)) & set(SIGNALS)
    if ending in ("data", "values", "value") or over:
        ending = member  # `position.left_knee`: what it is stands before whose it is
    found = english(ending)
    if is_other(ending) or is_other(above.rpartition(".")[2]):  # error.positions
        return "", "", ""
    text = "_".join(w for w in found if w != "target")
    role = next((r for r, pattern in _WORDS if re.search(pattern, text)), "")
    commanded = sent or "target" in found or {"controller", "output"} <= set(found)
    if not role and (commanded or "measured" in found or (unit and len(found) <= 1)):
        role = _BY_UNIT.get(unit, "" if commanded or "measured" not in found else "joint_pos")
    sides = [side for part in above.split(".")[::-1] if (side := set(english(part)) & {*SIDES})]
    below_sent = bool(sides) and "target" in sides[0]  # motor_cmd of motor_cmd.q
    if (commanded and role in ("", *JOINTS)) or (below_sent and role in JOINTS):
        return f"command{_COMMANDS.get(role, '')}", unit, f"the name {member!r}" + (f" in {stream!r}" if sent else "")
    return role, unit, f"the name {member!r}" if role else ""


_COMMANDS = {"joint_pos": ".position", "joint_vel": ".velocity", "joint_torque": ".torque"}

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


def match_joints(labels: Sequence[str], joints: Sequence[str]) -> dict[int, str]:
    """Column -> joint, where the label names exactly one; a prefix of all labels (a namespace) does not matter.

    Of labels `motor / joint`, two names of one thing, the side that names more joints counts.
    """
    if any(" / " in label for label in labels):
        sides = zip(*(label.split(" / ") for label in labels), strict=False)
        return max((match_joints(side, joints) for side in sides), key=len, default={})
    found: dict[int, str] = {}
    words = {joint: _core(joint) for joint in joints}
    for column, label in enumerate(labels):
        own = _core(label)
        named = any(not w.isdigit() for w in own)
        n = len(own)
        ways = (
            [j for j in joints if j == label],
            [j for j, w in words.items() if own == w],
            [j for j, w in words.items() if sorted(own) == sorted(w)],  # `hip left`
            [j for j, w in words.items() if 0 < len(w) < n and own[-len(w) :] == w],
            [j for j, w in words.items() if named and n < len(w) and w[:n] == own],  # `knee` of `knee_pitch`
            [j for j, w in words.items() if named and n < len(w) and w[-n:] == own],  # `pan` of `head_pan`
            [j for j, w in words.items() if n == 1 < len(own[0]) and named and w and w[0].startswith(own[0])],  # `sh`
        )
        fitting = next(filter(None, ways), [])
        if len(fitting) == 1 and fitting[0] not in found.values():
            found[column] = fitting[0]
    return found


def _core(name: str) -> list[str]:
    """The words of a joint's name, without `joint`, `motor`, `pos`."""
    found = [w for w in english(name) if w not in ("joint", *SIGNALS)]
    return found if any(not w.isdigit() for w in found) else [w for w in english(name) if w not in SIGNALS]
