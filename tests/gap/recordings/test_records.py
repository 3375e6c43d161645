"""Texts of records: lines, blocks, elements; whatever names its values."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap.recordings import load_target, propose, read

from .robots import ARM, Log, save
from .test_door import DEG, JOINTS, check

Rows = Iterator[tuple[float, list[float], list[float]]]


def block(t: float, pos: list[float], sent: list[float], split: bool) -> list[str]:
    """As Protobuf prints a message."""
    seconds, rest = divmod(round(1e6 * t), 10**6)
    parts = [
        line
        for k in (1, 0)
        for line in ("joint {", f'  name: "{JOINTS[k]}"', f"  feedback: {pos[k]:.6f} planned: {sent[k]:.6f}", "}")
    ]
    return ["header {", f"  time {{ sec: {seconds} usec: {rest} }}", "}", *parts, *(["---"] if split else [])]


def echo(t: float, pos: list[float], sent: list[float]) -> list[str]:
    """As `ros2 topic echo` prints a message."""
    seconds, rest = divmod(round(1e6 * t), 10**6)
    head = ["header:", "  stamp:", f"    sec: {seconds}", f"    nanosec: {1000 * rest}", "joint_names:"]
    lists = ["reference:", "  positions:", *(f"  - {x:.6f}" for x in sent)]
    return [
        *head,
        *(f"- {j}" for j in JOINTS),
        *lists,
        "feedback:",
        "  positions:",
        *(f"  - {x:.6f}" for x in pos),
        "---",
    ]


LINES: dict[str, Callable[[Rows], list[str]]] = {
    "dataflash": lambda rows: [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 130, 45, MNT, QBff, TimeUS,I,Des_shoulder,shoulder,Des_elbow,elbow",
        "FMT, 131, 75, MSG, QZ, TimeUS,Message",
        "MSG, 61204411, ready (0f9a1d4b)",
        *(f"MNT, {1e6 * t:.0f}, 0, {u[0]:.6f}, {q[0]:.6f}, {u[1]:.6f}, {q[1]:.6f}" for t, q, u in rows),
    ],
    "line protocol": lambda rows: [
        "# DML",
        *(
            f"{kind},host=a,joint={j} pos={x[k]:.6f},ok=true,temp=31i {1e9 * (t + 1.7e9):.0f}"
            for t, q, u in rows
            for kind, x in (("motor", q), ("setpoint", u))
            for k, j in enumerate(JOINTS)
        ),
    ],
    "a line a joint": lambda rows: [
        f"[{t + 1.7e9:.6f}] {j}: pos={q[k]:.6f} cmd={u[k]:.6f}" for t, q, u in rows for k, j in enumerate(JOINTS)
    ],
    "units": lambda rows: [
        f"t={1e3 * t:.1f} ms shoulder={DEG * q[0]:.4f} deg elbow={DEG * q[1]:.4f} deg "
        f"shoulder_goal={DEG * u[0]:.4f} deg elbow_goal={DEG * u[1]:.4f} deg"
        for t, q, u in rows
    ],
    "blocks": lambda rows: [line for row in rows for line in block(*row, split=True)],
    "blocks without a line between": lambda rows: [line for row in rows for line in block(*row, split=False)],
    "ros2 topic echo": lambda rows: [line for row in rows for line in echo(*row)],
    "elements": lambda rows: [
        f'<Rob><Ist A1="{q[0]:.6f}" A2="{q[1]:.6f}"/><Soll A1="{u[0]:.6f}" A2="{u[1]:.6f}"/><t>{t:.4f}</t></Rob>'
        for t, q, u in rows
    ],
    "a document": lambda rows: [
        '<?xml version="1.0"?>\n<log><robot_name>arm</robot_name>',
        *(
            f'<state t="{t:.4f}"><joint name="elbow_joint" pos="{q[1]:.6f}" goal="{u[1]:.6f}"/>\n'
            f'<joint name="shoulder_joint" pos="{q[0]:.6f}" goal="{u[0]:.6f}"/></state>'
            for t, q, u in rows
        ),
        "</log>",
    ],
    "R": lambda rows: [
        '"t.ms" "phase" "shoulder.ist..deg." "shoulder.soll..deg." "elbow.ist..deg." "elbow.soll..deg."',
        *(
            f'"{k + 1}" {1e3 * t:.1f} "a b" {DEG * q[0]:.5f} {DEG * u[0]:.5f} {DEG * q[1]:.5f} {DEG * u[1]:.5f}'
            for k, (t, q, u) in enumerate(rows)
        ),
    ],
    "a row ends in what parts cells": lambda rows: [
        "t,elbow_ref,shoulder_ref,elbow,shoulder",
        *(f"{t:.4f},{u[1]:.6f},{u[0]:.6f},{q[1]:.6f},{q[0]:.6f}," for t, q, u in rows),
    ],
}  # fmt: skip


@pytest.mark.parametrize("kind", LINES)
def test_named_values_in_a_text(kind: str, arm: Log, tmp_path: Path) -> None:
    rows = zip(arm.time.tolist(), arm.pos.tolist(), arm.command.tolist(), strict=True)
    (tmp_path / "a.txt").write_text("\n".join(LINES[kind](rows)))
    check(tmp_path / "a.txt", tmp_path, arm)


def test_parts_of_a_line_that_are_named_alike(arm: Log, tmp_path: Path) -> None:
    lines = [
        f"{t + 1.7e9:.6f} [ID:001] Goal:{u[0]:.0f}  Pos:{q[0]:.0f}\t[ID:002] Goal:{u[1]:.0f}  Pos:{q[1]:.0f}"
        for t, q, u in zip(arm.time, 2048 + 652 * arm.pos, 2048 + 652 * arm.command, strict=True)
    ]
    (tmp_path / "a.log").write_text("\n".join(["Opened the port", *lines[:50], "[ID:001] no answer", *lines[50:]]))
    (stream,) = read(tmp_path / "a.log")[0].streams
    np.testing.assert_array_equal(stream.fields["Pos"].values, np.round(2048 + 652 * arm.pos))
    found = propose(read(tmp_path / "a.log"), load_target(save(tmp_path, ARM)))
    assert found.assignments["joint_pos"].doubtful, found.render()


def test_a_value_a_line_of_each_series(arm: Log, tmp_path: Path) -> None:
    """influx_inspect export: one series after the other."""
    lines = [
        f"{kind},host=a,joint={j} {name}={x:.6f} {1e9 * (t + 1.7e9):.0f}"
        for kind, name, values in (
            ("state", "position", arm.pos), ("state", "effort", arm.torque), ("reference", "position", arm.command))
        for k, j in enumerate(JOINTS)
        for t, x in zip(arm.time, values[:, k], strict=True)
    ]  # fmt: skip
    (tmp_path / "a.lp").write_text("\n".join(["# DDL", "CREATE DATABASE log WITH NAME autogen", *lines]))
    check(tmp_path / "a.lp", tmp_path, arm)


def test_another_topic_that_names_the_joints_puts_them_in_doubt(arm: Log, tmp_path: Path) -> None:
    """The vehicle rolls and pitches, and so does the gimbal on it."""
    for other in (arm.pos, arm.pos[::-1]):
        lines = []
        for kind, values in (("GIM", arm.pos), ("VEH", other)):
            rows = zip(arm.time, values, arm.command, strict=True)
            more = ", 0.1, 0.1" if kind == "VEH" else ""
            lines += [f"{kind}, {t:.4f}, {q[0]}, {q[1]}, {u[0]}, {u[1]}{more}" for t, q, u in rows]
        heads = [
            "# GIM: t,shoulder,elbow,des_shoulder,des_elbow",
            "# VEH: t,shoulder,elbow,des_shoulder,des_elbow,wheel,des_wheel",
        ]
        (tmp_path / "a.log").write_text("\n".join([*heads, *lines]))
        found = propose(read(tmp_path / "a.log"), load_target(save(tmp_path, ARM)))
        assert found.assignments["joint_pos"].doubtful == (other is not arm.pos), found.render()


def test_tables_of_sqlite(arm: Log, tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "a.db")) as base:
        for name, values in (("joints", arm.pos), ("joint_targets", arm.command)):
            base.execute(f"CREATE TABLE {name} (insertedat DATETIME, elbow REAL, shoulder REAL)")
            stamps = [f"2026-03-01 10:00:{2 + t:09.6f}" for t in arm.time]
            base.executemany(f"INSERT INTO {name} VALUES (?, ?, ?)", zip(stamps, *values.T[::-1].tolist(), strict=True))
        base.commit()
    assert {s.name for s in read(tmp_path / "a.db")[0].streams} == {"joints", "joint_targets"}
    (tmp_path / "b.db").write_bytes(b"SQLite format 3\0")
    with pytest.raises(GapError, match=r"b\.db"):
        read(tmp_path / "b.db")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.xml", "<a><b c='1'/>" * 30, "record|no column|no time|samples"),
        ("b.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]>" + "<r><d>&b;</d></r>" * 9, "not plain XML"),
        ("c.xml", "<e>" * 20000, "end|XML|damaged"),
        ("d.txt", "a {\n" * 5000, "levels"),
        ("candump.log", "(1717499981.2) can0 069#388A433DD0F42CBB\n" * 40, "069#388A"),
    ],
)
def test_texts_that_are_none(name: str, text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(GapError, match=said):
        propose(read(tmp_path / name))


def test_a_model_is_no_recording(tmp_path: Path) -> None:
    geoms = "".join(f'<geom name="g{k}" size="0.{k}"/>' for k in range(30))
    (tmp_path / "robot.xml").write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    with pytest.raises(GapError, match="not a recording"):
        read(tmp_path / "robot.xml")
