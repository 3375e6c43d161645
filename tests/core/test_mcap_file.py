"""MCAP that is written can be read: a scene, and the signals of a diagnosis."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import realsim as rs
from realsim.core.mcap_file import NUMBER, write_mcap
from tests.gap.truth import ARM, Truth, make_case

pytest.importorskip("mcap")


def messages(path: Path) -> dict[str, list[tuple[float, Any]]]:
    """Topic -> (time in s, message)."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[float, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert schema.encoding == "jsonschema"
            assert json.loads(schema.data)["type"] == "object"
            found.setdefault(channel.topic, []).append((1e-9 * message.log_time, json.loads(message.data)))
    return found


def test_messages_come_back_in_order_and_the_same_bytes(tmp_path: Path) -> None:
    topics = {"/a": ("numbers", {"type": "object", "properties": {"x": NUMBER}})}
    said = [("/a", t, {"x": t**2}) for t in (0.3, 0.1, 0.2)]
    write_mcap(tmp_path / "a.mcap", topics, said)
    assert messages(tmp_path / "a.mcap") == {"/a": [(pytest.approx(t), {"x": t**2}) for t in (0.1, 0.2, 0.3)]}
    write_mcap(tmp_path / "b.mcap", topics, said)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_scene_for_foxglove(tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    trimesh.creation.box((0.6, 0.4, 0.3)).export(tmp_path / "box.stl")
    scene = rs.contact(tmp_path / "box.stl", tmp_path / "scene", rs.SceneConfig(contact_probes=100))
    (file,) = scene.export("foxglove", tmp_path / "out")["foxglove"]
    found = messages(file)
    (surface,) = found["/surface"][0][1]["entities"]
    (triangles,) = surface["triangles"]
    points = np.array([[p["x"], p["y"], p["z"]] for p in triangles["points"]])
    assert np.ptp(points, axis=0) == pytest.approx([0.6, 0.4, 0.3], abs=1e-3)
    assert max(triangles["indices"]) < len(points)
    (collision,) = found["/collision"][0][1]["entities"]
    assert [c["size"]["z"] for c in collision["cubes"]]


def test_signals_of_a_diagnosis(tmp_path: Path) -> None:
    make_case(tmp_path / "case", ARM, Truth(), runs=3, seed=1, span=(1.0, 1.2))
    config = rs.DiagnoseConfig(
        effects=("viscous_friction",), max_causes=1, bootstrap=20, report=False, signals=True, threads=1
    )
    found = rs.diagnose(tmp_path / "case", tmp_path / "out", config)
    said = messages(tmp_path / "out" / "signals.mcap")
    assert said["/diagnosis"][0][1]["message"] == found.sentence
    topics = {topic.rpartition("/")[2] for topic in said}
    assert {"measured", "nominal", "residual"} <= topics
    case = rs.load_case(tmp_path / "case")
    run = next(run for run in case.runs if f"/{run.name}/measured" in said)
    rows = said[f"/{run.name}/measured"]
    joint = case.joint_names[0]
    assert [row[f"joint_pos.{joint}"] for _, row in rows] == pytest.approx(list(run.signals["joint_pos"][:, 0]))
