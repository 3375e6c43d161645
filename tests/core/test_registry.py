"""A name that a registry does not have, and names that installed packages add."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from realsim.capture import LAYOUTS
from realsim.cli.command_line import main
from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from realsim.export import EXPORTERS

LAYOUT = """
from dataclasses import replace
from realsim.capture.layout import Recognition
from realsim.capture.layouts import plain

def recognise(folder):
    return Recognition(("mine.txt",), score=90) if (folder / "mine.txt").is_file() else Recognition()

def read(folder, config):
    return replace(plain.read(folder, config), layout="mine")

LAYOUT = replace(plain.LAYOUT, name="mine", looks_for="mine.txt", recognise=recognise, read=read)
"""
FORMAT = """
def corners(scene, folder):
    (folder / "corners.txt").write_text(str(len(scene.vertices)))
    return [folder / "corners.txt"]
"""
Install = Callable[[str, str, str], None]


@pytest.mark.parametrize("group", ["", "realsim.effects"])
def test_what_packages_may_add_is_looked_for_in_packages(group: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        Registry("effect", {"play": "nowhere:PLAY"}, group)["quadratic_drag"]
    assert ("realsim.effects" in str(caught.value)) == bool(group)
    assert "play" in str(caught.value)


@pytest.mark.parametrize(("name", "hint"), [("play,lag", "write them apart: play lag"), ("pley", "did you mean play?")])
def test_what_was_meant_is_said(name: str, hint: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        Registry("effect", {"play": "nowhere:PLAY", "lag": "nowhere:LAG"}, "realsim.effects")[name]
    assert caught.value.hint == hint


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Leaves a package with an entry point as pip would."""

    def installed(group: str, point: str, source: str) -> None:
        home = tmp_path / "site"
        (home / "mine-1.0.dist-info").mkdir(parents=True)
        (home / "mine-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
        (home / "mine-1.0.dist-info" / "entry_points.txt").write_text(f"[{group}]\n{point}\n")
        (home / "of_mine.py").write_text(source)
        monkeypatch.syspath_prepend(str(home))
        monkeypatch.delitem(sys.modules, "of_mine", raising=False)
        for registry in (LAYOUTS, EXPORTERS):
            monkeypatch.delitem(vars(registry), "_entries", raising=False)

    return installed


def answer(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> Mapping[str, object]:
    assert main([*map(str, arguments), "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_a_layout_comes_from_a_package(install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tests.capture.scene import walk
    from tests.capture.writers import write_plain

    install("realsim.layouts", "mine = of_mine:LAYOUT", LAYOUT)
    write_plain(tmp_path / "frames", walk(3))
    assert answer(capsys, "inspect", tmp_path / "frames")["layout"] == "plain"
    (tmp_path / "frames" / "mine.txt").touch()
    assert answer(capsys, "inspect", tmp_path / "frames")["layout"] == "mine"


def test_a_format_comes_from_a_package(install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import trimesh

    install("realsim.formats", "corners = of_mine:corners", FORMAT)
    trimesh.creation.box((1, 1, 0.2)).export(tmp_path / "box.stl")
    answer(capsys, "contact", tmp_path / "box.stl", "--contact-probes", "100", "--out", tmp_path / "scene")
    answer(capsys, "export", tmp_path / "scene", "--to", "corners", "--out", tmp_path / "out")
    assert int((tmp_path / "out" / "corners" / "corners.txt").read_text()) >= 8


@pytest.mark.parametrize("source", ["LAYOUT = 3", "", "import nothing_of_that_name"])
def test_a_package_without_what_it_promises_is_named(
    source: str, install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install("realsim.layouts", "mine = of_mine:LAYOUT", source)
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "a.txt").touch()
    assert main(["inspect", str(tmp_path / "frames")]) == 2
    assert "of_mine:LAYOUT" in capsys.readouterr().err
