"""Options from a report or a preset."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from realsim.cli.command_line import main
from realsim.cli.commands.contact import contact
from realsim.cli.commands.inspect import inspect
from realsim.cli.commands.reconstruct import reconstruct
from realsim.cli.options import parse
from realsim.cli.saved import PRESETS, defaults_of
from realsim.core.errors import RealsimError
from realsim.core.files import to_json
from realsim.pipeline import ReconstructConfig, config_as_dict


def test_what_a_report_holds_comes_back(tmp_path: Path) -> None:
    config = ReconstructConfig(seed=3, compare=True, overwrite=True)
    config = replace(
        config,
        capture=replace(config.capture, max_depth=4.0, depth_unit=0.001),
        scene=replace(config.scene, robot="g1", contact_tolerance=(0.01, 0.02)),
        align=replace(config.align, start=(1.0, 2.0), start_pixel=("a.png", 3, 4)),
    ).seeded()
    file = tmp_path / "report.json"
    file.write_text(to_json({"config": config_as_dict(config), "verdict": {}}))
    found = defaults_of(reconstruct, str(file), None)["config"]
    assert found == replace(config, overwrite=False), "an output is replaced only when that is typed"
    assert defaults_of(reconstruct, str(tmp_path), None)["config"] == found, "a scene's folder is enough"
    assert defaults_of(inspect, str(file), None)["config"] == config.capture
    assert defaults_of(contact, str(file), None)["config"] == config.scene


def test_what_is_typed_wins(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    file.write_text('{"seed": 5, "capture": {"every": 2}}')
    defaults = defaults_of(reconstruct, str(file), "room")
    call = parse(reconstruct, "reconstruct", ["a", "--seed", "7"], defaults)
    config = call.keywords["config"]
    assert (config.seed, config.capture.every, config.align.keep) == (7, 2, "all")
    assert call.keywords["frames"] == (Path("a"),)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_valid(name: str) -> None:
    config = defaults_of(reconstruct, None, name)["config"]
    assert config != ReconstructConfig() or name == "parkour"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"config": {"captur": {}}}', "unknown option captur"),
        ('{"capture": {"every": "two"}}', "capture.every has another kind of value"),
        ('{"capture": {"every": true}}', "capture.every has another kind of value"),
        ('{"capture": {"every": 0}}', "every must be at least 1"),
        ('{"capture": 3}', "capture has another kind of value"),
        ('{"points": {"poses": "maybe"}}', "points.poses has another kind of value"),
        ("[1]", "no configuration"),
        ("{}", "no configuration"),
        ("{", "broken JSON"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(RealsimError, match=message):
        defaults_of(reconstruct, str(file), None)


def test_an_option_without_its_section_is_told_where_it_goes(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    file.write_text('{"max_frames": 9}')
    with pytest.raises(RealsimError) as caught:
        defaults_of(reconstruct, str(file), None)
    assert caught.value.hint == 'write {"capture": {"max_frames": ...}}'


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "deep.json").write_text('{"capture": {"min_depth": 2.0}}')
    for arguments, message in (
        (["inspect", "x", "--config", str(tmp_path / "deep.json"), "--max-depth", "1"], "--min-depth < --max-depth"),
        (["inspect", "x", "--preset", "phon"], "unknown preset"),
        (["inspect", "x", "--preset", "stairs"], "says nothing"),
        (["view", "x", "--preset", "room"], "takes no --config"),
        (["reconstruct", "x", "--config"], "--config lacks a value"),
        (["reconstruct", "x", "--config", str(tmp_path / "none.json")], "cannot be read"),
    ):
        assert main([*arguments, "--json"]) == 2
        answer = json.loads(capsys.readouterr().out)
        assert message in answer["message"]
        assert answer["hint"]
