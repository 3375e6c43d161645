"""Tables as other programs write them: PlotJuggler, rostopic, MATLAB, pandas, TwinCAT, InfluxDB, RTDE, Isaac Lab."""

import json
from pathlib import Path

import numpy as np
import pytest

from realsim.gap.recordings import load_target, propose, read
from realsim.gap.recordings.arrays import run_arrays

from .robots import ARM, Log, save
from .test_door import DEG, JOINTS, check, write

TORQUES = "torque_1,torque_2"
TABLES = {
    "rostopic echo -p": "%time,field.header.stamp,field.joint_names0,field.joint_names1,field.desired.positions0,"
    "field.desired.positions1,field.actual.positions0,field.actual.positions1",
    "pandas, two levels": ",q,q,q_des,q_des\n,elbow,shoulder,elbow,shoulder\nt,,,,",
    "a trace with strange units": "# KRC4 trace\n# sample 5 ms\nZeit,Sollposition_A1,Sollposition_A2,Istposition_A1,"
    "Istposition_A2,Motortemp_A1,Motortemp_A2\ns,Grad,Grad,Grad,Grad,K,K",
    "RTDE": "timestamp,actual_TCP_pose_0,actual_TCP_pose_1,actual_q_0,actual_q_1,joint_control_output_0,"
    "joint_control_output_1,target_q_0,target_q_1,actual_current_0,actual_current_1",
    "moteus": "timestamp,d_current_1,d_current_2,q_current_1,q_current_2,position_1,position_2,velocity_1,velocity_2,"
    "control_position_1,control_position_2",
    "Simulation Data Inspector": "time,q_ref(1),q_ref(2),q_meas(1),q_meas(2)\n,Type: double,Type: double,Type: double,"
    "Type: double\n,Unit: deg,Unit: deg,Unit: deg,Unit: deg\n,Interp: zoh,Interp: zoh,Interp: linear,Interp: linear",
    "Grafana": "Time,"
    + ",".join(
        f'"arm.{kind} {{joint=""{joint}"", robot=""arm-7""}}"'
        for kind in ("setpoint", "position")
        for joint in ("elbow", "shoulder")
    ),
    "Shift JIS": "時刻[ms],目標角度_肩[deg],目標角度_肘[deg],実角度_肩[deg],実角度_肘[deg]",
}  # fmt: skip


@pytest.mark.parametrize("program", TABLES)
def test_a_table_of_another_program(program: str, arm: Log, tmp_path: Path) -> None:
    turned, wave = slice(None, None, -1), np.cumsum(arm.torque, axis=0)
    columns = {
        "rostopic echo -p": (1e9 * arm.time, 1e9 * arm.time, arm.command[:, turned], arm.pos[:, turned]),
        "pandas, two levels": (arm.time, arm.pos[:, turned], arm.command[:, turned]),
        "a trace with strange units": (arm.time, DEG * arm.command, DEG * arm.pos, 300 + 0 * arm.pos),
        "RTDE": (arm.time, 1e-3 * wave, arm.pos, arm.torque, arm.command, arm.torque),
        "moteus": (arm.time, 0 * arm.torque, 0.1 * arm.torque, arm.pos, arm.vel, arm.command),
        "Simulation Data Inspector": (arm.time, DEG * arm.command, DEG * arm.pos),
        "Grafana": (arm.time, arm.command[:, turned], arm.pos[:, turned]),
        "Shift JIS": (1e3 * arm.time, DEG * arm.command, DEG * arm.pos),
    }[program]
    path = write(tmp_path / "a.csv", TABLES[program], *columns)
    text = path.read_text("utf-8")
    if program.startswith("rostopic"):
        first, *rows = text.splitlines()
        cells = [row.split(",", 2) for row in rows]
        text = "\n".join([first, *(f"{t},{s},elbow_joint,shoulder_joint,{rest}" for t, s, rest in cells)])
    path.write_bytes(text.encode("cp932" if program == "Shift JIS" else "utf-8"))
    check(path, tmp_path, arm)


