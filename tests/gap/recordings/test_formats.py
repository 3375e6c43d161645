"""One run through every format: what is read back is what was driven, in the model's order, units and signs."""

import json
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import load_case
from realsim.gap.recordings import READERS, load_target, propose, read, write_case
from tests.gap.real_logs import legs

from . import writers
from .robots import ARM, QUADRUPED, Log, drive, save

JOINTS = ["shoulder_joint", "elbow_joint"]
SDK = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
"""Motor of Unitree's SDK (FR FL RR RL) -> joint of the model (FL FR RL RR)."""


ALONE = (
    """</body></worldbody><actuator><position name="servo" joint="elbow_joint" kp="60" kv="2"/></actuator></mujoco>"""
)


def need(*packages: str) -> None:
    for name in packages:
        pytest.importorskip(name, reason=f"{name} is not installed: pip install -e '.[logs]'")


def as_mcap(folder: Path, log: Log) -> Path:
    need("mcap", "mcap_ros2", "rosbags")
    # The driver lists the joints in its own order and runs on another clock; commands have neither names nor stamps.
    messages = writers.joint_states(log, JOINTS, offset=12.5, wait=0.0, order=[1, 0]) + writers.float_commands(
        log, offset=12.5
    )
    return writers.mcap_ros2(folder / "run.mcap", sorted(messages, key=lambda m: m[3]))


def as_bag1(folder: Path, log: Log) -> Path:
    need("rosbags")
    return writers.bag(folder / "run.bag", log, JOINTS, 1)


def as_bag2(folder: Path, log: Log) -> Path:
    need("rosbags")
    return writers.bag(folder / "run", log, JOINTS, 2)


def as_lerobot(folder: Path, log: Log) -> Path:
    need("pyarrow")
    return writers.lerobot(folder / "set", [log], ["shoulder", "elbow"])


def as_parquet(folder: Path, log: Log) -> Path:
    need("pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        "timestamp_ms": 1e3 * log.time,
        "q_des": log.command.tolist(),
        "q": log.pos.tolist(),
        "dq": np.degrees(log.vel).tolist(),
        "tau": (-1e3 * log.torque).tolist(),
        "note": ["x"] * len(log.time),
    }
    pq.write_table(pa.table(columns), folder / "run.parquet")
    return folder / "run.parquet"


def as_csv(folder: Path, log: Log) -> Path:
    """Lists in cells, quoted."""
    rows = ["time,target_pos,joint_pos,joint_vel,mode"]
    for t, c, q, v in zip(log.time, log.command, log.pos, log.vel, strict=True):
        rows.append(",".join([f"{t:.4f}", *(f'"{np.array2string(x, separator=", ")}"' for x in (c, q, v)), "walk"]))
    (folder / "run.csv").write_text("\n".join(rows))
    return folder / "run.csv"


def as_wide_csv(folder: Path, log: Log) -> Path:
    """A column a joint, each named; torques in N m."""
    head = [f"{j}_{s}" for s in ("cmd", "pos", "vel", "torque") for j in ("elbow", "shoulder")]
    table = np.concatenate([a[:, ::-1] for a in (log.command, log.pos, log.vel, log.torque)], axis=1)
    lines = [f"stamp_us;{';'.join(head)}"]
    lines += [f"{1e6 * t:.0f};" + ";".join(f"{v:.8f}" for v in row) for t, row in zip(log.time, table, strict=True)]
    (folder / "run.csv").write_text("\n".join(lines))
    return folder / "run.csv"


def as_json_lines(folder: Path, log: Log) -> Path:
    rows = [
        {"t": float(t), "state": {"q": q.tolist(), "qd": v.tolist()}, "action": c.tolist()}
        for t, c, q, v in zip(log.time, log.command, log.pos, log.vel, strict=True)
    ]
    (folder / "run.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n{broken\n")
    return folder / "run.jsonl"


