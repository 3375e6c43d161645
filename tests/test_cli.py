"""The command line: help, exit codes, errors for people and for machines."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from realsim.cli import COMMANDS, SUMMARIES, main
from realsim.commands import other_arguments, set_arguments


def test_every_command_has_a_summary_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(COMMANDS) == set(SUMMARIES)
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS:
        assert name in text
        assert main([name, "--help"]) == 0
        assert f"realsim {name}" in capsys.readouterr().out


def test_unknown_command_names_the_closest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstuct"]) == 2
    assert "did you mean reconstruct" in capsys.readouterr().err


def test_missing_folder_is_exit_code_2_without_a_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruct", str(tmp_path / "none"), "--out", str(tmp_path / "scene")]) == 2
    error = capsys.readouterr().err
    assert "none" in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_errors_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path / "none"), "--json"]) == 2
    said = json.loads(capsys.readouterr().out)
    assert said["error"].endswith("Error")
    assert said["message"]


def test_values_that_do_not_fit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path), "--min-depth", "7"]) == 2
    assert "min_depth < max_depth" in capsys.readouterr().err


def test_arguments_of_an_item_are_the_commands_less_its_own() -> None:
    set_arguments(["a", "--out", "x", "--jobs=2", "--seed", "3", "b", "--robot", "g1"])
    assert other_arguments({"--out": 1, "--jobs": 1}, ["a", "b"]) == ("--seed", "3", "--robot", "g1")


def test_packages_add_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A lone module as well as a module of a package; both say in SUMMARIES what they add."""
    source = """
from realsim.commands import CommandResult
SUMMARIES = {"NAME": "what NAME does"}
def run(times: int = 2) -> CommandResult:
    return CommandResult("NAME " * times)
"""
    (tmp_path / "pack").mkdir()
    (tmp_path / "lone.py").write_text(source.replace("NAME", "alone"))
    (tmp_path / "pack" / "__init__.py").write_text('SUMMARIES = {"packed": "what packed does"}')
    (tmp_path / "pack" / "inner.py").write_text(source.replace("NAME", "packed"))
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("alone", "lone:run", "realsim.commands"), EntryPoint("packed", "pack.inner:run", "")]
    monkeypatch.setattr("realsim.cli.entry_points", lambda group: points)
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    for name in ("alone", "packed"):
        assert f"what {name} does" in said
        assert main([name, "--times", "3"]) == 0
        assert capsys.readouterr().out.split() == [name] * 3