def test_topics_in_the_rows_of_one_table(arm: Log, tmp_path: Path) -> None:
    """PlotJuggler's export: a row a message, the other topics' cells empty; joints with numbers in their names."""
    model = ARM.replace("shoulder_joint", "wrist_1_joint").replace("elbow_joint", "wrist_2_joint")
    grip = '<body name="hand"><joint name="grip_joint" axis="1 0 0" damping="1"/><geom size="0.01"/></body>'
    model = model.replace('<body name="fore"', grip + '<body name="fore"')
    model = model.replace("</actuator>", '<position name="grip_servo" joint="grip_joint" kp="5"/></actuator>')
    order = ("grip_joint", "wrist_1_joint", "wrist_2_joint")
    held = 0.3 * np.sin(5 * arm.time)
    pos, sent = np.column_stack([held, arm.pos]), np.column_stack([arm.command, held])
    head = ["__time", *(f"/joint_states/{j}/position" for j in order), *(f"/arm/commands/data[{k}]" for k in range(3))]
    rows = [(t + 0.001, [f"{x:.6f}" for x in q] + [""] * 3) for t, q in zip(arm.time, pos, strict=True)]
    rows += [(t, [""] * 3 + [f"{x:.6f}" for x in u]) for t, u in zip(arm.time, sent, strict=True)]
    lines = [",".join([f"{t + 1.7e9:.6f}", *cells]) for t, cells in sorted(rows)]
    (tmp_path / "a.csv").write_text("\n".join([",".join(head), *lines]))
    found = propose(read(tmp_path / "a.csv"), load_target(save(tmp_path, model)))
    assert {"wrist_1_joint", "wrist_2_joint", "grip_joint"} == set(found.joints), found.render()
    arrays = run_arrays(found, found.recordings[0]).arrays
    for name, k in (("wrist_1_joint", 0), ("wrist_2_joint", 1)):
        got = arrays["joint_pos"][:, found.joints.index(name)]
        assert np.nanmax(np.abs(got - np.interp(arrays["time"], arm.time - 0.001, arm.pos[:, k]))) < 5e-3
    got = dict(zip(found.assignments["command"].targets, arrays["command"].T, strict=True))
    whole = np.interp(arrays["time"], arm.time - 0.001, arm.command[:, 1])
    assert np.corrcoef(got["elbow_servo"], whole)[0, 1] > 0.99


def test_times_with_their_unit_in_each_cell(arm: Log, tmp_path: Path) -> None:
    """MATLAB's writetimetable."""
    body = np.hstack([arm.command, arm.pos])
    rows = [f"{t:g} sec," + ",".join(f"{x:.6f}" for x in values) for t, values in zip(arm.time, body, strict=True)]
    head = "Time,target_shoulder,target_elbow,angle_shoulder,angle_elbow"
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]))
    check(tmp_path / "a.csv", tmp_path, arm)


