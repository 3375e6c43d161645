"""The commands, end to end on the quadruped: pretrain, fine-tune, evaluate, deploy."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from realsim.cli.command_line import main
from realsim.cli.help import usage
from realsim.cli.table import commands
from realsim.core.errors import RealsimError
from trainer import robots
from trainer.commands import COMMANDS
from trainer.commands.common import find_terrain
from trainer.commands.task_file import load_task
from trainer.errors import TrainerError
from trainer.ppo import checkpoint, export
from trainer.ppo.config import NetworkConfig, PPOConfig
from trainer.ppo.loop import LoopConfig
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import (
    DepthConfig,
    RandomisationConfig,
    ResetConfig,
    RewardConfig,
    TerminationConfig,
)
from trainer.terrain import generate
from trainer.terrain.widen import LADDER
from trainer.trainers import Scene, TrainConfig, ppo
from trainer.trainers.ladder import ALONG, HELP_BELOW, WAITING, helped

SMALL = [
    "--worlds", "16", "--threads", "1", "--evaluate-every", "0", "--steps", "8", "--epochs", "2",
    "--no-tensorboard", "--device", "cpu",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A base policy of the quadruped after two iterations on flat ground, with a small camera stack."""
    folder = tmp_path_factory.mktemp("commands")
    task = {"depth": {"frames": 2}, "termination": {"seconds": 1.0}, "randomisation": {"terrain_variants": 1}}
    (folder / "task.json").write_text(json.dumps(task))
    arguments = ["pretrain", "--robot", "quadruped", "--terrain", "flat", "--iterations", "2", "--actor", "32"]
    arguments += ["--critic", "32", "--task-file", str(folder / "task.json"), "--out", str(folder / "base"), *SMALL]
    assert main(arguments) == 0
    return folder


def test_commands_of_the_trainer_are_found_without_importing_it() -> None:
    assert set(COMMANDS) <= set(commands())
    assert all(command.summary in usage() for command in COMMANDS.values())


