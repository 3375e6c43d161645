"""Base poses of a log in the world of a capture are put into the frame of its scene."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap import load_case
from realsim.gap.recordings import load_target, load_world, propose
from realsim.gap.recordings.recording import Field, Recording, Stream

from .robots import ARM, QUADRUPED, Log, save

TURN = Rotation.from_euler("xyz", [0.02, -0.03, 1.2])
SHIFT, SCALE = np.array([1.0, -2.0, 0.3]), 1.01


def _scene(folder: Path, **changes: object) -> Path:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = TURN.as_matrix(), SHIFT
    folder.mkdir()
    report = {"T_sim_world": T.tolist(), "world": "capture", "scale": {"value": SCALE}} | changes
    (folder / "report.json").write_text(json.dumps(report))
    return folder


def test_a_log_in_the_captures_world_is_put_into_the_scene(quadruped: Log, tmp_path: Path) -> None:
    model, scene = save(tmp_path, QUADRUPED), _scene(tmp_path / "scene")
    # The walk as it is in the world of the capture: what the scene's frame makes of it is the walk itself.
    assert quadruped.place is not None
    assert quadruped.quat is not None
    there = (quadruped.place - SHIFT) @ TURN.as_matrix() / SCALE
    turned = (TURN.inv() * Rotation.from_quat(quadruped.quat, scalar_first=True)).as_quat(scalar_first=True)
    path = tmp_path / "walk.npz"
    np.savez(path, time=quadruped.time, q=quadruped.pos, q_des=quadruped.command, base_pos=there, base_quat=turned)
    walk, out = path, tmp_path / "case"
    arguments = ["log", str(walk), "--model", str(model), "--out", str(out), "--use", "base_quat=base_quat"]
    assert main([*arguments, "--scene", str(scene / "scene.xml")]) == 0
    run = load_case(out).runs[0]
    np.testing.assert_allclose(run.signals["base_pos"], quadruped.place, atol=1e-9)
    assert quadruped.quat is not None
    off = Rotation.from_quat(run.signals["base_quat"], scalar_first=True) * Rotation.from_quat(
        quadruped.quat, scalar_first=True
    ).inv()  # fmt: skip
    assert off.magnitude().max() < 1e-6
    assert json.loads((out / "proposal.json").read_text())["scene"] == str(scene / "scene.xml")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"world": "chosen by the backend"}, "without poses"),
        ({"T_sim_world": [[1, 0], [0, 1]]}, "cannot be read"),
        ({"T_sim_world": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "cannot be read"),
        ({"T_sim_world": 1.0}, "cannot be read"),
        ({"scale": None}, "cannot be read"),
    ],
)
def test_scenes_that_do_not_say_how_they_lie(changes: dict[str, object], said: str, tmp_path: Path) -> None:
    with pytest.raises(GapError, match=said):
        load_world(_scene(tmp_path / "scene", **changes))


def test_a_report_that_is_no_object_is_refused(tmp_path: Path) -> None:
    scene = _scene(tmp_path / "scene")
    (scene / "report.json").write_text("[1, 2]")
    with pytest.raises(GapError, match="cannot be read"):
        load_world(scene)


def test_a_scene_needs_a_report_and_a_log_a_base_pose(arm: Log, tmp_path: Path) -> None:
    with pytest.raises(GapError, match=r"no report\.json"):
        load_world(tmp_path)
    world, target = load_world(_scene(tmp_path / "scene")), load_target(save(tmp_path, ARM))
    fields = {"q": Field(arm.pos), "q_des": Field(arm.command)}
    recording = Recording(Path("log"), "run", "test", (Stream("", "table", {"time": arm.time}, fields),))
    with pytest.raises(GapError, match="no base pose"):
        propose([recording], target, world=world)
