"""Orders, units, signs and clocks are told by signals and model; what cannot be told is said to be in doubt."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.core.errors import GapError
from realsim.core.text_table import cells
from realsim.gap.recordings import Window, load_target, propose, read, write_case
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.clocks import clocked, declared_rate
from realsim.gap.recordings.names import match_joints, meaning
from realsim.gap.recordings.recording import Field, Recording, Stream
from realsim.gap.recordings.vocabulary import TIMES, is_clock, time_unit

from .robots import ARM, PLACES, QUADRUPED, STAND, Log, save

SDK = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]


def recording(*streams: Stream, facts: dict[str, object] | None = None) -> Recording:
    return Recording(Path("log"), "run", "test", streams, facts=facts or {})


def table(log: Log, **fields: np.ndarray) -> Recording:
    return recording(Stream("", "table", {"time": log.time}, {n: Field(v) for n, v in fields.items()}))


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1.0), ("deg", 180 / np.pi), ("rev", 0.5 / np.pi)])
def test_unit_of_positions_by_ranges(arm: Log, tmp_path: Path, unit: str, factor: float) -> None:
    target = load_target(save(tmp_path, ARM))
    found = propose([table(arm, q=factor * arm.pos, q_des=factor * arm.command)], target)
    place, asked = found.assignments["joint_pos"], found.assignments["command"]
    if unit == "rev":  # a turn as 1 stays within any range: no measure tells it, and it is not guessed
        assert place.unit == "rad"
        return
    assert place.unit == unit
    np.testing.assert_allclose(place.values(Field(factor * arm.pos)), arm.pos, atol=1e-9)
    np.testing.assert_allclose(asked.values(Field(factor * arm.command)), arm.command, atol=1e-9)


def test_steps_of_an_encoder_are_in_doubt(arm: Log, tmp_path: Path) -> None:
    steps = {name: np.round(2048 + v * 4096 / (2 * np.pi)) for name, v in (("q", arm.pos), ("q_des", arm.command))}
    place = propose([table(arm, **steps)], load_target(save(tmp_path, ARM))).assignments["joint_pos"]
    assert (place.unit, place.doubtful) == ("ticks", True)


@pytest.mark.parametrize(
    ("unit", "factor"), [("rad/s", 1.0), ("deg/s", 180 / np.pi), ("rpm", 30 / np.pi), ("rad/s", -1.0)]
)
def test_unit_and_sign_of_velocities_by_the_positions(arm: Log, tmp_path: Path, unit: str, factor: float) -> None:
    target = load_target(save(tmp_path, ARM))
    found = propose([table(arm, q=arm.pos, q_des=arm.command, dq=factor * arm.vel)], target)
    speed = found.assignments["joint_vel"]
    assert speed.unit == unit
    np.testing.assert_allclose(speed.values(Field(factor * arm.vel)), arm.vel, atol=1e-9)


def test_velocities_without_a_model_are_in_the_unit_of_their_name(arm: Log) -> None:
    fields = {"q": Field(np.degrees(arm.pos), ("a [deg]", "b [deg]"), "deg"),
              "q_des": Field(np.degrees(arm.command), ("a [deg]", "b [deg]"), "deg"),
              "dq": Field(np.degrees(arm.vel), ("a [deg/s]", "b [deg/s]"), "deg/s")}  # fmt: skip
    found = propose([recording(Stream("", "table", {"time": arm.time}, fields))])
    assert found.assignments["joint_pos"].unit == found.assignments["command"].unit == "deg"
    assert found.assignments["joint_vel"].unit == "deg/s"


@pytest.mark.parametrize(("unit", "factor"), [("N m", 1.0), ("mN m", 1000.0), ("N m", -1.0)])
def test_unit_and_sign_of_torques_by_inverse_dynamics(arm: Log, tmp_path: Path, unit: str, factor: float) -> None:
    target = load_target(save(tmp_path, ARM))
    found = propose([table(arm, q=arm.pos, q_des=arm.command, tau=factor * arm.torque)], target)
    torque = found.assignments["joint_torque"]
    assert torque.unit == unit
    np.testing.assert_allclose(torque.values(Field(factor * arm.torque)), arm.torque, atol=1e-9)


def test_a_joint_that_is_turned(quadruped: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, QUADRUPED))
    signs = np.tile([1.0, 1.0, -1.0], 4)
    torque = signs * quadruped.torque
    found = propose([table(quadruped, q=signs * quadruped.pos, q_des=signs * quadruped.command, tau=torque)], target)
    for role in ("joint_pos", "joint_torque"):
        assert np.sign(found.assignments[role].scale).tolist() == signs.tolist()


def test_order_of_unnamed_columns_by_torques(arm: Log, tmp_path: Path) -> None:
    """Of an arm, gravity tells: the shoulder carries more than the elbow."""
    target = load_target(save(tmp_path, ARM))
    turned = [1, 0]
    found = propose([table(arm, q=arm.pos[:, turned], q_des=arm.command[:, turned], tau=arm.torque[:, turned])], target)
    assert found.assignments["joint_pos"].targets == ("elbow_joint", "shoulder_joint")
    assert found.assignments["command"].targets == ("shoulder_servo", "elbow_servo")
    assert found.assignments["command"].columns == (1, 0)


def test_order_of_unnamed_columns_by_level_feet(quadruped: Log, tmp_path: Path) -> None:
    """A quadruped's joints in the order of its SDK put the feet on one plane, in the model's they do not."""
    target = load_target(save(tmp_path, QUADRUPED))
    assert quadruped.acc is not None
    found = propose(
        [table(quadruped, q=quadruped.pos[:, SDK], q_des=quadruped.command[:, SDK], acc=quadruped.acc)], target
    )
    assert found.assignments["joint_pos"].targets[:3] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint")
    assert not found.assignments["joint_pos"].doubtful


def test_an_order_that_nothing_tells_is_in_doubt(quadruped: Log, tmp_path: Path) -> None:
    """Numbers of columns tell no order that only a sorted one rivals; what depends on it is in doubt with it."""
    target = load_target(save(tmp_path, QUADRUPED))
    found = propose([table(quadruped, q=quadruped.pos, q_des=quadruped.command)], target)
    assert found.assignments["joint_pos"].doubtful
    assert "as likely" in " ".join(found.assignments["joint_pos"].evidence)
    parts = {"q": quadruped.pos, "dq": quadruped.vel, "q_des": quadruped.command}
    fields = {n: Field(v, (), "", tuple(f"{n}_{k}" for k in range(12))) for n, v in parts.items()}
    found = propose([recording(Stream("", "table", {"time": quadruped.time}, fields))], target)
    assert found.assignments["joint_pos"].targets == target.joints
    assert all(found.assignments[role].doubtful for role in ("joint_pos", "joint_vel", "command"))


def test_the_order_of_commands_tells_that_of_positions(tmp_path: Path) -> None:
    """Of two orders of the positions that look alike, the one with which the commands are in a known one, too."""
    target, time = load_target(save(tmp_path, QUADRUPED)), np.arange(0, 6, 0.01)
    asked = STAND + 0.15 * np.sin(np.outer(time, 2 + 0.37 * np.arange(12)))
    done = STAND + 0.15 * np.sin(np.outer(time - 0.03, 2 + 0.37 * np.arange(12)))
    isaac = [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]
    fields = {"q": done[:, SDK], "q_des": asked[:, isaac]}
    numbered = {n: Field(v, (), "", tuple(f"{n}_{k}" for k in range(12))) for n, v in fields.items()}
    found = propose([recording(Stream("", "table", {"time": time}, numbered))], target)
    place, command = found.assignments["joint_pos"], found.assignments["command"]
    assert place.targets == tuple(target.joints[k] for k in SDK)
    assert command.columns == tuple(isaac.index(k) for k in range(12))
    assert not place.doubtful
    assert not command.doubtful


def test_positions_and_velocities_by_their_slope_where_no_name_tells_them(arm: Log, tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", stamp=arm.time, x_a=arm.vel, x_b=arm.pos, q_cmd=arm.command)
    found = propose(read(tmp_path / "log.npz"), load_target(save(tmp_path, ARM)))
    place, speed = found.assignments["joint_pos"], found.assignments["joint_vel"]
    assert (place.source.member, speed.source.member) == ("x_b", "x_a")
    assert place.doubtful
    assert speed.doubtful
    assert all(e.strip() != "by" for e in place.evidence)


@pytest.mark.parametrize(
    ("facts", "rate"),
    [
        ({"config.action_hz": 50}, 50),
        ({"step_dt": 0.02, "dt": 0.005}, 50),
        ({"env_kwargs.control_freq": 20, "sim_freq": 500}, 20),
        ({"fps": 30, "rate": 25}, 25),
        ({"fps": 30, "hz": 60}, 0),
        ({"baud_rate": 9600, "learning_rate": 0.1, "fps": "x"}, 0),
    ],
)
def test_rates_that_files_declare(facts: dict[str, object], rate: float) -> None:
    assert declared_rate(facts)[0] == pytest.approx(rate)


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_order_of_a_quaternion_by_gravity(quadruped: Log, tmp_path: Path, order: str) -> None:
    target = load_target(save(tmp_path, QUADRUPED))
    assert quadruped.quat is not None
    assert quadruped.acc is not None
    columns = {"wxyz": [0, 1, 2, 3], "xyzw": [1, 2, 3, 0]}[order]
    assert quadruped.gyro is not None
    body = {"quat": quadruped.quat[:, columns], "acc": quadruped.acc / 9.81, "gyro": quadruped.gyro}
    log = table(quadruped, q=quadruped.pos, q_des=quadruped.command, **body)
    found = propose([log], target)
    quat = found.assignments["base_quat"]
    np.testing.assert_allclose(quat.values(Field(quadruped.quat[:, columns])), quadruped.quat)
    assert found.assignments["imu_acc"].unit == "g"


def test_torque_motors_without_a_command(arm: Log, tmp_path: Path) -> None:
    motors = ARM.replace("<position", "<motor").replace('kp="150" kv="8"', "").replace('kp="60" kv="2.6"', "")
    found = propose([table(arm, q=arm.pos, tau=arm.torque)], load_target(save(tmp_path, motors)))
    assert found.command_kind == "torque"
    assert found.assignments["command"].source.member == "tau"


def test_another_robots_log_is_told(arm: Log, quadruped: Log, tmp_path: Path) -> None:
    found = propose([table(arm, q=arm.pos, q_des=arm.command)], load_target(save(tmp_path, QUADRUPED)))
    assert not found.complete
    assert any("2 columns" in m and "12 joints" in m for m in found.missing)


def two(arm: Log, other: np.ndarray) -> Recording:
    names = ("shoulder_joint", "elbow_joint")
    streams = [
        Stream(
            f"/{robot}/joint_states", "sensor_msgs/msg/JointState", {"header": arm.time}, {"position": Field(q, names)}
        )
        for robot, q in (("left", arm.pos), ("right", other))
    ]
    return recording(*streams)


def test_two_robots_in_one_recording(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    with pytest.raises(GapError, match="two robots") as error:
        propose([two(arm, arm.pos[::-1])], target)
    assert "--only /left" in str(error.value.hint)
    assert (
        propose([two(arm, arm.pos[::-1])], target, only="/right").assignments["joint_pos"].source.stream[:6] == "/right"
    )
    propose([two(arm, arm.pos + 1e-4)], target)  # one robot, published twice
    with pytest.raises(GapError, match="no topic begins"):
        propose([two(arm, arm.pos)], target, only="/middle")


def test_the_velocity_command_of_a_policy_is_what_the_user_names(quadruped: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, QUADRUPED))
    given = np.stack([np.sin(quadruped.time), 0.3 * np.cos(quadruped.time), np.floor(quadruped.time)], axis=1)
    fields = {"q": Field(quadruped.pos), "q_des": Field(quadruped.command),
              "ask": Field(given[:, ::-1], ("wz", "vy", "vx"), "", ("wz", "vy", "vx"))}  # fmt: skip
    logged = recording(Stream("", "table", {"time": quadruped.time}, fields))
    found = propose([logged], target, use=["policy_command=vx,vy,wz"])
    write_case(found, target, tmp_path / "case")
    (file,) = (tmp_path / "case" / "runs").glob("*.npz")
    np.testing.assert_array_equal(np.load(file)["policy_command"], given)
    assert "policy_command" not in propose([logged], target).assignments
    with pytest.raises(GapError, match="no velocity command") as error:
        propose([logged], target, use=["policy_command=vx,vy"])
    assert error.value.found == "vx,vy: 2"


def test_what_is_missing_has_the_reason(quadruped: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, QUADRUPED))
    noise = np.random.default_rng(0).normal(size=quadruped.pos.shape)
    logged = table(quadruped, q=quadruped.pos, q_des=quadruped.command, dq=noise)

    def missing(role: str, *use: str) -> str:
        return next(m for m in propose([logged], target, use=use).missing if m.startswith(f"{role}:"))

    assert "(dq is no velocity of the joints: correlation" in missing("joint_vel")
    assert missing("joint_vel", "joint_vel=none") == "joint_vel: velocities (left out by --use joint_vel=none)"
    assert missing("imu_gyro") == "imu_gyro: angular velocity of the base"


def test_what_the_user_says_goes(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    log = table(arm, a=arm.command, b=arm.pos, dq=arm.vel)
    found = propose([log], target, use=("command=a", "joint_pos=b", "joint_vel=none"))
    assert found.complete
    assert "joint_vel" not in found.assignments
    for wrong, said in (("command=zz", "not in the recording"), ("speed=a", "cannot be read"), ("a", "cannot be read")):
        with pytest.raises(GapError, match=said):
            propose([log], target, use=(wrong,))


def test_gains_in_the_log_are_held_against_the_model(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    log = table(arm, q=arm.pos, q_des=arm.command)
    found = propose([replace(log, facts={"kp": 150.0})], target)
    assert any("kp of 1 servos" in w and "elbow" in w for w in found.warnings)


# ---------------------------------------------------------------- clocks


def stamped(header: np.ndarray, receive: np.ndarray, **more: np.ndarray) -> Recording:
    values = {"position": Field(np.zeros((len(header), 1)))}
    return recording(Stream("/s", "x/msg/Y", {"receive": receive, "header": header, **more}, values))


@given(st.floats(-1e4, 1e4), st.floats(-200, 200))
def test_offset_and_drift_of_a_clock(offset: float, ppm: float) -> None:
    rng = np.random.default_rng(3)
    true = 1e5 + np.arange(0, 120, 0.01)
    receive = true + rng.exponential(0.002, len(true))
    own = (true - 1e5) * (1 - 1e-6 * ppm) + 1e5 - offset
    time = clocked(stamped(own, receive))["/s"]
    small = abs(offset) < 0.501  # what a message takes on its way shifts the limit of 0.5 s a little
    if small and abs(ppm) < 20:  # may be one clock: stamps stay as they are
        assert np.abs(time.time - true).max() < abs(offset) + 0.004
        return
    assert np.abs(time.time - true).max() < max(2e-3, 0.52 if small else 0.0)
    if abs(ppm) > 50:
        said = " ".join(time.notes)
        assert "ppm" in said
        measured = float(said.split("drifts by ")[1].split(" ppm")[0])
        assert abs(measured - ppm) < 0.1 * abs(ppm) + 2


def test_a_clock_that_jumps_is_not_used() -> None:
    true = np.arange(0, 20, 0.01) + 1e5
    own = np.where(true < 1e5 + 8, true, true + 3.0)
    time = clocked(stamped(own, true + 0.001))["/s"]
    assert time.clock == "receive"
    assert any("jumps" in w for w in time.warnings)


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_counter_of_the_device_in_any_unit(unit: str, scale: float) -> None:
    true = np.arange(0, 20, 0.01) + 1e5
    zero = np.zeros_like(true)
    time = clocked(stamped(zero, true, tick=np.round(scale * (true - 1e5 + 7))))["/s"]
    assert time.clock == "tick"
    assert f"in {unit}" in " ".join(time.notes)
    assert np.abs(time.time - true).max() < 2e-3


def test_a_window_of_time(arm: Log, tmp_path: Path) -> None:
    np.savetxt(
        tmp_path / "a.csv", np.column_stack([arm.time, arm.pos]), delimiter=",", header="time,q0,q1", comments=""
    )
    (part,) = read(tmp_path / "a.csv", Window(1.0, 2.0))
    clock = part.streams[0].clocks["time"]
    assert clock[0] == pytest.approx(1.0, abs=0.01)
    assert clock[-1] < 3.0


# ---------------------------------------------------------------- names and cells


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("goal_position", "command.position"), ("q_des", "command.position"), ("dof_pos", "joint_pos"),
        ("observation.state", "joint_pos"), ("action", "command"), ("Present Velocity", "joint_vel"),
        ("tau_est", "joint_torque"), ("torque_cmd", "command.torque"), ("base_ang_vel", "imu_gyro"), ("temp", ""),
        ("motor_cmd.q", "command.position"), ("motor_state.q", "joint_pos"), ("motor_cmd.kp", ""),
        ("motor_cmd.mode", ""), ("state.tau", "joint_torque"),
        ("torque_enable", "enabled"), ("q_axis_current", "joint_torque"),
        ("position_error", ""), ("linear_acceleration", "imu_acc"), ("foot_contacts", "contact"), ("qpos", "joint_pos"),
    ],
)  # fmt: skip
def test_what_names_mean(name: str, role: str) -> None:
    assert meaning("", "table", name)[0] == role


@pytest.mark.parametrize(
    ("name", "unit"),
    [("time", None), ("t_ms", 1e-3), ("timestamp_us", 1e-6), ("stamp", None), ("time_ns", 1e-9), ("Time (min)", 60.0)],
)
def test_clocks_by_name(name: str, unit: float | None) -> None:
    assert is_clock(name)
    assert TIMES.get(time_unit(name)) == unit
    assert not is_clock("target")
    assert not is_clock("min")


def test_joints_by_labels() -> None:
    joints = ["FL_hip_joint", "FL_calf_joint", "joint1"]
    assert match_joints(["fl_calf", "robot/FL_hip", "joint_1"], joints) == {
        0: "FL_calf_joint", 1: "FL_hip_joint", 2: "joint1",
    }  # fmt: skip
    assert match_joints(["a", "b"], joints) == {}
    assert match_joints(["Schwenk", "tilt"], ["head_pan", "head_tilt"]) == {0: "head_pan", 1: "head_tilt"}


@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=1, max_size=8))
def test_lists_in_cells(rows: list[list[float]]) -> None:
    for text in (str, lambda r: "(" + " ".join(map(repr, r)) + ")", lambda r: "; ".join(map(repr, r)).join("[]")):
        found = cells(Path("x"), "q", [text(r) for r in rows])
        assert found is not None
        np.testing.assert_array_equal(found, np.array(rows))


# ---------------------------------------------------------------- motors that a robot does not have


def humanoid(folder: Path, joints: list[str]) -> Path:
    """A tree of short links from a fixed base, a joint each."""
    geom = '<geom size="0.02" mass="0.1"/>'
    bodies = "".join(f'<body><joint name="{j}_joint" axis="0 1 0" range="-1 1"/>{geom}</body>' for j in joints)
    servos = "".join(f'<position joint="{j}_joint" kp="20" kv="1"/>' for j in joints)
    path = folder / "humanoid.xml"
    path.write_text(
        f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}</worldbody>'
        f"<actuator>{servos}</actuator></mujoco>"
    )
    return path


SIDES, ARM_JOINTS = ("left", "right"), ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll"]
G1 = [f"{s}_{j}" for s in SIDES for j in ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")]
G1 += ["waist_yaw", *(f"{s}_{j}" for s in SIDES for j in ARM_JOINTS)]
H1 = [f"{s}_{j}" for s in SIDES for j in ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle")]
H1 += ["torso", *(f"{s}_{j}" for s in SIDES for j in ARM_JOINTS[:4])]
LEG = ("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
H1_2 = [f"{s}_{j}" for s in SIDES for j in LEG]
H1_2 += ["torso", *(f"{s}_{j}" for s in SIDES for j in (*ARM_JOINTS, "wrist_pitch", "wrist_yaw"))]
R1 = [j for j in G1 if j != "waist_yaw"] + ["waist_roll", "waist_yaw", "head_pitch", "head_yaw"]


@pytest.mark.parametrize(
    ("robot", "joints", "slots", "where"),
    [
        (
            "G1 (23)",
            G1,
            35,
            {"waist_yaw": 12, "left_shoulder_pitch": 15, "right_shoulder_pitch": 22, "right_wrist_roll": 26},
        ),
        ("H1", H1, 20, {"right_hip_roll": 0, "left_hip_yaw": 7, "left_ankle": 10, "torso": 6, "left_elbow": 19}),
        (
            "H1-2",
            H1_2,
            35,
            {"left_hip_pitch": 1, "right_hip_yaw": 6, "torso": 12, "left_wrist_yaw": 19, "right_shoulder_pitch": 20},
        ),
        (
            "R1",
            R1,
            35,
            {
                "left_hip_pitch": 0,
                "right_hip_pitch": 6,
                "left_knee": 3,
                "left_ankle_roll": 5,
                "waist_yaw": 13,
                "left_shoulder_roll": 16,
                "right_shoulder_pitch": 22,
                "head_pitch": 29,
                "head_yaw": 30,
            },
        ),
    ],
    ids=["g1", "h1", "h1-2", "r1"],
)
def test_motors_in_the_sdks_slots(
    robot: str, joints: list[str], slots: int, where: dict[str, int], tmp_path: Path
) -> None:
    """LowState has a slot for motors that the robot does not have: the rest is not moved up."""
    target = load_target(humanoid(tmp_path, joints))
    table_ = target.orders(slots)[f"the motors of Unitree {robot}"]
    assert max(table_) < slots
    used = sorted(table_)
    time = np.arange(0, 4, 0.01)
    q = np.zeros((len(time), slots))
    for k in used:
        q[:, k] = 0.4 * np.sin(time * (1 + 0.1 * k))
    state = Stream("/lowstate", "unitree_hg/msg/LowState", {"receive": time}, {"motor_state.q": Field(q)})
    sent = Stream("/lowcmd", "unitree_hg/msg/LowCmd", {"receive": time}, {"motor_cmd.q": Field(q)})
    place = propose([recording(state, sent)], target).assignments["joint_pos"]
    column = dict(zip(place.targets, place.columns, strict=True))
    assert len(column) == len(joints)
    assert {j: column[f"{j}_joint"] for j in where} == where
    assert not place.doubtful


def test_the_model_of_another_robot_is_in_doubt(quadruped: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    place = propose([table(quadruped, q=quadruped.pos, q_des=quadruped.command)], target).assignments["joint_pos"]
    assert place.doubtful
    assert any("10 more columns that move are left out" in e for e in place.evidence)


def test_feet_are_those_that_the_columns_name(quadruped: Log, tmp_path: Path) -> None:
    """In the robot's own order, which is not that of Unitree's motors."""
    target = load_target(save(tmp_path, QUADRUPED))
    stands = (np.sin(quadruped.time[:, None] * 9 + np.arange(4)) > 0).astype(float)
    for labels in (tuple(f"{n}_foot" for n in PLACES), tuple(f"foot_{n.lower()}" for n in PLACES)):
        fields = {"q": Field(quadruped.pos), "q_des": Field(quadruped.command), "contact": Field(stands, labels)}
        found = propose([recording(Stream("", "table", {"time": quadruped.time}, fields))], target)
        contact = found.assignments["contact"]
        assert contact.targets == tuple(f"{n}_calf" for n in PLACES)
        assert "its columns name them" in contact.evidence


def test_drives_that_are_off(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    on = (arm.time < 2.0).astype(float)
    found = propose([table(arm, q=arm.pos, q_des=arm.command, torque_enable=on[:, None])], target)
    arrays = run_arrays(found, found.recordings[0]).arrays
    assert arrays["enabled"].shape == arrays["command"].shape
    np.testing.assert_array_equal(arrays["enabled"][:, 0], on[-len(arrays["enabled"]) :])
    odd = propose([table(arm, q=arm.pos, q_des=arm.command, torque_enable=7 * on[:, None])], target)
    assert "enabled" not in odd.assignments
    assert any("torque_enable is not 0 and 1" in w for w in odd.warnings)


@pytest.mark.parametrize(("name", "role"), [
    ("position.left_knee", "joint_pos"), ("reference.left_knee", "command"), ("effort.left_knee", "joint_torque"),
    ("left_knee.position", "joint_pos"), ("imu_state.rpy", ""), ("motor_state.mode", ""),
])  # fmt: skip
def test_what_a_signal_is_may_stand_before_or_after_whose_it_is(name: str, role: str) -> None:
    assert meaning("", "table", name)[0] == role