def as_rrd(folder: Path, log: Log) -> Path:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install -e '.[rerun]'")
    return writers.rrd(folder / "run.rrd", log, JOINTS)


def as_npz(folder: Path, log: Log) -> Path:
    np.savez(folder / "run.npz", time=log.time, joints=np.array(JOINTS), dof_pos=log.pos, des_dof_pos=log.command)
    return folder / "run.npz"


def as_torch(folder: Path, log: Log) -> Path:
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install -e '.[train]'")
    tensors = {"time": log.time, "dof_pos": log.pos, "dof_vel": log.vel, "des_dof_pos": log.command}
    torch.save({k: torch.tensor(v) for k, v in tensors.items()}, folder / "run.pt")
    return folder / "run.pt"


def as_protobuf(folder: Path, log: Log) -> Path:
    return writers.mcap_protobuf(folder / "run.mcap", log, JOINTS)


FORMATS = [
    as_mcap,
    as_protobuf,
    as_bag1,
    as_bag2,
    as_lerobot,
    as_parquet,
    as_csv,
    as_wide_csv,
    as_json_lines,
    as_npz,
    as_torch,
    as_rrd,
]


@pytest.mark.parametrize("write", FORMATS, ids=lambda f: f.__name__)
def test_what_is_read_is_what_was_driven(write: Callable[[Path, Log], Path], arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    source = write(tmp_path, arm)
    proposal = propose(read(source), target)
    write_case(proposal, target, tmp_path / "case")
    case = load_case(tmp_path / "case")
    assert case.joint_names == tuple(JOINTS)
    assert case.actuator_names == ("shoulder_servo", "elbow_servo")
    run = case.runs[0]
    # The first command may come after the first position; and clocks that differ are told apart to a millisecond.
    late = len(arm.time) - len(run.time)
    assert 0 <= late <= 3
    same = slice(late, None)
    assert np.abs(run.time - (arm.time[same] - arm.time[late])).max() < 2e-3
    np.testing.assert_allclose(run.signals["joint_pos"], arm.pos[same], atol=1e-3)
    assert np.median(np.abs(run.command - arm.command[same])) < 1e-6
    for signal, truth in (("joint_vel", arm.vel), ("joint_torque", arm.torque)):
        if signal in run.signals:
            np.testing.assert_allclose(run.signals[signal], truth[same], atol=2e-2)
    logged = {"joint_vel"} if write not in (as_lerobot, as_npz) else set()
    logged |= {"joint_torque"} if write in (as_mcap, as_protobuf, as_bag1, as_bag2, as_parquet, as_wide_csv) else set()
    assert logged == {s for s in ("joint_vel", "joint_torque") if s in run.signals}


def test_unitree_bag_without_definitions(quadruped: Log, tmp_path: Path) -> None:
    need("rosbags")
    assert quadruped.force is not None
    lifted = np.sin(2 * np.pi * (quadruped.time[:, None] + 0.25 * np.arange(4))) > 0.6
    log = replace(quadruped, force=np.where(lifted, 0.0, 20 + quadruped.force))
    target = load_target(save(tmp_path, QUADRUPED))
    source = writers.unitree(tmp_path / "bag", log, SDK)
    proposal = propose(read(source), target)
    assert "Unitree" in proposal.assignments["joint_pos"].evidence[1]
    write_case(proposal, target, tmp_path / "case")
    case = load_case(tmp_path / "case")
    run = case.runs[0]
    by_name = [case.joint_names.index(target.joints[j]) for j in range(12)]
    np.testing.assert_allclose(run.signals["joint_pos"][:, by_name], log.pos, atol=1e-6)
    np.testing.assert_allclose(run.signals["joint_torque"][:, by_name], log.torque, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(run.command, log.command, atol=1e-6)
    assert log.acc is not None
    assert log.quat is not None
    np.testing.assert_allclose(run.signals["imu_acc"], log.acc, rtol=1e-4, atol=1e-4)
    assert np.abs((run.signals["base_quat"] * log.quat).sum(axis=1)).min() > 1 - 1e-6
    assert set(case.contact_bodies) == {f"{n}_calf" for n in ("FL", "FR", "RL", "RR")}
    feet = [list(case.contact_bodies).index(f"{n}_calf") for n in ("FL", "FR", "RL", "RR")]
    assert (run.signals["contact"][:, feet] == ~lifted).all()
    assert case.imu_site == "imu"


def test_a_state_without_a_definition_is_named(quadruped: Log, tmp_path: Path) -> None:
    """Twelve LEDs in LowCmd are no twelve joints."""
    need("rosbags")
    source = writers.unitree(tmp_path / "bag", quadruped, SDK)
    with sqlite3.connect(next(source.glob("*.db3"))) as database:
        database.execute("UPDATE topics SET type = 'my_robot/msg/State' WHERE name = '/lowstate'")
    about = source / "metadata.yaml"
    about.write_text(about.read_text().replace("unitree_go/msg/LowState", "my_robot/msg/State"))
    target = load_target(save(tmp_path, QUADRUPED))
    proposal = propose(read(source), target)
    assert not proposal.assignments
    with pytest.raises(GapError, match=r"/lowcmd[\s\S]*/lowstate \(not read: my_robot/msg/State: its definition"):
        write_case(proposal, target, tmp_path / "case")


def test_feet_that_never_lift_are_no_contact(quadruped: Log, tmp_path: Path) -> None:
    need("rosbags")
    standing = replace(quadruped, force=25 + 5 * np.sin(quadruped.time[:, None] + np.arange(4)))
    target = load_target(save(tmp_path, QUADRUPED))
    proposal = propose(read(writers.unitree(tmp_path / "bag", standing, SDK)), target)
    assert "contact" not in proposal.assignments
    assert any("foot_force" in w for w in proposal.warnings)


def test_trajectory_and_controller_state(arm: Log, tmp_path: Path) -> None:
    """A trajectory of several points is its points in time; a controller's state holds command and positions."""
    need("mcap", "mcap_ros2", "rosbags")
    target = load_target(save(tmp_path, ARM))
    empty: list[float] = []
    zero = {"sec": 0, "nanosec": 0}

    def point(q: np.ndarray, v: np.ndarray | None = None, after: float = 0.0) -> dict[str, Any]:
        return {"positions": q.tolist(), "velocities": empty if v is None else v.tolist(), "accelerations": empty,
                "effort": empty, "time_from_start": writers.stamp(after) if after else zero}  # fmt: skip

    states, plans = [], []
    for i, t in enumerate(arm.time):
        now = writers.EPOCH + t
        message = {"header": writers.header(now), "joint_names": JOINTS, "reference": point(arm.command[i]),
                   "feedback": point(arm.pos[i], arm.vel[i]), "error": point(arm.command[i] - arm.pos[i])}  # fmt: skip
        states.append(
            ("/arm/state", "control_msgs/msg/JointTrajectoryControllerState", writers.CONTROLLER, now, message)
        )
        if i % 50 == 0:
            points = [point(arm.command[k], after=arm.time[k] - t) for k in range(i, min(i + 50, len(arm.time)), 5)]
            plan = {"header": writers.header(now), "joint_names": JOINTS, "points": points}
            plans.append(
                ("/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", writers.TRAJECTORY, now, plan)
            )
    both = propose(read(writers.mcap_ros2(tmp_path / "state.mcap", states)), target)
    assert both.assignments["command"].source.member == "reference.positions"
    assert both.assignments["joint_pos"].source.member == "feedback.positions"

    messages = sorted(writers.joint_states(arm, JOINTS) + plans, key=lambda m: m[3])
    planned = propose(read(writers.mcap_ros2(tmp_path / "plan.mcap", messages)), target)
    write_case(planned, target, tmp_path / "case")
    run = load_case(tmp_path / "case").runs[0]
    asked = np.stack([np.interp(run.time, arm.time, arm.command[:, k]) for k in range(2)], axis=1)
    assert np.abs(run.command - asked)[:-20].max() < 0.02


def test_ulog_of_an_imu(quadruped: Log, tmp_path: Path) -> None:
    need("pyulog")
    log = quadruped
    assert log.acc is not None
    assert log.gyro is not None
    columns = {f"accelerometer_m_s2[{i}]": log.acc[:, i] for i in range(3)}
    columns |= {f"gyro_rad[{i}]": log.gyro[:, i] for i in range(3)}
    source = writers.ulog(tmp_path / "flight.ulg", log.time + 1.0, "sensor_combined", columns)
    proposal = propose(read(source))
    assert proposal.assignments["imu_acc"].unit == "m/s^2"
    assert set(proposal.assignments) == {"imu_acc", "imu_gyro"}
    stream = proposal.recordings[0].streams[0]
    np.testing.assert_allclose(stream.fields["accelerometer_m_s2"].values, log.acc, rtol=1e-5, atol=1e-5)
    assert not proposal.complete


def test_rerun_with_pictures_a_cloud_and_a_pose(arm: Log, tmp_path: Path) -> None:
    (run,) = read(as_rrd(tmp_path, arm))
    fields = {n: f for s in run.streams for n, f in s.fields.items()}
    np.testing.assert_allclose(fields["base.translation"].values[:, 0], arm.time, atol=1e-4)
    assert fields["base.quaternion"].values[0].tolist() == [0, 0, 0, 1]
    assert fields["joints/position"].labels == tuple(JOINTS)
    assert {"camera.buffer", "cloud.positions"} <= set(run.skipped)
    (tmp_path / "cut.rrd").write_bytes((tmp_path / "run.rrd").read_bytes()[:5000])
    with pytest.raises(GapError, match=r"not a readable .rrd"):
        read(tmp_path / "cut.rrd")


def test_json_lines_with_a_list_of_motors(quadruped: Log, tmp_path: Path) -> None:
    """LowState and LowCmd as their own program writes them, line by line: a topic each, motors as objects."""
    log, lines = quadruped, []
    for i, t in enumerate(log.time):
        state = [{"q": log.pos[i, j], "dq": log.vel[i, j], "name": "m"} for j in SDK]
        lines.append({"topic": "lowstate", "time": t, "motor_state": state})
        lines.append({"topic": "lowcmd", "time": t, "motor_cmd": [{"q": log.command[i, j], "kp": 40} for j in SDK]})
    path = tmp_path / "run.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    proposal = propose(read(path), load_target(save(tmp_path, QUADRUPED)))
    assert proposal.assignments["command"].source.label == "lowcmd:motor_cmd.q"
    place = proposal.assignments["joint_pos"]
    assert place.source.label == "lowstate:motor_state.q"
    np.testing.assert_array_equal(proposal.recordings[0].streams[0].fields["motor_state.q"].values, log.pos[:, SDK])


def test_json_of_a_servo_bench(arm: Log, tmp_path: Path) -> None:
    """An object with facts and its samples under `entries`, as bench logs of hobby servos are published."""
    entries = [
        {"timestamp": float(t), "goal_position": float(c[1]), "position": float(q[1]), "torque_enable": True}
        for t, c, q in zip(arm.time, arm.command, arm.pos, strict=True)
    ]
    path = tmp_path / "servo.json"
    path.write_text(json.dumps({"mass": 1.1, "kp": 32, "motor": "x", "entries": entries}))
    (recording,) = read(path)
    assert recording.facts["kp"] == 32
    proposal = propose([recording])
    assert proposal.assignments["command"].source.member == "goal_position"
    assert proposal.assignments["joint_pos"].source.member == "position"


def test_json_of_rollouts_is_runs_at_the_rate_of_its_settings(arm: Log, tmp_path: Path) -> None:
    lengths = (900, 700, 800)
    data = [
        {"type": "x", "actions": arm.command[:n, 1].tolist(), "sensor_data": arm.pos[:n, 1].tolist()} for n in lengths
    ]
    (tmp_path / "data.json").write_text(json.dumps({"config": {"action_hz": 50}, "data": data}))
    found = propose(read(tmp_path / "data.json"))
    assert [r.streams[0].count for r in found.recordings] == list(lengths)
    assert "50 samples per second" in found.clocks[0]
    alone = ARM.replace("shoulder_joint", "elbow_joint").split('<body name="fore"')[0]
    found = propose(read(tmp_path / "data.json"), load_target(save(tmp_path, alone + ALONE)))
    assert found.assignments["command"].source.member == "actions"
    assert found.assignments["joint_pos"].source.member == "sensor_data"  # it follows the actions
    assert found.assignments["joint_pos"].doubtful
    rows = [{"q": [0.1] * 29, "dq": [k / 10] * 29, "t": k} for k in range(60)]  # joints are no samples
    (tmp_path / "rows.json").write_text(json.dumps(rows))
    assert [r.streams[0].count for r in read(tmp_path / "rows.json")] == [60]


def test_measured_and_desired_halves_are_one_run(arm: Log, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    head = "time,position,velocity,torque"
    one = [arm.time, arm.pos[:, 1], arm.vel[:, 1], arm.torque[:, 1]]
    asked = [arm.time, arm.command[:, 1], 0 * arm.time, 0 * arm.time]
    for name, columns in (("data_measured", one), ("data_desired", asked)):
        np.savetxt(folder / f"{name}.csv", np.stack(columns, axis=1), delimiter=",", header=head, comments="")
    proposal = propose(read(folder))
    assert len(proposal.recordings) == 1
    assert proposal.assignments["command"].source.stream == "target"
    assert proposal.assignments["joint_pos"].source.stream == "measured"
    for name in ("measured", "desired"):
        lines = (folder / f"data_{name}.csv").read_text().splitlines(keepends=True)
        (folder / f"again_{name}.csv").write_text("".join(lines[:700]))
    alone = ARM.replace("shoulder_joint", "elbow_joint").split('<body name="fore"')[0]
    target = load_target(save(tmp_path, alone + ALONE))
    write_case(propose(read(folder), target), target, tmp_path / "case")
    assert [r.name for r in load_case(tmp_path / "case").runs] == ["again", "data"]


def test_real_logs_as_they_are(shared: Callable[[str], Path], tmp_path: Path) -> None:
    """Logs of real robots, in the layouts of their authors: the quadruped's arrays name their joints."""
    logs = shared("real_logs")
    model = legs(logs, tmp_path / "ready") / "model.xml"
    proposal = propose(read(logs / "iit_go2" / "traj_0.npz"), load_target(model))
    assert proposal.assignments["joint_pos"].targets[0] == "FL_hip_joint"
    assert not proposal.assignments["joint_pos"].doubtful
    assert any("correlation 0.99" in e for e in proposal.assignments["command"].evidence)
    servo = propose(read(logs / "bam_sts3250"))
    assert servo.assignments["command"].source.member == "goal_position"
    assert "enabled" in servo.assignments  # torque is off while it drops, where it need not follow
    assert not any("hardly follow" in w for w in servo.warnings), servo.warnings


def test_every_reader_is_one_of_a_kind() -> None:
    assert [READERS[n].name for n in READERS] == list(READERS)


def test_a_dataset_of_several_episodes_is_several_runs(arm: Log, tmp_path: Path) -> None:
    need("pyarrow")
    source = writers.lerobot(tmp_path / "set", [arm, drive(ARM, seed=1)], ["shoulder", "elbow"])
    recordings = read(source)
    assert [r.name for r in recordings] == ["episode_000000", "episode_000001"]
    assert recordings[0].facts["robot_type"] == "so101_follower"
    assert "observation.images.front" in recordings[0].skipped
