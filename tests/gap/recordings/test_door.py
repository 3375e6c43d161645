"""Tables as strangers write them: clocks, languages, units, orders, files; each with its right value."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from realsim.core.errors import GapError
from realsim.core.recognise import TAKES, explain
from realsim.gap import load_case
from realsim.gap.recordings import load_target, propose, read, write_case
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.vocabulary import english, split_unit

from . import writers
from .robots import ARM, Log, drive, save

DEG = 180 / np.pi
JOINTS = ("shoulder_joint", "elbow_joint")


def write(path: Path, header: str, *columns: np.ndarray, delimiter: str = ",", fmt: str = "%.9g") -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=delimiter, header=header, comments="", fmt=fmt)
    return path


def check(source: Path, folder: Path, log: Log, use: tuple[str, ...] = ()) -> None:
    """Commands and positions of the case are the robot's, joint by joint, in rad."""
    found = propose(read(source), load_target(save(folder, ARM)), use=use)
    assert found.complete, found.render()
    arrays = run_arrays(found, found.recordings[0]).arrays
    at = [JOINTS.index(j) for j in found.joints]
    drives = [["shoulder_servo", "elbow_servo"].index(a) for a in found.assignments["command"].targets]
    position = np.interp(arrays["time"], log.time - log.time[0], log.pos[:, at[0]])
    np.testing.assert_allclose(arrays["joint_pos"][:, 0], position, atol=2e-3)
    for k, j in enumerate(drives):
        assert np.corrcoef(arrays["command"][:, k], log.command[-len(arrays["command"]) :, j])[0, 1] > 0.999
    assert not found.assignments["command"].doubtful, found.render()
    assert not found.assignments["joint_pos"].doubtful, found.render()


CLOCKS = {
    "millis": 1e3, "micros": 1e6, "seconds": 1, "TimeStamp": 1, "header.stamp": 1, "rosbagTimestamp": 1e9,
    "sim_time": 1, "unix_time": 1, "uptime_ms": 1e3, "elapsed_time": 1, "Zeit [ms]": 1e3, "temps_ecoule": 1,
    "Tiempo (s)": 1, "x-axis": 1, "时间": 1, "%time": 1e9, "T/ms": 1e3, "loop": 1, "ZEIT": 1e6,
    "/joint_states/header/stamp": 1,
}  # fmt: skip


@pytest.mark.parametrize("name", CLOCKS)
def test_a_clock_by_its_values(name: str, arm: Log, tmp_path: Path) -> None:
    late = np.random.default_rng(0).uniform(0, 2e-4, len(arm.time))
    clock = CLOCKS[name] * (arm.time + late + 12.0)
    check(write(tmp_path / "a.csv", f"{name},q1,q2,qd1,qd2,cmd1,cmd2", clock, arm.pos, arm.vel, arm.command,
                fmt="%.12g"), tmp_path, arm)  # fmt: skip


HEADERS = {
    "german": "Ellbogen_soll [deg],Schulter_soll [deg],Ellbogen_ist [deg],Schulter_ist [deg]",
    "french": "coude consigne (deg),épaule consigne (deg),coude mesure (deg),épaule mesure (deg)",
    "spanish": "Codo deseado [deg],Hombro deseado [deg],Codo actual [deg],Hombro actual [deg]",
    "compounds": "Ellbogen_Sollwinkel [°],Schulter_Sollwinkel [°],Ellbogen_Istwinkel [°],Schulter_Istwinkel [°]",
    "english": "elbow_ref_deg,shoulder_ref_deg,elbow_act_deg,shoulder_act_deg",
    "camel": "elbowTargetDeg,shoulderTargetDeg,elbowActualDeg,shoulderActualDeg",
    "spaced": "Elbow Goal Position (deg),Shoulder Goal Position (deg),Elbow Present Position (deg),"
    "Shoulder Present Position (deg)",
    "chinese": "肘目标角度 [deg],肩目标角度 [deg],肘实际角度 [deg],肩实际角度 [deg]",
}


@pytest.mark.parametrize("language", HEADERS)
def test_set_and_actual_columns_in_any_language(language: str, arm: Log, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", f"t,{HEADERS[language]}", arm.time, DEG * arm.command[:, ::-1],
                 DEG * arm.pos[:, ::-1])  # fmt: skip
    check(path, tmp_path, arm)


