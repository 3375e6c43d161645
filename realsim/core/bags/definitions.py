"""Definitions of messages that older ROS 2 bags do not carry: sqlite bags up to Humble hold no definitions at all.

Unitree's types as the robots send them (github.com/unitreerobotics/unitree_ros2, BSD-3-Clause).
"""

from functools import cache
from typing import Any

_IMU = "float32[4] quaternion\nfloat32[3] gyroscope\nfloat32[3] accelerometer\nfloat32[3] rpy\n{} temperature\n"
_CMD = "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n"
DEFINITIONS: dict[str, str] = {
    "unitree_go/msg/TimeSpec": "int32 sec\nuint32 nanosec\n",
    "unitree_go/msg/IMUState": _IMU.format("int8"),
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\nfloat32 q_raw\n"
    "float32 dq_raw\nfloat32 ddq_raw\nint8 temperature\nuint32 lost\nuint32[2] reserve\n",
    "unitree_go/msg/MotorCmd": _CMD + "uint32[3] reserve\n",
    "unitree_go/msg/BmsState": "uint8 version_high\nuint8 version_low\nuint8 status\nuint8 soc\nint32 current\n"
    "uint16 cycle\nint8[2] bq_ntc\nint8[2] mcu_ntc\nuint16[15] cell_vol\n",
    "unitree_go/msg/BmsCmd": "uint8 off\nuint8[3] reserve\n",
    "unitree_go/msg/LowState": "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\n"
    "uint32[2] version\nuint16 bandwidth\nunitree_go/IMUState imu_state\nunitree_go/MotorState[20] motor_state\n"
    "unitree_go/BmsState bms_state\nint16[4] foot_force\nint16[4] foot_force_est\nuint32 tick\n"
    "uint8[40] wireless_remote\nuint8 bit_flag\nfloat32 adc_reel\nint8 temperature_ntc1\nint8 temperature_ntc2\n"
    "float32 power_v\nfloat32 power_a\nuint16[4] fan_frequency\nuint32 reserve\nuint32 crc\n",
    "unitree_go/msg/LowCmd": "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\n"
    "uint32[2] version\nuint16 bandwidth\nunitree_go/MotorCmd[20] motor_cmd\nunitree_go/BmsCmd bms_cmd\n"
    "uint8[40] wireless_remote\nuint8[12] led\nuint8[2] fan\nuint8 gpio\nuint32 reserve\nuint32 crc\n",
    "unitree_go/msg/SportModeState": "unitree_go/TimeSpec stamp\nuint32 error_code\nunitree_go/IMUState imu_state\n"
    "uint8 mode\nfloat32 progress\nuint8 gait_type\nfloat32 foot_raise_height\nfloat32[3] position\n"
    "float32 body_height\nfloat32[3] velocity\nfloat32 yaw_speed\nfloat32[4] range_obstacle\nint16[4] foot_force\n"
    "float32[12] foot_position_body\nfloat32[12] foot_speed_body\n",
    "unitree_hg/msg/IMUState": _IMU.format("int16"),
    "unitree_hg/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "int16[2] temperature\nfloat32 vol\nuint32[2] sensor\nuint32 motorstate\nuint32[4] reserve\n",
    "unitree_hg/msg/MotorCmd": _CMD + "uint32 reserve\n",
    "unitree_hg/msg/LowState": "uint32[2] version\nuint8 mode_pr\nuint8 mode_machine\nuint32 tick\n"
    "unitree_hg/IMUState imu_state\nunitree_hg/MotorState[35] motor_state\nuint8[40] wireless_remote\n"
    "uint32[4] reserve\nuint32 crc\n",
    "unitree_hg/msg/LowCmd": "uint8 mode_pr\nuint8 mode_machine\nunitree_hg/MotorCmd[35] motor_cmd\n"
    "uint32[4] reserve\nuint32 crc\n",
}


def register(store: Any, parse: Any) -> Any:
    """The typestore with these types; `parse` is rosbags.typesys.get_types_from_msg."""
    types: dict[str, Any] = {}
    for name, found in _parsed(parse).items():
        if name not in store.fielddefs:
            types.update(found)
    store.register(types)
    return store


@cache
def _parsed(parse: Any) -> dict[str, Any]:
    return {name: parse(text, name) for name, text in DEFINITIONS.items()}