@pytest.mark.slow
def test_smoke_fine_tune(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two iterations of adapters on a small course: figures before and after, a checkpoint, an ONNX policy."""
    out = folder / "tuned"
    arguments = ["finetune", "boxes:0.2:1", "--policy", str(folder / "base" / "policy.pt"), "--strategy", "adapter"]
    arguments += ["--iterations", "2", "--final-trials", "4", "--task-file", str(folder / "task.json")]
    assert main([*arguments, "--out", str(out), "--json", *SMALL]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["before"]["terrains"][0]["trials"] == said["after"]["terrains"][0]["trials"] == 4
    assert said["helped"] is (said["before"]["terrains"][0]["rate"] < HELP_BELOW)
    # Two iterations gain nothing in four trials: the base is delivered, with a reason and advice; the run can go on.
    assert said["verdict"]["delivered"] == "base"
    assert said["verdict"]["advice"]
    delivered, latest = (checkpoint.load(out / "policy.pt", latest=late) for late in (False, True))
    assert (delivered[0].tuned, latest[0].tuned[-1][0]) == ((), "adapter")
    assert latest[1] is not None
    assert {"policy.pt", "policy.onnx", "history.jsonl", "result.json"} <= {p.name for p in out.iterdir()}
    assert main(["deploy", str(out / "policy.onnx"), "--scene", "boxes:0.2:1", "--seconds", "0.2", "--json"]) == 0
    deployed = json.loads(capsys.readouterr().out)
    assert deployed["steps"] >= 1
    assert deployed["inference_ms"]["p50"] > 0
    assert export.load(out / "policy.onnx")[1].action_limit == ParkourConfig().action_limit
    replay = ["play", "boxes:0.2:1", "--policy", str(out / "policy.pt"), "--task-file", str(folder / "task.json")]
    assert main([*replay, "--out", str(out / "trial.glb"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["replay"] == str(out / "trial.glb")
    assert "output file exists" in failure(capsys, *replay, "--out", str(out / "trial.glb"))["message"]
    evaluation = str(out / "evaluation.json")
    ends = []
    for kind in ("pt", "onnx"):  # what the robot runs is judged alike
        arguments = ["evaluate", "boxes:0.2:1", "--policy", str(out / f"policy.{kind}"), "--trials", "3"]
        arguments += ["--device", "cpu", "--task-file", str(folder / "task.json"), "--out", evaluation, "--overwrite"]
        assert main(arguments) == 0
        assert "of 3" in capsys.readouterr().out
        ends.append(json.loads(Path(evaluation).read_text())["terrains"])
    assert ends[0][0]["trials"] == 3
    assert [f["cause"] for f in ends[0][0]["failures"]] == [f["cause"] for f in ends[1][0]["failures"]]
    body = robots.named("quadruped")
    with pytest.raises(TrainerError, match="another kp"):
        export.as_policy(out / "policy.onnx", lambda *_: replace(body, kp=2 * body.kp))


def test_help_for_a_first_success_leaves_the_users_own_settings() -> None:
    scene = Scene((find_terrain("beams:0.9:1")[0],))
    lands, task = helped(scene, ParkourConfig())
    assert (lands.rows, lands.judged, lands.goals) == (len(LADDER), scene.terrains, scene.terrains)
    assert lands.terrains[-1] is scene.terrains[0]
    assert (task.reset.along, task.reward.weights) == (ALONG, {"dont_wait": WAITING})
    own = ParkourConfig(reset=ResetConfig(along=0.1, keep_last=0.5), reward=RewardConfig(weights={"dont_wait": -1.0}))
    assert helped(scene, own)[1] == own


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, str]:
    assert main([*arguments, "--json"]) == 2
    return json.loads(capsys.readouterr().out)


def test_a_run_that_was_interrupted_before_its_first_checkpoint_leaves_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        (tmp_path / "run" / "history.jsonl").write_text("")
        (tmp_path / "run" / "events").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr("trainer.commands.finetune.find", lambda _: interrupted)
    policy = str(folder / "base" / "policy.pt")
    out = tmp_path / "run"
    assert main(["finetune", "flat", "--policy", policy, "--out", str(out), "--final-trials", "0", *SMALL]) == 130
    assert not out.exists()
    assert "nothing half-written is left\n" in capsys.readouterr().err  # no stage is kept, and none is promised


def test_training_does_not_begin_on_a_full_disk(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1e6))
    policy, out = str(folder / "base" / "policy.pt"), tmp_path / "run"
    for command in (["finetune", "flat", "--policy", policy], ["pretrain", "--terrain", "flat"]):
        said = failure(capsys, *command, "--out", str(out), *SMALL)
        assert (said["expected"], said["found"], said["file"]) == ("50 MB free", "1 MB", str(out))
    assert not out.exists()


def test_a_policy_of_another_layout_or_robot_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = str(folder / "base" / "policy.pt")
    said = failure(capsys, "finetune", "flat", "--policy", policy, "--final-trials", "0", *SMALL)
    assert "depth stack" in said["message"]
    assert said["file"] == policy
    said = failure(capsys, "finetune", "flat", "--policy", policy, "--robot", "g1", "--final-trials", "0", *SMALL)
    assert (said["expected"], said["found"]) == ("g1", "quadruped")
    exported = str(folder / "base" / "policy.onnx")
    said = failure(capsys, "finetune", "flat", "--policy", exported, "--final-trials", "0", *SMALL)
    assert "needs the checkpoint" in said["message"]


def test_what_cannot_be_done_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert failure(capsys, "finetune", "flat", "--robot", "go7")["expected"].startswith("one of g1")
    assert "--from-scratch" in failure(capsys, "finetune", "flat", "--policy", "x.pt", "--from-scratch")["expected"]
    assert "unknown strategy" in failure(
        capsys, "finetune", "flat", "--policy", str(folder / "base" / "policy.pt"), "--strategy", "lora",
        "--task-file", str(folder / "task.json"), "--final-trials", "1000000", *SMALL,
    )["message"]  # fmt: skip
    assert "no such scene" in failure(capsys, "pretrain", "--terrain", "./nowhere")["message"]
    assert "unknown trainer" in failure(capsys, "pretrain", "--terrain", "flat", "--trainer", "sac")["message"]
    base = ["finetune", "flat", "--policy", str(folder / "base" / "policy.pt"), *SMALL]
    assert failure(capsys, *base, "--device", "gpu")["found"] == "--device gpu"
    for noise in ("0", "-1", "nan"):
        assert failure(capsys, *base, "--start-std", noise)["message"] == "start_std must be above 0"
    assert failure(capsys, "deploy", "policy.onnx", "--max-step", "-1")["message"] == "max_step must be above 0"
    assert failure(capsys, "pretrain", "--gamma", "1.5")["message"] == "gamma must be at most 1"
    assert failure(capsys, *base, "--minibatches", "129")["found"] == "--minibatches 129"
    few = ["pretrain", "--terrain", "flat", "--device", "cpu", "--minibatches", str(24 * 64 + 1)]
    assert "more minibatches than samples" in failure(capsys, *few)["message"]
    short = folder / "short.json"
    short.write_text('{"depth": {"frames": 2}, "termination": {"seconds": 0.005}}')
    assert "shorter than a policy step" in failure(capsys, *base, "--task-file", str(short))["message"]
    if not torch.cuda.is_available():
        assert "no CUDA device" in failure(capsys, "pretrain", "--terrain", "flat", "--device", "cuda")["message"]


def test_a_resume_with_another_strategy_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = str(folder / "base" / "policy.pt")
    arguments = ["finetune", "flat", "--resume", base, "--task-file", str(folder / "task.json"), *SMALL]
    said = failure(capsys, *arguments, "--final-trials", "0", "--strategy", "adapter")
    assert (said["file"], said["expected"], said["found"]) == (base, "--strategy adapter", "full")


def test_a_resume_that_is_refused_leaves_the_run_as_it_was(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "result.json").write_text('{"after": null}')
    (run / "history.jsonl").write_text("{}\n")
    arguments = ["finetune", "flat", "--task-file", str(folder / "task.json"), "--out", str(run), *SMALL]
    nothing, other = run / "nothing.pt", folder / "base" / "policy.pt"
    for resumed, message in ((nothing, "cannot be read"), (other, "exists")):
        assert message in failure(capsys, *arguments, "--resume", str(resumed))["message"]
        assert (run / "result.json").read_text() == '{"after": null}'
        assert (run / "history.jsonl").is_file()


def test_a_checkpoint_that_was_edited_is_refused_before_anything_is_written(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = torch.load(folder / "base" / "policy.pt", weights_only=True)
    common = ["--task-file", str(folder / "task.json"), "--out", str(tmp_path / "out"), "--final-trials", "0", *SMALL]
    file = str(tmp_path / "edited.pt")
    less = {name: value for name, value in whole["training"].items() if name != "ppo"}
    for changed, option, message in (
        ({"robot": "spot"}, "--policy", "unknown robot 'spot'"),
        ({"training": less}, "--resume", "cannot resume training"),
        ({"training": None}, "--resume", "no training state"),
    ):
        torch.save({**whole, **changed}, file)
        said = failure(capsys, "finetune", "flat", option, file, *common)
        assert message in said["message"]
        assert said["file"] == file
        assert not (tmp_path / "out").exists()


def test_task_files(tmp_path: Path) -> None:
    path = tmp_path / "task.json"
    path.write_text('{"command": {"speed": 0.5}, "depth": {"latency": [1, 3]}, "self_collision": true}')
    task = load_task(path)
    assert (task.command.speed, task.depth.latency, task.self_collision) == ((0.5, 0.5), (1, 3), True)
    for text, message in (
        ('{"comand": {}}', "unknown task field"),
        ('{"depth": {"use": "no"}}', "depth.use has a value of the wrong kind"),
        ("[]", "must be an object"),
        ('{"depth": {"frames": 0}}', "frames must be at least 1"),
        ('{"reward": {"weights": {"alive": "much"}}}', "reward.weights.alive has a value of the wrong kind"),
    ):
        path.write_text(text)
        with pytest.raises(RealsimError, match=message) as error:
            load_task(path)
        assert error.value.file == str(path)


def test_scenes_by_name(tmp_path: Path) -> None:
    assert find_terrain("stake1")[0].name == "stake1"
    assert find_terrain("beams:0.3:7")[0].family == "beams"
    assert find_terrain("flat")[0].ground_fails is False
    for name, message in (("stakes9", "unknown scene"), ("boxes:x", "not a terrain"), (str(tmp_path), "not a reconst")):
        with pytest.raises(RealsimError, match=message):
            find_terrain(name)


def test_too_little_memory_means_fewer_worlds_and_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ppo, "write_onnx", lambda *_: None)
    start, asked = ppo.start, []

    def short_of_memory(scene, file, plan, rank):
        asked.append(plan.worlds)
        if plan.worlds > 16:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return start(scene, file, plan, rank)

    monkeypatch.setattr(ppo, "start", short_of_memory)
    arguments = ["pretrain", "--robot", "quadruped", "--terrain", "flat", "--iterations", "1", "--actor", "16"]
    arguments += ["--task-file", str(folder / "task.json"), "--out", str(folder / "oom"), "--overwrite", *SMALL[2:]]
    assert main([*arguments, "--worlds", "64"]) == 0
    assert asked == [64, 32, 16]
    assert "16 worlds instead of 32" in capsys.readouterr().out
    said = failure(capsys, *arguments, "--worlds", "31")
    assert "memory is not enough" in said["message"]


def test_resume_is_exact_in_the_real_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Physics, randomisation, curriculum, camera: four iterations are two, a restart, and two, bit for bit."""
    monkeypatch.setattr(ppo, "write_onnx", lambda *_: None)
    task = ParkourConfig(
        depth=DepthConfig(frames=2),
        termination=TerminationConfig(seconds=0.3),
        randomisation=RandomisationConfig(terrain_variants=2),
        self_collision=True,
    )
    networks = NetworkConfig(channels=(8,), latent=8, actor=(16,), critic=(16,))
    config = TrainConfig(
        robot="quadruped", worlds=6, threads=1, device="cpu", ppo=PPOConfig(steps=8, networks=networks), task=task,
        loop=LoopConfig(
            iterations=4, checkpoint_every=2, evaluate_every=0, tensorboard=False, restart_at_checkpoint=True
        ),
    )  # fmt: skip
    scene = Scene((generate("boxes", 0.2, 1), generate("boxes", 0.4, 1)), rows=2)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    ppo.train(scene, None, config, whole)
    ppo.train(scene, None, replace(config, loop=replace(config.loop, iterations=2)), parts)
    ppo.train(scene, None, replace(config, resume=parts / "policy.pt"), parts)
    first, second = (checkpoint.load(folder / "policy.pt")[0] for folder in (whole, parts))
    for (name, value), other in zip(first.actor.state_dict().items(), second.actor.state_dict().values(), strict=True):
        assert torch.equal(value, other), name

    wider = Scene((*scene.terrains, generate("bends", 0.2, 1), generate("bends", 0.4, 1)), rows=2)
    longer = replace(config, resume=parts / "policy.pt", loop=replace(config.loop, iterations=5))
    result = ppo.train(wider, None, longer, parts)
    assert result.iterations == 5
    assert any("the curriculum restarts" in text and "2 x 2" in text for text in result.warnings)