def test_single_columns_by_name(arm: Log, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,A [deg],B [deg],C [deg],D [deg]", arm.time, DEG * arm.command[:, ::-1],
                 DEG * arm.pos[:, ::-1])  # fmt: skip
    check(path, tmp_path, arm, ("joint_pos=D [deg],C [deg]", "command=B [deg],A [deg]"))
    with pytest.raises(GapError, match="which is not in the recording"):
        propose(read(path), use=["joint_pos=D [deg],E [deg]"])


def test_commands_in_another_order_by_all_runs(tmp_path: Path) -> None:
    """ROS 2's usual set-up; whichever run comes first, and also where one run alone would not tell."""
    target = load_target(save(tmp_path, ARM))
    for order in ((0, 1, 2), (2, 1, 0)):
        folder = tmp_path / f"bags{order[0]}"
        folder.mkdir()
        for place, seed in enumerate(order):
            log = drive(ARM, seed=seed)
            joined = writers.joint_states(log, list(JOINTS)) + writers.float_commands(
                replace(log, command=log.command[:, ::-1])
            )
            writers.mcap_ros2(folder / f"run_{place}.mcap", sorted(joined, key=lambda m: m[3]))
        command = propose(read(folder), target).assignments["command"]
        assert command.columns == (1, 0)
        assert not command.doubtful


def test_a_commanded_torque_is_no_measurement(arm: Log, tmp_path: Path) -> None:
    wrong = 3 * arm.torque + 1
    path = write(tmp_path / "a.csv", "time,pos_meas1,pos_meas2,pos_filt1,pos_filt2,tau_con1,tau_con2,tau_fric1,"
                 "tau_fric2,tau_meas1,tau_meas2,q_ref1,q_ref2", arm.time, arm.pos, 0.9 * arm.pos, wrong, wrong,
                 arm.torque, arm.command)  # fmt: skip
    found = propose(read(path), load_target(save(tmp_path, ARM)))
    assert {r: a.source.member for r, a in found.assignments.items()} == {
        "joint_pos": "pos_meas", "joint_torque": "tau_meas", "command": "q_ref",
    }  # fmt: skip


@pytest.mark.parametrize("names", [("control", "state_motor"), ("run1_cmd", "run1_fb"), ("Sollwerte", "Istwerte")])
def test_commands_and_states_in_files_of_their_own(names: tuple[str, str], arm: Log, tmp_path: Path) -> None:
    folder = tmp_path / "log"
    folder.mkdir()
    write(folder / f"{names[0]}.csv", "timestamp,positions_1,positions_2", 1e6 * arm.time, arm.command)
    write(folder / f"{names[1]}.csv", "timestamp,positions_1,positions_2,velocities_1,velocities_2", 1e6 * arm.time,
          arm.pos, arm.vel)  # fmt: skip
    check(folder, tmp_path, arm)


def test_tables_of_other_programs(arm: Log, tmp_path: Path) -> None:
    """Decimal commas, lines before the header, a line of units, blanks, other encodings, times of day, split stamps."""
    head, body = "Zeit;Schulter_soll;Ellbogen_soll;Schulter_ist;Ellbogen_ist", (arm.time, arm.command, arm.pos)
    path = write(tmp_path / "comma.csv", head, *body, delimiter=";")
    path.write_text(path.read_text().replace(".", ","))
    check(path, tmp_path, arm)
    path = write(tmp_path / "units.csv", f"Prüfstand 3\n\n{head}\ns;deg;deg;deg;deg", arm.time, DEG * arm.command,
                 DEG * arm.pos, delimiter=";")  # fmt: skip
    path.write_bytes(path.read_text().encode("cp1252"))
    check(path, tmp_path, arm)
    path = write(tmp_path / "blank.txt", "# time q1_des q2_des q1 q2", *body, delimiter=" ")
    check(path, tmp_path, arm)
    sec = np.floor(arm.time) + 1.7e9
    path = write(tmp_path / "split.csv", "stamp.sec,stamp.nanosec,des1,des2,q1,q2", sec,
                 np.round(1e9 * (arm.time % 1)), arm.command, arm.pos, fmt="%.12g")  # fmt: skip
    check(path, tmp_path, arm)
    rows = [f"2026-11-10 23:59:{59 - 59 + t:09.6f}" for t in arm.time]
    lines = [
        ",".join([r, *(f"{v:.6f}" for v in row)])
        for r, row in zip(rows, np.hstack([arm.command, arm.pos]), strict=True)
    ]
    (tmp_path / "day.csv").write_text("\n".join(["when,des1,des2,q1,q2", *lines]))
    check(tmp_path / "day.csv", tmp_path, arm)


