"""Logs of a Crazyflie's micro-SD deck, and bodies without joints."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap.recordings import load_target, propose, read, write_case
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.readers import crazyflie

DRONE = """
<mujoco><worldbody><body name="cf" pos="0 0 1"><freejoint/><geom type="box" size="0.03 0.03 0.01" mass="0.03"/>
<site name="s1"/><site name="s2"/><site name="s3"/><site name="s4"/></body></worldbody><actuator>
<motor name="m1" site="s1" gear="0 0 1 0 0 0"/><motor name="m2" site="s2" gear="0 0 1 0 0 0"/>
<motor name="m3" site="s3" gear="0 0 1 0 0 0"/><motor name="m4" site="s4" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
NAMES = ["motor.m1(I)", "motor.m2(I)", "motor.m3(I)", "motor.m4(I)"]
STATE = [f"stateEstimate.{n}(f)" for n in ("x", "y", "z", "roll", "pitch", "yaw")]


def log(path: Path, version: int = 2, count: int = 200, share: float | None = None) -> dict[str, np.ndarray]:
    """A flight as the firmware writes it; what it holds, in the file's units. `share`: the motors' duty is logged, too,
    as a share of what is commanded."""
    t = 0.01 * np.arange(count)
    pwm = np.stack([30000 + 2000 * np.sin(t * (k + 1)) for k in range(4)], axis=1).astype(int)
    state = np.stack([np.sin(t), np.cos(t), 1 + 0.1 * t, 5 * np.sin(t), 3 * np.cos(t), 20 * t], axis=1)
    head = struct.pack("<BHHH", 0xBC, version, 1, 255) + b"fixedFrequency\0" + struct.pack("<H", 10)
    duty = [] if share is None else [f"pwm.m{k}_pwm(I)" for k in range(1, 5)]
    head = head[:-2] + struct.pack("<H", 10 + len(duty))
    data = head + b"".join(n.encode() + b"\0" for n in (*NAMES, *duty, *STATE))
    for i in range(count):
        stamp = (
            struct.pack("<HQ", 255, int(1e6 * t[i]) + 500) if version == 2 else struct.pack("<HI", 255, int(1e3 * t[i]))
        )
        made = [] if share is None else [round(share * u) for u in pwm[i].tolist()]
        data += stamp + struct.pack(f"<{4 + len(made)}I6f", *pwm[i].tolist(), *made, *state[i].tolist())
    path.write_bytes(data + struct.pack("<I", zlib.crc32(data)))
    return {"time": t, "pwm": pwm, "state": state}


@pytest.mark.parametrize("version", [1, 2])
def test_a_flight_becomes_a_case_without_joints(version: int, tmp_path: Path) -> None:
    (tmp_path / "drone.xml").write_text(DRONE)
    flown = log(tmp_path / "log00", version)
    target = load_target(tmp_path / "drone.xml")
    found = propose(read(tmp_path / "log00"), target)
    assert found.complete
    assert found.joints == ()
    assert found.command_kind == "torque"
    assert found.assignments["command"].doubtful  # another drone's thrust
    arrays = run_arrays(found, found.recordings[0]).arrays
    u = flown["pwm"].astype(float)
    np.testing.assert_allclose(arrays["command"], 2.130295e-11 * u**2 + 1.032633e-6 * u + 5.484560e-4)
    np.testing.assert_allclose(arrays["base_pos"], flown["state"][:, :3], atol=1e-6)
    w, x, y, z = arrays["base_quat"].T
    roll, pitch, yaw = np.deg2rad(flown["state"][:, 3:].T)
    np.testing.assert_allclose(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x**2 + y**2)), roll, atol=1e-6)
    np.testing.assert_allclose(np.arcsin(2 * (w * y - z * x)), -pitch, atol=1e-6)  # the firmware's other sign
    np.testing.assert_allclose(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2)), yaw, atol=1e-6)
    write_case(found, target, tmp_path / "case")
    assert "joint_names" in (tmp_path / "case" / "log.json").read_text()
    assert "<svg" in (tmp_path / "case" / "log.html").read_text()


@pytest.mark.parametrize(("share", "compensated"), [(1.0, False), (1.2, True)])
def test_a_firmware_that_compensates_the_voltage_commands_thrusts(
    share: float, compensated: bool, tmp_path: Path
) -> None:
    flown = log(tmp_path / "log00", share=share)
    (run,) = read(tmp_path / "log00")
    u = flown["pwm"].astype(float)
    law = u * 0.060 * 9.81 / 4 / 65536 if compensated else 2.130295e-11 * u**2 + 1.032633e-6 * u + 5.484560e-4
    np.testing.assert_allclose(run.streams[0].fields["motor thrust command"].values, law)


def test_a_table_of_the_plain_names(tmp_path: Path) -> None:
    """Axes of a state, and columns that name the actuators; how much a motor's PWM pushes is in doubt."""
    (tmp_path / "drone.xml").write_text(DRONE)
    flown = log(tmp_path / "log00")
    names = ["time", *(f"stateEstimate.{n}" for n in "xyz"), *(f"stateEstimate.q{n}" for n in "xyzw")]
    quat = np.stack([0 * flown["time"], np.sin(0.1 * flown["time"]), 0 * flown["time"], np.cos(0.1 * flown["time"])], 1)
    table = np.column_stack([flown["time"], flown["state"][:, :3], quat, flown["pwm"]])
    for motor in ("m{}", "motor.m{}"):
        header = ",".join([*names, *(motor.format(k) for k in range(1, 5))])
        np.savetxt(tmp_path / "flight.csv", table, delimiter=",", header=header, comments="")
        found = propose(read(tmp_path / "flight.csv"), load_target(tmp_path / "drone.xml"))
        assert found.complete, found.render()
        assert found.assignments["command"].doubtful
        arrays = run_arrays(found, found.recordings[0]).arrays
        np.testing.assert_allclose(arrays["base_pos"], flown["state"][:, :3])
        np.testing.assert_allclose(arrays["base_quat"], quat[:, [3, 0, 1, 2]], atol=1e-9)
        np.testing.assert_allclose(arrays["command"], flown["pwm"])


def test_a_log_that_is_cut_off_or_damaged(tmp_path: Path) -> None:
    log(tmp_path / "log00")
    data = (tmp_path / "log00").read_bytes()
    (tmp_path / "log01").write_bytes(data[:-700])
    (run,) = read(tmp_path / "log01")
    assert 150 < run.streams[0].count < 200
    assert "read as far as it goes" in run.notes[0]
    for length in (5, 20, 60):
        (tmp_path / "log02").write_bytes(data[:length])
        with pytest.raises(GapError):
            read(tmp_path / "log02")


def test_real_flights(shared: Callable[[str], Path]) -> None:
    """Commands and attitudes of the case that was made by hand from the same flight, with Foerster's law."""
    (run,) = read(shared("real_logs") / "crazypad" / "add_weight_W3_near_M3" / "E9_log00")
    made = np.load(shared("cases") / "logs" / "cf_W3_M3" / "runs" / "E9_log00_00.npz")
    fields = run.streams[0].fields
    first = int(np.argmin(np.abs(fields["stateEstimate"].values - made["base_pos"][0]).sum(axis=1)))
    rows = slice(first, first + len(made["time"]))
    commanded = fields["motor thrust command"].values[rows] / crazyflie.COMPENSATED[1]
    np.testing.assert_allclose(np.polyval(crazyflie.THRUST, commanded), made["command"], atol=1e-9)
    np.testing.assert_allclose(fields["base_quat"].values[rows], made["base_quat"], atol=0.05)
