"""What is opened is recognised, commands run in their own process, and results are found again."""

import ast
import asyncio
import json
import shlex
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from realsim.app.actions import ACTIONS, WAYS, arguments_of, free_folder
from realsim.app.gallery import Result, results_below
from realsim.app.page import Desk, lines_to_use
from realsim.app.work import Work
from realsim.cli.roots import Roots
from realsim.cli.table import COMMANDS
from realsim.core.errors import RealsimError
from realsim.core.recognise import KINDS


def test_what_is_recognised_has_commands_that_exist(tmp_path: Path) -> None:
    assert set(WAYS) <= set(KINDS)
    for look, actions in WAYS.values():
        assert set(look[:1]) <= set(COMMANDS)
        assert set(actions) <= set(ACTIONS)
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0 ftyp")
    desk = Desk(Roots([tmp_path]))
    asyncio.run(desk.open("walk.mp4"))
    assert desk.kind is KINDS["video"]
    assert desk.look is None


def test_what_is_opened_last_is_shown(tmp_path: Path) -> None:
    """Also where something that takes longer was opened before it."""
    trimesh.creation.box((1, 1, 0.2)).export(tmp_path / "a.stl")
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0 ftyp")
    desk = Desk(Roots([tmp_path]))

    async def both() -> None:
        slow = asyncio.create_task(desk.open("a.stl"))
        await asyncio.sleep(0.3)
        await desk.open("walk.mp4")
        await slow

    asyncio.run(both())
    assert desk.opened == tmp_path / "walk.mp4"
    assert desk.look is None
    assert desk.preview.points is None


def test_a_command_is_made_of_what_was_entered(tmp_path: Path) -> None:
    values = {"--unit": "mm", "--up": "as found"}
    made = arguments_of(ACTIONS["contact"], tmp_path / "a.stl", tmp_path / "out", values)
    assert made == ("contact", str(tmp_path / "a.stl"), "--out", str(tmp_path / "out"), "--unit=mm")
    with pytest.raises(RealsimError, match="model"):
        arguments_of(ACTIONS["log"], tmp_path / "a.csv", tmp_path / "case", {"--model": " "})


def test_a_folder_that_is_there_is_never_written_to(tmp_path: Path) -> None:
    first = free_folder(tmp_path, tmp_path / "room.ply", "scene")
    first.mkdir()
    assert free_folder(tmp_path, tmp_path / "room.ply", "scene") == tmp_path / "room_scene_2"


def test_a_result_and_an_error_are_taken_from_the_command(tmp_path: Path) -> None:
    good, bad = Work("good", ("schema",)), Work("bad", ("inspect", str(tmp_path / "none")))

    async def both() -> None:
        await good.run()
        await bad.run()

    asyncio.run(both())
    assert good.state == "done"
    assert "reconstruct" in good.result["schemas"]
    assert bad.state == "failed"
    assert bad.result["message"]
    assert good.seconds > 0


def test_a_command_that_is_stopped_leaves_nothing(tmp_path: Path) -> None:
    desk = Desk(Roots([tmp_path]))

    async def stopped() -> Work:
        work = desk.start("demo", ("demo", "--out", str(tmp_path / "demo")), tmp_path / "demo")
        waiting = desk.start("next", ("schema",), None)
        deadline = time.monotonic() + 60
        while work.state != "running" and time.monotonic() < deadline:
            await asyncio.sleep(0.05)
        await desk.cancel(waiting)
        await desk.cancel(work)
        await asyncio.sleep(0)
        assert waiting.state == "cancelled"
        return work

    assert asyncio.run(stopped()).state == "cancelled"
    assert not (tmp_path / "demo").exists()


def test_progress_is_heard() -> None:
    work = Work("a", ())
    work.hear({"what": "points", "share": 0.5})
    work.hear({"what": "points", "share": 1.5, "left": 12})
    work.hear({"what": "mesh", "share": None})
    assert (work.steps, work.share, work.left) == (["points", "mesh"], None, 12.0)


def test_results_below_a_folder(tmp_path: Path) -> None:
    for name, file, content in (
        ("one", "report.json", {"verdict": {"level": "good", "headline": "Fine."}}),
        ("deep/two", "diagnosis.json", {"verdict": "no_gap", "sentence": "No gap."}),
        ("broken", "contact.json", None),
        (".hidden", "report.json", {}),
    ):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / file).write_text("{" if content is None else json.dumps(content))
    assert {(r.folder.name, r.level, r.headline) for r in results_below(tmp_path)} == {
        ("one", "good", "Fine."),
        ("two", "no_gap", "No gap."),
    }


def test_a_mesh_is_recognised_and_shown(tmp_path: Path) -> None:
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "box.ply")
    desk = Desk(Roots([tmp_path]))
    asyncio.run(desk.open("box.ply"))
    assert desk.look is not None
    assert desk.look.state == "done"
    assert desk.preview.points is not None
    np.testing.assert_allclose(np.ptp(desk.preview.points, axis=0), [2.0, 1.0, 0.5], atol=0.02)


def test_nothing_outside_the_folder_is_opened(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    with pytest.raises(RealsimError, match="leads out"):
        asyncio.run(Desk(Roots([tmp_path / "in"])).open("../"))


def test_a_folder_of_no_known_kind_offers_no_command(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "todo.odt").write_bytes(b"x")
    desk = Desk(Roots([tmp_path]))
    asyncio.run(desk.open("notes"))
    assert desk.look is not None
    assert desk.look.state == "failed"
    assert desk.ways == ()
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "box.ply")
    asyncio.run(desk.open("box.ply"))
    assert "contact" in desk.ways


def test_the_time_that_is_left_goes_down_and_never_stands_at_zero() -> None:
    work = Work("a", ())
    assert work.remaining() is None
    work.hear({"what": "points", "share": None, "left": 30})
    work.heard -= 10
    assert work.remaining() == pytest.approx(20, abs=1)
    work.heard -= 20
    assert work.remaining() is None


@pytest.mark.parametrize("kind", ["scene", "diagnosis"])
def test_lines_to_copy_hold_for_any_folder(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / 'my "first" scene'
    python, shell = lines_to_use(Result(folder, kind, "good", "", None, 0.0))
    texts = [n.value for n in ast.walk(ast.parse(python)) if isinstance(n, ast.Constant)]
    assert str(folder) in texts
    assert any(str(folder) in word for word in shlex.split(shell))