def test_a_chinese_table_from_a_spreadsheet(arm: Log, tmp_path: Path) -> None:
    """In GBK, as spreadsheets on Chinese Windows write; the names tell the roles as in UTF-8."""
    head = "时间戳(ms),肩_目标角度(度),肘_目标角度(度),肩_实际角度(度),肘_实际角度(度)"
    path = write(tmp_path / "表.csv", head, 1e3 * arm.time, DEG * arm.command, DEG * arm.pos)
    path.write_bytes(path.read_text("utf-8").encode("gbk"))
    check(path, tmp_path, arm)


def test_ranges_that_are_degrees_by_mistake_are_named(arm: Log, tmp_path: Path) -> None:
    """`range="-2 2.5"` without <compiler angle="radian"/> is 0.08 rad; radians then look like degrees."""
    model = save(tmp_path, ARM.replace('<compiler angle="radian"/>', ""))
    path = write(tmp_path / "a.csv", "t,q1_des,q2_des,q1,q2", arm.time, arm.command, arm.pos)
    found = propose(read(path), load_target(model))
    assert 'angle="radian"' in found.render()
    assert found.assignments["joint_pos"].doubtful


def test_units_of_commands_of_their_own(arm: Log, tmp_path: Path) -> None:
    for head in ("t,q1_des,q2_des,q1,q2", "t,q1_des [deg],q2_des [deg],q1 [rad],q2 [rad]"):
        check(write(tmp_path / "a.csv", head, arm.time, DEG * arm.command, arm.pos), tmp_path, arm)


