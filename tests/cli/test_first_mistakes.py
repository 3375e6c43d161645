"""What people do first and wrong: each gets a message with a way out."""

import ast
import json
from pathlib import Path

import pytest
import trimesh

import realsim as rs
from realsim.cli.command_line import main
from realsim.cli.commands import diagnose
from realsim.core import errors
from realsim.core.recognise import KINDS, explain_inputs, recognise, whole
from tests.gap.truth import ARM

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one of everything, and the shell in it."""
    monkeypatch.chdir(tmp_path)
    table = "time,shoulder,elbow\n" + "".join(f"{i / 100},{i},{-i}\n" for i in range(50))
    folders = "logs case/runs frames/depth frames/color stairs_contact scene tuned nothing many"
    for name in folders.split():
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "logs" / "run_1.csv").write_text(table)
    (tmp_path / "run.csv").write_text(table)
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "robot.xml").write_text(ARM)
    (tmp_path / "robot.urdf").write_text("<?xml version='1.0'?>\n<robot name='r'><link name='a'/></robot>")
    (tmp_path / "case" / "log.json").write_text("{}")
    (tmp_path / "case" / "model.xml").write_text(ARM)
    for kind in ("depth", "color"):
        (tmp_path / "frames" / kind / "000000.png").write_bytes(b"\x89PNG")
    box = trimesh.creation.box((1, 1, 1))
    box.export(tmp_path / "stairs.stl")
    box.export(tmp_path / "scan.ply")
    box.export(tmp_path / "many" / "a.stl")
    for folder, mark in (("stairs_contact", "contact.json"), ("scene", "report.json")):
        (tmp_path / folder / "scene.xml").write_text("<mujoco/>")
        (tmp_path / folder / mark).write_text("{}")
    (tmp_path / "tuned" / "history.jsonl").write_text("{}\n")
    (tmp_path / "tuned" / "policy.pt").write_bytes(b"PK\x03\x04")
    (tmp_path / "policy.onnx").write_bytes(b"\x08\x07")
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0 ftyp")
    (tmp_path / "scan.zip").write_bytes(b"PK\x03\x04")
    (tmp_path / "stairs.step").write_text("ISO-10303-21;")
    return tmp_path


MISTAKES = {
    "diagnose logs --out d": "realsim log logs --model",
    "diagnose run.csv --out d": "realsim log run.csv --model",
    "diagnose robot.xml --out d": "realsim diagnose --init robot.xml",
    "diagnose frames --out d": "realsim reconstruct frames",
    "diagnose scene --out d": "realsim view scene",
    "diagnose run.csv --model stairs.stl --out d": "realsim contact stairs.stl",
    "diagnose case --model robot.xml --out d": "leave out --model",
    "doctor run.csv --policy stairs.stl": "realsim log run.csv --model",
    "diagnose case --deploy-yaml robot.xml --out d": "add --policy",
    "demo --out run.csv": "choose another --out",
    "reconstruct --out s": "realsim help reconstruct",
    "diagnose cas --out d": "did you mean case",
    "log robot.xml": "realsim log RECORDING --model robot.xml",
    "log case": "realsim diagnose case",
    "log frames": "realsim reconstruct frames",
    "log run.csv --model stairs.stl --out c": "realsim contact stairs.stl",
    "reconstruct walk.mp4 --out s": "depth",
    "reconstruct scan.zip --out s": "unpack scan.zip",
    "reconstruct case --out s": "realsim diagnose case",
    "reconstruct logs --out s": "realsim log logs",
    "reconstruct stairs.step --out s": ".glb, .obj or .stl",
    "reconstruct nothing --out s": "nothing is in nothing",
    "inspect robot.urdf": "robot.urdf",
    "inspect frame": "did you mean frames",
    "contact frames --out c": "realsim reconstruct frames",
    "contact stairs.step --out c": ".glb, .obj or .stl",
    "contact many --out c": "many/*",
    "contact stairs.stl --out run.csv": "choose another --out",
    "deploy tuned/policy.pt": "policy.onnx beside it",
    "training report": "realsim help finetune",
    "mcp": "realsim mcp --root",
    "contact robot.xml --out c": "realsim diagnose --init robot.xml",
    "contact stairs.stl --robot unitree_go2 --out c": "menagerie:unitree_go2",
    "export stairs.stl --to usd": "realsim contact stairs.stl",
    "export case --to usd": "realsim diagnose case",
    "excite scene --out e": "realsim view scene",
    "footholds frames --out f": "realsim reconstruct frames",
    "model inspect robot.xml": "--init robot.xml",
    "view stairs.stl": "realsim contact stairs.stl",
    "demo --robot go1 --out d": "menagerie:go1",
    "diagnos case": "did you mean diagnose",
    "contact stairs.stl --tolerance 1": "did you mean --contact-tolerance",
    "contact https://example.org/a.stl --out c": "download it first",
    "diagnose --check": "realsim diagnose CASE --check",
    "export scene --to gazebo": "Gazebo: sdf",
    "export scene": "--to usd,urdf",
    "export nothing --to foo": "did you mean foxglove",
    "export zzzz --to usd": "check the path",
    "lint policy.onnx": "realsim model inspect policy.onnx",
    "log stairs.step": ".glb, .obj or .stl",
    "reconstruct frame logs --out s": "did you mean frames",
    "reconstruct frames --start 1,2 --out s": "--start 1 2",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_first_mistake_has_a_way_out(line: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(place.rglob("*"))
    assert main([*line.split(), "--json"]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert MISTAKES[line] in answer["hint"], answer
    assert sorted(place.rglob("*")) == before, "nothing half-written"
    assert main(line.split()) == 2
    assert "\n  do: " in capsys.readouterr().err


def test_an_empty_argument_is_not_the_folder_that_one_is_in(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", "", "--out", "d"]) == 2
    assert "variable of the shell" in capsys.readouterr().err


@pytest.mark.parametrize("line", ["finetune stairs_contact --out t", "evaluate stairs_contact --policy p.pt"])
def test_a_contact_folder_is_no_scene_to_walk_in(line: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    assert main([*line.split(), "--json"]) == 2
    assert "realsim reconstruct MESH" in json.loads(capsys.readouterr().out)["hint"]


def test_the_same_from_python(place: Path) -> None:
    for call, hint in (
        (lambda: rs.diagnose("logs"), "realsim log logs"),
        (lambda: rs.load_case("frames"), "realsim reconstruct frames"),
        (lambda: rs.load_scene("stairs.stl"), "realsim contact stairs.stl"),
        (lambda: rs.contact("case", "c"), "realsim diagnose case"),
        (lambda: rs.inspect("robot.xml"), "--init robot.xml"),
    ):
        with pytest.raises(rs.RealsimError) as caught:
            call()
        assert hint in str(caught.value)


def test_kinds_of_everything(place: Path) -> None:
    kinds = {p.name: kind.name for p in sorted(place.iterdir()) if (kind := recognise(p)) is not None}
    assert kinds == {
        "case": "case", "frames": "capture", "logs": "recording", "many": "mesh", "nothing": "empty folder",
        "policy.onnx": "network",
        "robot.urdf": "model", "robot.xml": "model", "run.csv": "recording", "run.mcap": "bag", "scan.ply": "scan",
        "scan.zip": "archive", "scene": "scene", "stairs.step": "CAD file", "stairs.stl": "mesh",
        "stairs_contact": "contact scene", "tuned": "training run", "walk.mp4": "video",
    }  # fmt: skip
    assert recognise(place / "absent") is None
    assert recognise(place / "scene" / "scene.xml") is KINDS["scene"]
    assert whole(place / "scene" / "scene.xml") == place / "scene"
    assert whole(place / "robot.xml") == place / "robot.xml"


def test_every_error_says_what_to_do() -> None:
    """An error of a kind that has no way out of its own gives one itself, or what was expected."""
    usual = {name for name, kind in vars(errors).items() if isinstance(kind, type) and "usual_hint" in vars(kind)}
    assert {"CaptureError", "GapError", "ExportError", "ModelError", "MeshError"} <= usual
    for package in ("realsim", "trainer"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if "RealsimError(" in text else ():
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "RealsimError":
                    given = {keyword.arg for keyword in node.keywords}
                    assert given & {"hint", "expected", None}, f"{path.relative_to(ROOT)}:{node.lineno}"


@pytest.mark.parametrize("kind", [errors.RealsimError, errors.CaptureError, errors.GapError, errors.ExportError])
def test_what_is_shown_always_says_what_to_do(kind: type[errors.RealsimError]) -> None:
    error = kind("wrong", file="x")
    assert "\n  do: " in error.render()
    assert error.as_dict()["hint"]
    assert "do:" not in str(error), "in a note about one of many, it would be noise"


def test_a_recording_with_its_model_is_no_mistake(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is wrong is inside it: the error keeps its words, and names the recording and the model."""
    monkeypatch.setattr(diagnose, "from_recording", lambda recording, model, case: case)

    def used(cases: Path, model: Path | None) -> None:
        with diagnose.case_for_now(cases, model or Path("robot.xml")) as case:
            raise errors.RealsimError("no gyroscope", file=case, expected="imu_gyro", hint=f"see {case / 'model.xml'}")

    run = Path("run.csv")
    with pytest.raises(errors.RealsimError) as raised:
        explain_inputs(used)(run, model=Path("robot.xml"))
    assert (raised.value.file, raised.value.found, raised.value.hint) == ("run.csv", None, "see robot.xml")
    with pytest.raises(errors.RealsimError) as raised:
        explain_inputs(used)(run, model=None)
    assert "realsim log run.csv" in str(raised.value.hint)


@pytest.mark.parametrize("command", ["diagnose run.csv --check", "doctor run.csv --policy policy.onnx"])
def test_a_recording_without_its_model_asks_for_it(
    place: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main(command.split()) == 2
    assert "--model" in capsys.readouterr().err
