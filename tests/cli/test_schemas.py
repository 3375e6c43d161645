"""Schemas of what commands print: there for every command, valid, and true of real outputs.

Outputs of the other tests are held to them too (tests/outputs.py).
"""

import json
from pathlib import Path

import pytest
import trimesh
from jsonschema import Draft202012Validator

from realsim.cli import schemas
from realsim.cli.command_line import main
from realsim.cli.table import commands
from tests import outputs
from tests.gap.truth import ARM, Truth, make_case


@pytest.mark.parametrize("command", sorted(commands()))
def test_every_command_has_a_schema_that_can_be_printed(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    schema = schemas.load(command, commands()[command].package)
    assert schema is not None, f"write schemas/{command}.json"
    Draft202012Validator.check_schema(schema)
    for output in schema["anyOf"]:
        assert "$ref" in output or set(output["required"]) <= set(output["properties"])
    capsys.readouterr()
    assert main(["schema", command]) == 0
    assert json.loads(capsys.readouterr().out) == schema
    assert said(capsys, "schema", command)["json_schema"] == schema


def said(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict:
    """What a command prints, checked against its schema."""
    capsys.readouterr()
    assert main([*map(str, arguments), "--json"]) == code
    data = json.loads(capsys.readouterr().out)
    command = str(arguments[0])
    validator = Draft202012Validator(schemas.load(command, commands()[command].package) or {})
    assert list(validator.iter_errors(data)) == []
    return data


def test_an_error_is_what_any_command_may_print(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("inspect", "reconstruct", "contact", "export", "diagnose", "log", "schema"):
        data = said(capsys, command, tmp_path / "none", code=2)
        assert data["schema"] == schemas.ERROR
    unknown = said(capsys, "inspect", "x", "--no-such-option", code=2)
    assert unknown["error"] == "UsageError"
    assert "--no-such-option" in unknown["message"]
    few = said(capsys, "reconstruct", "x", "--max-triangles", "1", code=2)
    assert few["message"] == "--max-triangles must be at least 100, found 1"


def test_the_list_names_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(said(capsys, "schema")["schemas"]) == set(commands())


@pytest.mark.slow
def test_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box((0.6, 0.4, 0.3)).export(tmp_path / "a.stl")
    (tmp_path / "empty.stl").write_text("solid nothing\nendsolid nothing\n")
    meshes = (tmp_path / "a.stl", tmp_path / "empty.stl")
    quick = ("--contact-probes", 100, "--contact", "hull")
    two = said(capsys, "contact", *meshes, "--out", tmp_path / "ab", *quick, code=1)
    assert [item["result"]["schema"] for item in two["items"]] == ["realsim.contact/1", schemas.ERROR]
    assert said(capsys, "export", tmp_path / "ab" / "a.stl", "--to", "obj,mjcf")["formats"]["obj"]


def test_diagnoses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_case(tmp_path / "case", ARM, Truth(), runs=3, seed=1, span=(1.0, 1.2))
    quick = ("--effects", "viscous_friction", "--max-causes", 1, "--bootstrap", 20, "--no-report")
    assert said(capsys, "diagnose", tmp_path / "case", "--out", tmp_path / "out", *quick)["verdict"]
    assert said(capsys, "diagnose", tmp_path / "case", "--check")["runs"]
    assert said(capsys, "diagnose", tmp_path / "case", tmp_path / "none", "--check", code=1)["failed"] == 1
    assert said(capsys, "diagnose", "--explain", "viscous_friction")["text"]
    (tmp_path / "model.xml").write_text(ARM)
    assert said(capsys, "diagnose", "--init", tmp_path / "model.xml", "--out", tmp_path / "new")["case"]


def test_captures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = said(capsys, "synth", "--out", tmp_path / "synth", "--frames", 2, "--width", 80)
    assert said(capsys, "inspect", made["capture"])["layout"]


def test_a_viewer_that_is_closed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    monkeypatch.setattr("realsim.report.live.view", lambda scene, port: None)
    assert said(capsys, "view", "scene") == {"schema": "realsim.view/1"}


def test_what_the_schema_does_not_know_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AssertionError, match="does not know \\['more'\\]"):
        outputs.check("synth", {"capture": "a", "truth": "b", "more": 1})
    with pytest.raises(AssertionError, match="'truth' is a required property"):
        outputs.check("synth", {"capture": "a"})