def test_what_cannot_be_known_is_in_doubt_or_refused(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    path = write(tmp_path / "negated.csv", "t,q1_des,q2_des,q1,q2", arm.time, -arm.command, arm.pos)
    assert propose(read(path), target).assignments["command"].doubtful
    path = write(tmp_path / "index.csv", "index,q1_des,q2_des,q1,q2", np.arange(len(arm.time)), arm.command, arm.pos)
    with pytest.raises(GapError, match="has no time") as error:
        propose(read(path), target)
    assert "--rate" in str(error.value)


@pytest.mark.parametrize(
    ("name", "words", "unit"),
    [
        ("Ellbogen_soll [deg]", ("elbow", "target"), "deg"), ("qRef3", ("position", "target", "3"), ""),
        ("Drehmoment_ist / Nm", ("torque", "measured"), "N m"), ("current_position", ("measured", "position"), ""),
        ("motor_current_A", ("joint", "electric", "a"), ""), ("左膝_速度", ("left", "knee", "velocity"), ""),
        ("FL_hip_joint2", ("fl", "hip", "joint", "2"), ""), ("speed_rpm", ("velocity",), "rpm"),
    ],
)  # fmt: skip
def test_names_in_english(name: str, words: tuple[str, ...], unit: str) -> None:
    assert english(name) == words
    assert split_unit(name)[1] == unit


@pytest.mark.parametrize("case", ["csv_millis", "csv_set_and_actual", "mcap_command_order"])
def test_recordings_that_were_read_wrongly(case: str, shared: Callable[[str], Path]) -> None:
    logs = shared("cases") / "logs" / case
    found = propose(read(next(p for p in logs.iterdir() if p.is_dir())), load_target(logs / "arm.xml"))
    command = found.assignments["command"]
    assert command.targets == ("m_shoulder", "m_elbow")
    assert found.joints == ("shoulder", "elbow")
    assert not command.doubtful
    assert found.assignments["joint_pos"].columns == (1, 0)
    assert command.columns == ((0, 1) if "mcap" in case else (1, 0))


def test_raw_files_that_were_read_wrongly(shared: Callable[[str], Path], tmp_path: Path) -> None:
    raw = shared("cases") / "logs" / "raw_files"
    assert propose(read(raw / "dfki_c1_trajectory.csv")).assignments["joint_torque"].source.member == "tau_meas"
    for name in ("sage_control.csv", "sage_state_motor.csv"):
        (tmp_path / name).symlink_to(raw / name)
    found = propose(read(tmp_path))
    assert len(found.recordings) == 1
    assert found.assignments["command"].source.stream == "target"
    assert found.assignments["joint_pos"].source.stream == "measured"


def test_roles_by_values_are_in_doubt(arm: Log, tmp_path: Path) -> None:
    """A table without a header, and a `qd` that is the desired position beside `dq`."""
    target = load_target(save(tmp_path, ARM))
    np.savetxt(tmp_path / "bare.csv", np.column_stack([arm.time, arm.pos, arm.vel, arm.command]), delimiter=",")
    np.savez(tmp_path / "qd.npz", t=arm.time, q=arm.pos, dq=arm.vel, qd=arm.command)
    for name in ("bare.csv", "qd.npz"):
        found = propose(read(tmp_path / name), target)
        arrays = run_arrays(found, found.recordings[0]).arrays
        np.testing.assert_allclose(arrays["command"], arm.command, atol=1e-6)
        np.testing.assert_allclose(arrays["joint_pos"], arm.pos, atol=1e-6)
        np.testing.assert_allclose(arrays["joint_vel"], arm.vel, atol=1e-6)
        assert found.assignments["command"].doubtful


def test_names_of_joints_in_short_and_strange_ones(arm: Log, tmp_path: Path) -> None:
    longer = ARM.replace("elbow_joint", "elbow_pitch_joint").replace("shoulder_joint", "shoulder_pitch_joint")
    target = load_target(save(tmp_path, longer))
    path = write(tmp_path / "a.csv", "t,elbow_cmd,shoulder_cmd,elbow_pos,shoulder_pos", arm.time, arm.command[:, ::-1],
                 arm.pos[:, ::-1])  # fmt: skip
    found = propose(read(path), target)
    assert found.assignments["joint_pos"].columns == found.assignments["command"].columns == (1, 0)
    assert not found.assignments["joint_pos"].doubtful
    for head in ("t,foo_cmd,bar_cmd,foo_pos,bar_pos", "t,foo_cmd,elbow_cmd,foo_pos,elbow_pos"):
        path.write_text("\n".join([head, *path.read_text().splitlines()[1:]]))
        assert propose(read(path), target).assignments["joint_pos"].doubtful


def test_commands_and_positions_of_two_clocks_are_refused(arm: Log, tmp_path: Path) -> None:
    messages = writers.joint_states(arm, list(JOINTS)) + writers.float_commands(arm, offset=-1e6)
    path = writers.mcap_ros2(tmp_path / "a.mcap", sorted(messages, key=lambda m: m[3]))
    found = propose(read(path), load_target(save(tmp_path, ARM)))
    with pytest.raises(GapError, match="do not overlap in time"):
        run_arrays(found, found.recordings[0])


def test_nothing_that_moves_is_said_to(arm: Log, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,q1,q2,q1_cmd,q2_cmd", arm.time, arm.pos, 0 * arm.command)
    found = propose(read(path), load_target(save(tmp_path, ARM)))
    assert not found.complete
    assert "never changes" in " ".join(found.missing)


def test_a_unit_that_ranges_do_not_tell_is_in_doubt(arm: Log, tmp_path: Path) -> None:
    """ODrive's turns without a word of it; and encoder steps that are not those of a known servo."""
    target = load_target(save(tmp_path, ARM))
    for scale in (0.5 / np.pi, 1000.3):
        path = write(tmp_path / "a.csv", "t,q1,q2,q1_cmd,q2_cmd", arm.time, scale * arm.pos, scale * arm.command)
        assert propose(read(path), target).assignments["joint_pos"].doubtful
    path = write(tmp_path / "b.csv", "t,q1 [rev],q2 [rev],q1_cmd [rev],q2_cmd [rev]", arm.time,
                 0.5 / np.pi * arm.pos, 0.5 / np.pi * arm.command)  # fmt: skip
    check(path, tmp_path, arm)


def test_encoder_steps_are_steps_also_where_the_model_has_no_ranges(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, re.sub(r' range="[^"]*" limited="true"', "", ARM)))
    steps = [np.round(2048 + 4096 / (2 * np.pi) * values) for values in (arm.pos, arm.command)]
    path = write(tmp_path / "a.csv", "ms,goal1,goal2,present1,present2", 1000 * arm.time, steps[1], steps[0])
    found = propose(read(path), target)
    run = run_arrays(found, found.recordings[0])
    np.testing.assert_allclose(run.arrays["joint_pos"], arm.pos, atol=1e-3)


def test_what_ros_prints_without_a_header(arm: Log, tmp_path: Path) -> None:
    """`ros2 topic echo --csv` of joint states beside a table of commands; other messages with names are refused."""
    sec, names = np.floor(arm.time), ",".join(JOINTS)
    rows = zip(sec, 1e9 * (arm.time - sec), arm.pos, arm.vel, strict=True)
    lines = [f"{s:.0f},{ns:.0f},,{names}," + ",".join(f"{x:.9g}" for x in (*q, *v)) for s, ns, q, v in rows]
    folder = tmp_path / "run"
    folder.mkdir()
    state = folder / "a.csv"
    state.write_text("\n".join(lines))
    write(folder / "a_cmd.csv", "time [s],shoulder_cmd,elbow_cmd", arm.time, arm.command)
    for name in ("b", "b_cmd"):  # another run of the same
        (folder / f"{name}.csv").write_text((folder / f"a{name[1:]}.csv").read_text())
    check(folder, tmp_path, arm)
    assert len({tuple(s.name for s in r.streams) for r in read(folder)}) == 1
    (recording,) = read(state)
    fields = recording.streams[0].fields
    assert list(fields) == ["position", "velocity"]
    assert fields["velocity"].labels == JOINTS
    state.write_text("\n".join(f"{line},1,2,3" for line in lines))
    with pytest.raises(GapError, match=r"without a header[\s\S]*ros2 bag record"):
        read(state)


@pytest.mark.parametrize("kind", ["in turn", "one by one", "numbered", "a moment each", "variable and value"])
def test_a_row_a_joint(kind: str, arm: Log, tmp_path: Path) -> None:
    labels = ("1", "2") if kind == "numbered" else JOINTS
    late = 0.002 if kind == "a moment each" else 0.0
    rows = [
        (t + k * late, label, arm.pos[i, k], arm.command[i, k])
        for i, t in enumerate(arm.time) for k, label in enumerate(labels)
    ]  # fmt: skip
    if kind == "one by one":
        rows.sort(key=lambda row: row[1] == JOINTS[1])
    head, cells = "time,joint,position,goal_position", [f"{t:.6f},{n},{q:.9g},{u:.9g}" for t, n, q, u in rows]
    if kind == "variable and value":
        head = "time,variable,value"
        cells = [
            f"{t:.6f},{n}_{what},{x:.9g}" for t, n, *of in rows for what, x in zip(("pos", "cmd"), of, strict=True)
        ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([head, *cells]))
    if not late:
        check(path, tmp_path, arm)
    found = propose(read(path), load_target(save(tmp_path, ARM)))
    assert found.complete
    assert ("one after another" in " ".join(found.warnings)) == bool(late)


def test_turns_where_no_range_tells_them(arm: Log, tmp_path: Path) -> None:
    """An ODrive's names give its unit; other names leave it in doubt."""
    target = load_target(save(tmp_path, re.sub(r' range="[^"]*" limited="true"', "", ARM)))
    for names, in_doubt in (("q{}", True), ("axis{}.pos_estimate", False)):
        head = ",".join(["t", *(names.format(k) for k in (0, 1)), "axis0.input_pos", "axis1.input_pos"])
        path = write(tmp_path / "a.csv", head, arm.time, 0.5 / np.pi * arm.pos, 0.5 / np.pi * arm.command)
        place = propose(read(path), target).assignments["joint_pos"]
        assert place.doubtful is in_doubt
        assert (place.unit == "rev") is not in_doubt


def test_a_clock_that_is_not_there(arm: Log, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "uptime_ms,q1,q2", 1e3 * arm.time, arm.pos)
    with pytest.raises(GapError, match="did you mean uptime_ms"):
        propose(read(path), use=["time=uptime"])


def test_files_that_name_joints_alone(arm: Log, tmp_path: Path) -> None:
    """The files' names say what their columns are."""
    folder, head = tmp_path / "run", ",".join(("time [s]", *JOINTS))
    folder.mkdir()
    for name, values in (("joint_states", arm.pos), ("joint_commands", arm.command)):
        write(folder / f"{name}.csv", head, arm.time, values)
    check(folder, tmp_path, arm)


def test_what_is_in_no_known_unit(arm: Log, tmp_path: Path) -> None:
    """Steps of a velocity are of the positions' slope; what is none is left out; currents are the model's torques."""
    target, head = load_target(save(tmp_path, ARM)), "t,q1,q2,q1_cmd,q2_cmd,"
    for factor, whole, kept in ((41.7, True, True), (6.3, False, False)):
        speed = np.round(factor * arm.vel) if whole else factor * arm.vel
        path = write(tmp_path / "a.csv", head + "qd1,qd2", arm.time, arm.pos, arm.command, speed)
        found = propose(read(path), target)
        assert ("joint_vel" in found.assignments) is kept
        assert ("no unit" in " ".join(found.warnings)) is not kept
        if kept:
            assert found.assignments["joint_vel"].scale == pytest.approx([1 / factor] * 2, rel=0.02)
    for names in ("current1,current2", "torque1 [%],torque2 [%]"):
        path = write(tmp_path / "a.csv", head + names, arm.time, arm.pos, arm.command, arm.torque / 8)
        found = propose(read(path), target)
        assert found.assignments["joint_torque"].scale == pytest.approx([8, 8], rel=0.3)
        assert (found.torque_kind, found.assignments["joint_torque"].doubtful) == ("current_times_constant", True)


def test_runs_one_after_the_other_are_no_joints(arm: Log, tmp_path: Path) -> None:
    rows = [
        f"{t:.6f},{run},{q[0]:.9g},{q[1]:.9g}"
        for run in ("walk", "stand")
        for t, q in zip(arm.time, arm.pos, strict=True)
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,run,q1,q2", *rows]))
    assert [r.streams[0].count for r in read(path)] == [len(arm.time)] * 2


def test_a_row_a_motor_beside_the_name_of_its_joint(arm: Log, tmp_path: Path) -> None:
    """The motors' names are none of the model's, whatever their numbers; those of the joints beside them are."""
    target = load_target(save(tmp_path, ARM))
    for names in (("RS02_15", "RS04_13"), ("RS02_15,elbow_joint", "RS04_13,shoulder_joint")):
        lines = ["t,q_m,q_m_des,motor_name,joint_name" if "," in names[0] else "t,q_m,q_m_des,motor_name"]
        for t, q, c in zip(arm.time, arm.pos, arm.command, strict=True):
            lines += [f"{t:.6f},{q[k]:.9f},{c[k]:.9f},{names[1 - k]}" for k in (1, 0)]
        (tmp_path / "log.csv").write_text("\n".join(lines))
        found = propose(read(tmp_path / "log.csv"), target)
        doubtful = "," not in names[0]
        assert found.assignments["joint_pos"].doubtful is found.assignments["command"].doubtful is doubtful
        if not doubtful:
            arrays = run_arrays(found, found.recordings[0]).arrays
            np.testing.assert_allclose(arrays["joint_pos"], arm.pos, atol=1e-6)
            np.testing.assert_allclose(arrays["command"], arm.command, atol=1e-6)


def test_letters_of_control_engineering(arm: Log, tmp_path: Path) -> None:
    columns = [arm.command[:, 1], arm.pos[:, 1], arm.torque[:, 1]]
    found = propose(read(write(tmp_path / "a.csv", "t,r,y,u", arm.time, *columns)))
    assert found.assignments["command"].source.member == "r"
    assert found.assignments["joint_pos"].source.member == "y"


def test_a_table_of_labview_and_a_rate_beside_a_table(arm: Log, tmp_path: Path) -> None:
    head = "LabVIEW Measurement\nChannels\t4\nX0\t0.0\t0.0\t0.0\t0.0\n***End_of_Header***\n"
    rows = write(tmp_path / "a.txt", "", arm.time, arm.command, arm.pos, delimiter="\t").read_text().lstrip("\n")
    (tmp_path / "a.lvm").write_text(f"{head}X_Value\tq1_cmd\tq2_cmd\tq1\tq2\tComment\n{rows}")
    check(tmp_path / "a.lvm", tmp_path, arm)
    path = write(tmp_path / "b.csv", "q1_cmd,q2_cmd,q1,q2", arm.command, arm.pos)
    rate = 1 / np.median(np.diff(arm.time))
    path.with_suffix(".json").write_text(json.dumps({"robot": {"control_freq": rate}}))
    check(path, tmp_path, arm)


def test_words_between_the_numbers_of_a_serial_port(arm: Log, tmp_path: Path) -> None:
    lines = [
        f"[INFO] t: {t:.6f} goal: {c[0]:.9f},{c[1]:.9f} -> pos: {q[0]:.9f},{q[1]:.9f} ok"
        for t, c, q in zip(arm.time, arm.command, arm.pos, strict=True)
    ]
    (tmp_path / "a.log").write_text("\n".join(["hello", *lines]))
    (stream,) = read(tmp_path / "a.log")[0].streams
    np.testing.assert_allclose(stream.fields["goal"].values, arm.command, atol=1e-6)
    np.testing.assert_allclose(stream.fields["pos"].values, arm.pos, atol=1e-6)
    np.testing.assert_allclose(stream.clocks["t"], arm.time, atol=1e-6)


def test_errors_about_a_text_keep_their_own_way_out(arm: Log, tmp_path: Path) -> None:
    path = write(tmp_path / "a.txt", "q1_cmd,q2_cmd,q1,q2", arm.command, arm.pos)
    with pytest.raises(GapError, match="has no time") as caught:
        propose(read(path), load_target(save(tmp_path, ARM)))
    assert not explain(caught.value, path, TAKES["recording"])
    assert "--rate" in str(caught.value.hint)
    path.write_text("\n".join(path.read_text().splitlines()[1:]))
    found = propose([replace(r, facts={"rate": 100}) for r in read(path)], load_target(save(tmp_path, ARM)))
    assert found.complete or "column_1" in " ".join(found.missing)
    (tmp_path / "a.tdms").write_bytes(b"TDSm\0")
    with pytest.raises(GapError) as caught:
        read(tmp_path / "a.tdms")
    assert "nptdms" in str(caught.value.hint)


def test_a_file_a_motor_is_one_run_where_their_clock_says_so(arm: Log, tmp_path: Path) -> None:
    for start, runs in ((1.7e9, 1), (0.0, 2)):
        folder = tmp_path / f"logs{runs}"
        folder.mkdir()
        for k in range(2):
            time = start + 0.001 * k + arm.time
            write(folder / f"motor_{k}.csv", "time,goal,pos", time, arm.command[:, k], arm.pos[:, k], fmt="%.6f")
        assert len(read(folder)) == runs
    found = propose(read(tmp_path / "logs1"), load_target(save(tmp_path, ARM)))
    assert found.assignments["joint_pos"].targets == ("shoulder_joint", "elbow_joint")
    arrays = run_arrays(found, found.recordings[0]).arrays
    np.testing.assert_allclose(arrays["joint_pos"][5:-5], arm.pos[5 : len(arrays["time"]) - 5], atol=0.05)


URDF = """<robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="1"/><origin xyz="0 0 -0.2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://arm_description/meshes/upper.stl"/></geometry></collision></link>
<joint name="shoulder_joint" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="20" velocity="5"/></joint></robot>"""


def test_a_urdf_of_ros_gets_servos_and_its_meshes(arm: Log, tmp_path: Path) -> None:
    """It has no actuators, and names its meshes by the package that they are in."""
    package = tmp_path / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.4)).export(package / "meshes" / "upper.stl")
    model = package / "urdf" / "arm.urdf"
    model.write_text(URDF)
    table = write(tmp_path / "a.csv", "time,command,position", arm.time, arm.command[:, 0], arm.pos[:, 0])
    found = propose(read(table), bare := load_target(model))
    assert any("--servos KP KD" in line for line in found.missing)
    with pytest.raises(GapError, match=r"no actuators[^$]*--servos KP KD"):
        write_case(found, bare, tmp_path / "none")
    target = load_target(model, servos=(40, 2))
    write_case(propose(read(table), target), target, tmp_path / "case")
    made = load_case(tmp_path / "case").model
    np.testing.assert_allclose([made.actuator_gainprm[0, 0], *made.actuator_forcerange[0]], [40, -20, 20])
    assert made.nmesh == 1
    for wrong, servos in ((model, (0, 1)), (tmp_path / "case" / "model.xml", (40, 2))):
        with pytest.raises(GapError, match="servos"):
            load_target(wrong, servos)
