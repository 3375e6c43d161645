"""Log of a Crazyflie's micro-SD deck: events with their variables in a header, then samples in a row.

Format: bitcraze/crazyflie-firmware, tools/usdlog/cfusdlog.py, versions 1 (stamps in ms) and 2 (in us). Thrust of a
motor from its PWM u (0 to 65535): Foerster, System identification of the Crazyflie 2.0, ETH 2015,
T = 2.130295e-11 u^2 + 1.032633e-6 u + 5.484560e-4 N; that of one drone at one voltage, so it is in doubt. A firmware
that compensates the battery's voltage (motors.c, motorsCompensateBatteryVoltage) logs the thrust itself in motor.m, of
65536 for a quarter of 60 g, and what it made of it in pwm.m_pwm. On 20 flights of two drones vertical accelerations are
1.1 times as large as by that, with the lag of the motors, and 0.8 times as by Foerster's law.
"""

import re
import struct
import zlib
from pathlib import Path

import numpy as np

from realsim.core.files import check_size
from realsim.core.types import F64
from realsim.gap.recordings.recording import Field, Reader, Recording, Stream, no_samples, readable
from realsim.gap.recordings.tables import grouped

MAX_BYTES = 2**30
MAGIC = 0xBC
VERSIONS = {1: ("<HI", 1e-3), 2: ("<HQ", 1e-6)}
"""Version -> (head of an event: id and stamp, s per unit of the stamp)."""
THRUST = (2.130295e-11, 1.032633e-6, 5.484560e-4)
COMPENSATED = (0.0, 0.060 / 4 * 9.81 / 65536, 0.0)
"""The same where the firmware compensates the voltage."""
MOST_EVENTS = 200
_VARIABLE = re.compile(r"^(?P<name>[\w.]+)\((?P<kind>[bBhHiIlLqQfd])\)$")


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in ("", ".bin", ".log", ".usd"):
        return False
    with path.open("rb") as file:
        head = file.read(5)
    return len(head) == 5 and head[0] == MAGIC and struct.unpack("<HH", head[1:])[0] in VERSIONS


def read(path: Path) -> list[Recording]:
    check_size(path, MAX_BYTES)
    data = path.read_bytes()
    notes: list[str] = []
    streams = []
    with readable(path, "micro-SD log"):
        events, begin = _header(data)
        head, tick = VERSIONS[struct.unpack_from("<H", data, 1)[0]]
        samples = _samples(data, begin, head, events, notes)
    for key, (name, variables, _) in events.items():
        if not samples[key]:
            continue
        table = np.array(samples[key], dtype=np.float64)
        columns = {n: table[:, k + 1] for k, n in enumerate(variables)}
        if columns:
            fields = grouped(columns) | _derived(columns)
            streams.append(Stream(name, "crazyflie", {"header": table[:, 0] * tick}, fields))
    if not streams:
        raise no_samples(path, "samples of the events in its header", notes=notes)
    return [Recording(path, path.name.replace(".", "_"), "crazyflie", tuple(streams), notes=tuple(notes))]


def _header(data: bytes) -> tuple[dict[int, tuple[str, list[str], str]], int]:
    """(event -> name, variables, struct of one sample; where the samples begin)."""
    count = struct.unpack_from("<H", data, 3)[0]
    if count > MOST_EVENTS:
        raise ValueError(f"{count} kinds of events")
    events: dict[int, tuple[str, list[str], str]] = {}
    at = 5
    for _ in range(count):
        key = struct.unpack_from("<H", data, at)[0]
        name, at = _text(data, at + 2)
        variables: list[str] = []
        kinds = "<"
        for _ in range(struct.unpack_from("<H", data, at)[0]):
            text, at = _text(data, at + (0 if variables else 2))
            found = _VARIABLE.match(text)
            if found is None:
                raise ValueError(f"variable {text[:40]!r}")
            variables.append(found["name"])
            kinds += found["kind"]
        events[key] = name, variables, kinds
    return events, at


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def _samples(
    data: bytes, at: int, head: str, events: dict[int, tuple[str, list[str], str]], notes: list[str]
) -> dict[int, list[tuple[float, ...]]]:
    """Event -> rows of its stamp and values, up to the checksum or to where the file is cut off."""
    found: dict[int, list[tuple[float, ...]]] = {key: [] for key in events}
    parts = {key: struct.Struct(head + kinds[1:]) for key, (_, _, kinds) in events.items()}
    end = len(data) - 4  # a checksum (CRC-32) of what is before it
    if zlib.crc32(data[:end]) != struct.unpack_from("<I", data, end)[0]:
        notes.append("the checksum is not that of the file: it is cut off or damaged, and read as far as it goes")
    while at + 2 <= end:
        part = parts.get(struct.unpack_from("<H", data, at)[0])
        if part is None or at + part.size > end:
            break
        key, *values = part.unpack_from(data, at)
        found[key].append(tuple(values))
        at += part.size
    return found


def _derived(columns: dict[str, F64]) -> dict[str, Field]:
    """Thrusts of the motors and attitude of the drone, in SI units, from variables of the firmware."""
    found = {}
    motors = [f"motor.m{k}" for k in range(1, 5)]
    if all(m in columns for m in motors):
        pwm = np.stack([columns[m] for m in motors], axis=1)
        made = np.stack([columns.get(f"pwm.m{k}_pwm", columns[m]) for k, m in enumerate(motors, 1)], axis=1)
        law = THRUST if np.array_equal(made, pwm) else COMPENSATED
        thrust = law[0] * pwm**2 + law[1] * pwm + law[2]
        found["motor thrust command"] = Field(thrust, ("m1", "m2", "m3", "m4"), "N")
    if (quat := _attitude(columns)) is not None:
        found["base_quat"] = Field(quat, tuple("wxyz"))
    return found


def _attitude(columns: dict[str, F64]) -> F64 | None:
    """(T, 4) w x y z from the estimate's angles; without the pitch, from yaw and the direction of the thrust.

    The firmware's pitch has the other sign than that about y (its legacy axes). Its accelerations are those of the
    world in g without gravity; a drone that flies slowly accelerates along its thrust only.
    """
    from scipy.spatial.transform import Rotation

    names = [f"stateEstimate.{n}" for n in ("roll", "pitch", "yaw", "ax", "ay", "az")]
    roll, pitch, yaw, ax, ay, az = (columns.get(n) for n in names)
    if yaw is None:
        return None
    if roll is not None and pitch is not None:
        turn = Rotation.from_euler("ZYX", np.stack([yaw, -pitch, roll], axis=1), degrees=True)
    elif ax is not None and ay is not None and az is not None:
        up = np.stack([ax, ay, az + 1.0], axis=1)
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
        heading = np.deg2rad(yaw)
        left = np.cross(up, np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1))
        left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
        turn = Rotation.from_matrix(np.stack([np.cross(left, up), left, up], axis=2))
    else:
        return None
    return np.asarray(turn.as_quat()[:, [3, 0, 1, 2]])


READER = Reader("crazyflie", "a log of a Crazyflie's micro-SD deck", recognise, read)
