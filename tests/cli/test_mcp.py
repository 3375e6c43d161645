"""`realsim mcp`, driven by the library's own client over standard input and output."""

import asyncio
import json
import os
import sys
import time
from collections.abc import Awaitable, Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import trimesh

from realsim.cli.command_line import main
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError
from tests.gap.truth import ARM, PENDULUM, Truth, make_case

pytestmark = pytest.mark.skipif(find_spec("mcp") is None, reason="extra `mcp` is not installed")
TOOLS = {"inspect", "reconstruct", "contact", "export", "diagnose", "report"}


def talk(roots: list[Path], conversation: Callable[[Any], Awaitable[None]], here: bool = False) -> None:
    """A server in a process of its own, or here, with a client that says something."""
    import mcp  # takes a second, which workers without these tests need not

    from realsim.cli.mcp_server import build

    server = mcp.StdioServerParameters(
        command=sys.executable,
        args=["-m", "realsim", "mcp", "--root", *map(str, roots)],
        env={k: os.environ[k] for k in ("PYTHONPATH", "MUJOCO_GL", "OMP_NUM_THREADS") if k in os.environ},
    )

    async def go() -> None:
        async with mcp.Client(build(Roots(roots)) if here else server, read_timeout_seconds=500) as client:
            await conversation(client)

    asyncio.run(go())


def text(answer: Any) -> str:
    return "\n".join(part.text for part in answer.content)


def good(answer: Any) -> dict[str, Any]:
    assert not answer.is_error, text(answer)
    return answer.structured_content


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "open").mkdir()
    trimesh.creation.box((0.6, 0.4, 0.2)).export(tmp_path / "open" / "box.stl")
    (tmp_path / "secret").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "secret" / "box.stl")
    return tmp_path / "open"


@pytest.mark.slow
def test_a_scene_from_a_mesh_with_progress_and_a_diagnosis_with_their_reports(root: Path) -> None:
    make_case(root / "case", PENDULUM, Truth(), runs=2, seed=1, span=(1.0, 1.2))

    async def conversation(client: Any) -> None:
        tools = (await client.list_tools()).tools
        assert {tool.name for tool in tools} == TOOLS
        assert all(tool.description for tool in tools)
        heard: list[tuple[float, str | None]] = []

        async def listen(progress: float, total: float | None, message: str | None) -> None:
            heard.append((progress, message))

        made = good(await client.call_tool("contact", {"meshes": "box.stl", "out": "scene"}, progress_callback=listen))
        assert made["schema"] == "realsim.contact/1"
        assert made["verdict"]["level"] == "good"
        assert (root / "scene" / "scene.xml").is_file()
        values = [value for value, _ in heard]
        assert len(heard) > 2
        assert values == sorted(set(values)), "progress only grows"
        assert any("measuring boxes" in str(message) for _, message in heard)
        report = good(await client.call_tool("report", {"folder": "scene"}))
        assert (report["kind"], report["verdict"]) == ("scene", "good")
        written = good(await client.call_tool("export", {"scenes": "scene", "to": "obj,mjcf"}))
        assert set(written["formats"]) == {"obj", "mjcf"}
        wrong = await client.call_tool("export", {"scenes": "scene", "to": "--overwrite"})
        assert wrong.is_error
        assert "unknown" in text(wrong)
        assert good(await client.call_tool("diagnose", {"cases": "case", "check": True}))["runs"]
        found = good(await client.call_tool("diagnose", {"cases": "case", "out": "found", "max_causes": 1}))
        assert found["verdict"] in ("no_gap", "identified", "ambiguous", "unexplained")
        assert "ranking" not in found
        report = good(await client.call_tool("report", {"folder": "found"}))
        assert report["verdict"] == found["verdict"]
        assert report["page"] == str(root / "found" / "report.html")

    talk([root], conversation)