def test_a_clock_for_each_channel(arm: Log, tmp_path: Path) -> None:
    """TwinCAT's Scope: lines about the file, lines about the channels, then pairs of time and value."""
    names = ["Schulter.SetPos", "Ellbogen.SetPos", "Schulter.ActPos", "Ellbogen.ActPos"]
    about = [
        ("Name", ["SetPos", "SetPos (2)", "ActPos", "ActPos (2)"]),
        ("SampleTime[ms]", ["5"] * 4),
        ("Symbol", names),
    ]
    head = [
        "Name;arm",
        "Starttime of export;1339643869971;Montag;10:00:00.000",
        "Endtime;1339643869971;Montag;10:00:09.000",
    ]
    head += ["", *(";".join(f"{key};{value}" for value in values) for key, values in about), ""]
    body = np.hstack([arm.command, arm.pos])
    rows = [
        ";".join(f"{1e3 * t:.0f};{x:.6f}" for x in values).replace(".", ",")
        for t, values in zip(arm.time, body, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join([*head, *rows, "EOF"]))
    check(tmp_path / "a.csv", tmp_path, arm)


def test_a_row_a_value(arm: Log, tmp_path: Path) -> None:
    """InfluxDB's annotated CSV: a table a series, each under its own header."""
    lines = []
    for field, values in (("position_setpoint", arm.command), ("position_actual", arm.pos)):
        for k, joint in enumerate(JOINTS):
            lines += [
                "#group,false,false,false,false,true,true",
                "#default,_result,,,,,",
                ",result,table,_time,_value,_field,joint",
            ]
            lines += [
                f",,{k},2026-01-01T00:00:{t:09.6f}Z,{x:.6f},{field},{joint}"
                for t, x in zip(arm.time, values[:, k], strict=True)
            ]
    (tmp_path / "a.csv").write_text("\r\n".join(lines))
    check(tmp_path / "a.csv", tmp_path, arm)


def test_robots_side_by_side_are_runs(arm: Log, tmp_path: Path) -> None:
    """Arrays (T, robots, K) of a vectorised simulator, whose only clock is its step."""
    both = {"joint_pos": arm.pos, "joint_pos_target": arm.command}
    worlds = {n: np.stack([v, v[::-1]], axis=1) for n, v in both.items()}
    np.savez(tmp_path / "a.npz", **worlds, joint_names=np.array(JOINTS), step_dt=arm.time[1] - arm.time[0])
    assert len(read(tmp_path / "a.npz")) == 2
    found = propose(read(tmp_path / "a.npz"), load_target(save(tmp_path, ARM)))
    np.testing.assert_allclose(run_arrays(found, found.recordings[0]).arrays["joint_pos"], arm.pos, atol=1e-6)


def test_robots_that_are_left_out_are_counted(arm: Log, tmp_path: Path) -> None:
    many = {n: np.stack([v] * 40, axis=1) for n, v in {"joint_pos": arm.pos, "joint_pos_target": arm.command}.items()}
    np.savez(tmp_path / "a.npz", **many, joint_names=np.array(JOINTS), step_dt=0.01)
    found = read(tmp_path / "a.npz")
    assert len(found) == 12
    assert found[0].notes == ("a.npz: 12 of its 40 robots were read",)


def test_several_signals_of_each_joint_in_one_vector(arm: Log, tmp_path: Path) -> None:
    """LeRobot's robots with velocities and torques: knee.pos, knee.vel, knee.torque, ..."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    for place in ("meta", "data"):
        (tmp_path / "set" / place).mkdir(parents=True)
    model = ARM.replace("shoulder_joint", "joint_1").replace("elbow_joint", "joint_2")
    state = np.stack([DEG * arm.pos, DEG * arm.vel, arm.torque], axis=2).reshape(len(arm.time), -1)
    rows = {"observation.state": state.tolist(), "action": (DEG * arm.command).tolist(), "timestamp": arm.time}
    pq.write_table(pa.table(rows | {"episode_index": np.zeros(len(state), int)}), tmp_path / "set/data/a.parquet")
    kinds = {"observation.state": ("pos", "vel", "torque"), "action": ("pos",)}
    features = {
        n: {"dtype": "float32", "names": [f"joint_{j}.{k}" for j in (1, 2) for k in of]} for n, of in kinds.items()
    }
    (tmp_path / "set/meta/info.json").write_text(json.dumps({"features": features}))
    found = propose(read(tmp_path / "set"), load_target(save(tmp_path, model)))
    arrays = run_arrays(found, found.recordings[0]).arrays
    for role, truth in (("joint_pos", arm.pos), ("joint_vel", arm.vel), ("joint_torque", arm.torque)):
        # Degrees below 100 without a unit may be LeRobot's -100 to 100 of the range.
        assert found.assignments[role].doubtful == (role == "joint_pos"), found.render()
        np.testing.assert_allclose(arrays[role], truth, rtol=1e-4, atol=1e-4)


def test_small_motion_is_not_taken_for_turns(arm: Log, tmp_path: Path) -> None:
    """Both are within the ranges, and turns fill more of them: rad, in doubt."""
    path = write(tmp_path / "a.csv", "t,q1,q2,q1_cmd,q2_cmd", arm.time, 0.2 * arm.pos, 0.2 * arm.command)
    found = propose(read(path), load_target(save(tmp_path, ARM))).assignments["joint_pos"]
    assert found.unit == "rad"
    assert found.doubtful


def test_what_a_controller_puts_out_is_not_measured(arm: Log, tmp_path: Path) -> None:
    """And joints with names go before the same ones without: the controller's order is its own."""
    members = ("reference/positions", "feedback/positions", "output/effort")
    head = ["__time", *(f"/arm/controller_state/{m}[{k}]" for m in members for k in (0, 1))]
    head += [f"/joint_states/{j}/{kind}" for kind in ("position", "effort") for j in JOINTS]
    turned = slice(None, None, -1)
    own = np.hstack([arm.command[:, turned], arm.pos[:, turned], arm.torque[:, turned]])
    rows = [f"{t:.4f}," + ",".join(f"{x:.6f}" for x in v) + 4 * "," for t, v in zip(arm.time, own, strict=True)]
    seen = np.hstack([arm.pos, 0.9 * arm.torque])
    rows += [f"{t:.4f}" + 7 * "," + ",".join(f"{x:.6f}" for x in v) for t, v in zip(arm.time, seen, strict=True)]
    rows.sort(key=lambda row: float(row.split(",")[0]))
    (tmp_path / "a.csv").write_text("\n".join([",".join(head), *rows]))
    found = propose(read(tmp_path / "a.csv"), load_target(save(tmp_path, ARM)))
    arrays = run_arrays(found, found.recordings[0]).arrays
    assert found.joints == JOINTS
    assert np.allclose(arrays["joint_pos"], arm.pos, atol=1e-5), found.render()
    assert np.allclose(arrays["joint_torque"], 0.9 * arm.torque, atol=1e-5), found.render()


def test_lines_of_a_serial_port(arm: Log, tmp_path: Path) -> None:
    """Names beside their numbers, and what the board says in between."""
    body = np.hstack([arm.command, arm.pos])
    names = [f"{kind}_{joint}" for kind in ("goal", "angle") for joint in ("shoulder", "elbow")]
    lines = [
        f"t:{1e3 * t:.0f} " + " ".join(f"{n}:{x:.5f}" for n, x in zip(names, values, strict=True))
        for t, values in zip(arm.time, body, strict=True)
    ]
    (tmp_path / "a.log").write_text(
        "\n".join(["Booting v1.3", "IMU ok: 1", *lines[:90], "WARN loop 4 ms", *lines[90:]])
    )
    assert "3 lines" in read(tmp_path / "a.log")[0].notes[0]
    check(tmp_path / "a.log", tmp_path, arm)


def test_the_letter_d_of_what_is_desired(arm: Log, tmp_path: Path) -> None:
    """libfranka's names."""
    head = "Time,q_1,q_2,dq_1,dq_2,tau_J_1,tau_J_2,q_d_1,q_d_2"
    path = write(tmp_path / "a.csv", head, arm.time, arm.pos, arm.vel, arm.torque, arm.command)
    found = propose(read(path), load_target(save(tmp_path, ARM)))
    assert found.assignments["command"].source.member == "q_d", found.render()
    assert not found.assignments["command"].doubtful


def test_numbers_of_a_serial_port(arm: Log, tmp_path: Path) -> None:
    """Stamped by Arduino's monitor, with what the board says in between, and a line that was cut."""
    body = np.hstack([arm.command, arm.pos])
    stamps = [f"10:00:{2 + t:06.3f} -> " for t in arm.time]
    rows = [s + "\t".join(f"{x:.5f}" for x in v) for s, v in zip(stamps, body, strict=True)]
    rows[150:150] = ["10:00:02.749 -> WARN loop 4 ms", "10:00:02.749 -> 0.1\t0.2"]
    (tmp_path / "a.txt").write_text("\n".join(["10:00:01.000 -> Booting v1.3", "10:00:01.100 -> 3, 0.2", *rows]))
    (run,) = read(tmp_path / "a.txt")
    assert "2 rows" in " ".join(run.notes)
    found = propose([run], load_target(save(tmp_path, ARM)))
    assert found.assignments["joint_pos"].doubtful, found.render()
    np.testing.assert_allclose(run_arrays(found, found.recordings[0]).arrays["joint_pos"], arm.pos, atol=1e-4)


def test_slides_in_mm_and_channels_that_share_a_clock(arm: Log, tmp_path: Path) -> None:
    """TwinCAT's Scope: a clock for each rate, and names that are the end of the joints' names."""
    model = ARM.replace("shoulder_joint", "gantry_x").replace("elbow_joint", "gantry_y")
    model = model.replace("<joint ", '<joint type="slide" ')
    names = ["X_ActPos", "Y_ActPos", "X_SetPos", "Y_SetPos"]
    head = ["Name\tgantry", "", "\t".join(["Name", *names, "Name", "X_Load"])]
    for key, value in (("SampleTime[ms]", "5"), ("Bits", "8"), ("Symbol", "a"), ("Unit", "mm (Length)")):
        head.append("\t".join([key, *[value] * 4, key, value]))
    rows = []
    for k, (t, q, u) in enumerate(zip(arm.time, 1e3 * arm.pos, 1e3 * arm.command, strict=True)):
        slow = f"{16 * k}\t{k % 7}" if 4 * k < len(arm.time) else "\t"
        rows.append(f"{1e3 * t:.0f}\t" + "\t".join(f"{x:.4f}" for x in (*q, *u)) + f"\t{slow}")
    (tmp_path / "a.csv").write_text("\n".join([*head, "", *rows, "EOF"]))
    found = propose(read(tmp_path / "a.csv"), load_target(save(tmp_path, model)))
    arrays = run_arrays(found, found.recordings[0]).arrays
    for role, truth in (("joint_pos", arm.pos), ("command", arm.command)):
        assert not found.assignments[role].doubtful, found.render()
        np.testing.assert_allclose(arrays[role][:-1], truth[:-1], atol=1e-6)


def test_signals_of_a_scope(arm: Log, tmp_path: Path) -> None:
    """Simulink's structure with time, of several signals."""
    from scipy.io import savemat

    signals = np.zeros(2, dtype=[("values", "O"), ("dimensions", "O"), ("label", "O")])
    for k, (label, values) in enumerate((("Sollwert", arm.command), ("q", arm.pos))):
        signals[k] = values, 2.0, label
    savemat(tmp_path / "a.mat", {"ScopeData": {"time": arm.time[:, None], "signals": signals}})
    found = propose(read(tmp_path / "a.mat"), load_target(save(tmp_path, ARM)))
    arrays = run_arrays(found, found.recordings[0]).arrays
    for role, truth in (("joint_pos", arm.pos), ("command", arm.command)):
        np.testing.assert_allclose(arrays[role], truth, atol=1e-6)


def test_a_matrix_whose_first_row_is_the_time(arm: Log, tmp_path: Path) -> None:
    """Simulink's To File: no names, so all is in doubt."""
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"ans": np.hstack([arm.time[:, None] + 0.5, arm.command, arm.pos, arm.vel]).T})
    found = propose(read(tmp_path / "a.mat"), load_target(save(tmp_path, ARM)))
    assert found.assignments["joint_pos"].source.member == "ans[3],ans[4]", found.render()
    assert all(found.assignments[role].doubtful for role in ("joint_pos", "command"))
    np.testing.assert_allclose(run_arrays(found, found.recordings[0]).arrays["joint_pos"], arm.pos)


def test_joints_as_structures_with_names(arm: Log, tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def row(values: np.ndarray, turn: int) -> dict[str, list[dict[str, object]]]:
        return {"joints": [{"name": j, "pos": float(x)} for j, x in zip(JOINTS, values, strict=True)][::turn]}

    both = zip(arm.time, arm.pos, arm.command, strict=True)
    rows = [{"t": t, "state": row(q, -1), "target": row(u, 1)} for t, q, u in both]
    pq.write_table(pa.Table.from_pylist(rows), tmp_path / "a.parquet")
    check(tmp_path / "a.parquet", tmp_path, arm)
