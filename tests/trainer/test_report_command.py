"""`realsim training report` from the command line, on a run of the trainer itself."""

import json
from pathlib import Path

import pytest

from realsim.cli.command_line import main
from tests import pages
from tests.trainer import histories
from trainer.report import read_runs, replays


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two iterations of the quadruped on flat ground."""
    folder = tmp_path_factory.mktemp("report")
    task = {"depth": {"use": False}, "termination": {"seconds": 0.4}, "randomisation": {"terrain_variants": 1}}
    (folder / "task.json").write_text(json.dumps(task))
    arguments = ["pretrain", "--robot", "quadruped", "--terrain", "flat", "--iterations", "2", "--actor", "16"]
    arguments += [
        "--critic",
        "16",
        "--worlds",
        "8",
        "--threads",
        "1",
        "--steps",
        "24",
        "--epochs",
        "1",
        "--device",
        "cpu",
    ]
    arguments += ["--trials", "4", "--evaluate-every", "1", "--evaluate-share", "1", "--no-tensorboard"]
    arguments += ["--task-file", str(folder / "task.json"), "--out", str(folder / "run")]
    assert main(arguments) == 0
    return folder / "run"


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, str]:
    assert main(["training", "report", *arguments, "--json"]) == 2
    return json.loads(capsys.readouterr().out)


def test_a_run_of_the_trainer(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    evaluation = ["evaluate", "flat", "--policy", str(run / "policy.pt"), "--trials", "3", "--device", "cpu"]
    evaluation += ["--task-file", str(run.parent / "task.json"), "--out", str(run / "evaluation_flat.json")]
    assert main(evaluation) == 0
    capsys.readouterr()
    out = tmp_path / "page.html"
    assert main(["training", "report", str(run), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["runs"][0]
    assert (said["iterations"], said["samples"]) == (2, 2 * 24 * 8)
    assert [at for at, _ in said["evaluations_on_the_way"]] == [0, 1, 2]
    assert said["notes"] == []
    text = pages.read(out.read_text())
    assert "evaluation_flat" in text
    assert "0.0 % of 3 succeed" in text


def test_rendered_trials(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def video(recording, robot, terrain, path, **_):
        drawn.append(recording.qpos[0])
        path.write_bytes(b"GIF89a")
        return path

    monkeypatch.setattr(replays, "video", video)  # drawing is tested with `play`; it needs OpenGL
    found = replays.replays(_runs(run), "flat", 2, run.parent / "task.json")
    again = replays.replays(_runs(run), "flat", 2, run.parent / "task.json")
    assert [(r.trial, r.outcome, r.seconds) for r in found] == [(r.trial, r.outcome, r.seconds) for r in again]
    assert (drawn[0] == drawn[2]).all()
    assert (drawn[0] != drawn[1]).any()
    html = replays.replay_card(found, "flat")
    assert html.count("data:image/gif;base64,R0lGODlh") == 2


def _runs(*folders: Path):
    return read_runs(folders)


def test_bad_input_is_said(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    good, out = str(run), str(tmp_path / "page.html")
    assert failure(capsys)["message"] == "no run was named"
    assert failure(capsys, good, "--out", str(run / "history.jsonl"))["message"] == "the page is HTML"
    assert failure(capsys, good, "--out", out, "--trials", "2")["expected"] == "--trials N --scene NAME, or neither"
    assert failure(capsys, good, "--out", out, "--scene", "flat")["expected"] == "--trials N --scene NAME, or neither"
    assert failure(capsys, good, "--out", out, "--scene", "flat", "--trials", "99")["found"] == "--trials 99"
    assert failure(capsys, good, str(tmp_path), "--out", out)["file"] == str(tmp_path)
    bare = histories.run(tmp_path / "bare", 1)
    said = failure(capsys, str(bare), "--out", out, "--scene", "flat", "--trials", "1")
    assert said["file"] == str(bare / "policy.pt")
    (tmp_path / "page.html").mkdir()
    assert failure(capsys, good, "--out", out)["message"] == "the output is a folder"
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]