def test_nothing_outside_the_folders_is_read_or_written(root: Path) -> None:
    secret = root.parent / "secret"
    (root / "link.stl").symlink_to(secret / "box.stl")
    (root / "door").symlink_to(secret)
    (root / "capture").mkdir()
    (root / "capture" / "depth.png").symlink_to(secret / "box.stl")
    (root / "deep").mkdir()
    (root / "deep" / "in").symlink_to(root / "capture")

    async def conversation(client: Any) -> None:
        for mesh in (
            "../secret/box.stl",
            str(secret / "box.stl"),
            "link.stl",
            "door/box.stl",
            "a/../../secret/box.stl",
        ):
            answer = await client.call_tool("contact", {"meshes": mesh, "out": "scene"})
            assert answer.is_error, mesh
            assert "leads out" in text(answer)
        for out in ("../secret/scene", "door/scene", str(secret), "/tmp/none"):
            answer = await client.call_tool("contact", {"meshes": "box.stl", "out": out})
            assert answer.is_error, out
            assert "leads out" in text(answer)
        for capture in ("capture", "deep"):
            answer = await client.call_tool("inspect", {"frames": capture})
            assert "leads out" in text(answer), "a link inside a folder is followed before it is read"
        for case in ("case\u0000", "none", "", "a" * 5000, "x/" * 3000, "a" * 300):
            answer = await client.call_tool("diagnose", {"cases": case, "check": True})
            assert answer.is_error
            assert "path" in text(answer) or "no such file" in text(answer), "a reason is given"
            assert len(text(answer)) < 2000
        answer = await client.call_tool("export", {"scenes": "box.stl", "to": "\0"})
        assert "zero byte" in text(answer)
        answer = await client.call_tool("report", {"folder": str(secret)})
        assert "leads out" in text(answer)

    talk([root], conversation, here=True)
    assert sorted(p.name for p in secret.iterdir()) == ["box.stl"]
    assert not (root / "scene").exists()


@pytest.mark.slow
def test_a_call_that_is_given_up_ends_its_command(root: Path) -> None:
    make_case(root / "case", ARM, Truth(), runs=3, seed=1, span=(1.0, 1.2))

    def commands() -> list[int]:
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes().split(b"\0")
            except OSError:
                continue
            if b"realsim.cli.child" in words and str(root).encode() in b" ".join(words):
                found.append(int(path.parent.name))
        return found

    async def conversation(client: Any) -> None:
        call = asyncio.create_task(client.call_tool("diagnose", {"cases": "case", "out": "found"}))
        end = time.monotonic() + 240
        while not commands() and time.monotonic() < end:
            await asyncio.sleep(0.1)
        assert commands()
        await asyncio.sleep(1.0)
        call.cancel()
        end = time.monotonic() + 240
        while commands() and time.monotonic() < end:
            await asyncio.sleep(0.1)
        assert not commands()
        assert not (root / "found").exists()

    talk([root], conversation)


def test_a_call_ends_at_its_limit_and_a_folder_of_everything_is_refused(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import mcp

    from realsim.cli import roots
    from realsim.cli.mcp_server import build

    os.mkfifo(root / "pipe.stl")  # what never ends when it is read

    async def go() -> None:
        async with mcp.Client(build(Roots([root]), limit=0.05)) as client:
            late = await client.call_tool("contact", {"meshes": "box.stl", "out": "scene"})
            assert late.is_error
            assert "--minutes" in text(late)
        async with mcp.Client(build(Roots([root]))) as client:
            assert "neither a file nor a folder" in text(await client.call_tool("inspect", {"frames": "pipe.stl"}))
            monkeypatch.setattr(roots, "MOST_ENTRIES", 1)
            assert "too many files" in text(await client.call_tool("inspect", {"frames": "."}))

    asyncio.run(go())
    assert not (root / "scene").exists()
    assert not list(root.glob(".scene*"))


def test_folders_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (
        [],
        ["--root", str(tmp_path / "none")],
        ["--root", str(tmp_path), "--jobs", "0"],
        ["--root", str(tmp_path), "--minutes", "0"],
    ):
        assert main(["mcp", *arguments, "--json"]) == 2
        assert json.loads(capsys.readouterr().out)["error"] == "RealsimError"


def test_paths_lie_in_any_of_the_folders(tmp_path: Path) -> None:
    for name in ("a", "b", "ab"):
        (tmp_path / name).mkdir()
    roots = Roots([tmp_path / "a", tmp_path / "b"])
    assert roots.path("x") == tmp_path / "a" / "x"
    assert roots.path(str(tmp_path / "b" / "y")) == tmp_path / "b" / "y"
    for outside in ("..", "../ab", str(tmp_path / "ab" / "x"), "/"):
        with pytest.raises(RealsimError, match="leads out"):
            roots.path(outside)
    (tmp_path / "a" / "circle").symlink_to(tmp_path / "a" / "circle")
    with pytest.raises(RealsimError):
        roots.source("circle")
    (tmp_path / "a" / "circle").unlink()
    (tmp_path / "a" / "here").symlink_to(tmp_path / "a")
    assert roots.source("here") == tmp_path / "a", "a folder that holds itself comes to an end"
