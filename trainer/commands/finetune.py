"""`realsim finetune`: a policy adapted to the terrain in front of the robot."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Annotated, Any, Literal

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.errors import RealsimError
from realsim.core.files import read_json, read_text, to_json, write_text
from realsim.core.progress import note
from trainer.config import Evaluation, EvaluationConfig
from trainer.policies import TASKS, base_of
from trainer.trainers import Scene, TrainConfig, TrainResult, find
from trainer.trainers.ladder import HELP_BELOW, helped


@dataclass(frozen=True)
class Begun:
    """How a run that is resumed began: without it, it would go on in another task, and not be judged by its base."""

    base: Path | None = None
    task_file: Path | None = None
    before: Evaluation | None = None

    @staticmethod
    def of(file: Path) -> Begun:
        """As the run's result.json has it; what is not there any more is left out."""
        data = read_json(file) if file.is_file() else {}
        data = data if isinstance(data, dict) else {}
        base, task = (Path(data[name]) if data.get(name) else None for name in ("base", "task_file"))
        before = Evaluation.of(data["before"], file) if data.get("before") else None
        return Begun(base, task, before) if base is not None and base.is_file() else Begun(task_file=task)


def finetune(
    scenes: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE ...", help_behavior_hint="")],
    config: TrainConfig,
    policy: Path | None = None,
    from_scratch: bool = False,
    out: Path = Path("finetuned"),
    overwrite: bool = False,
    trainer: Annotated[str, tyro.conf.arg(metavar="{ppo,rsl_rl}")] = "ppo",
    task_file: Path | None = None,
    final_trials: int = 1000,
    first_success: Literal["auto", "help", "plain"] = "auto",
) -> CommandResult:
    """Fine-tune a policy on one reconstructed scene or several at once, and say what it gained.

    Success is measured before and after with the same trials; a policy that does not beat its base beyond chance is
    not delivered, the base is. The folder gets policy.pt, policy.onnx, history.jsonl, result.json and TensorBoard's
    events. Under torchrun every process calls this; see docs/training.md.

    Args:
        scenes: folders of `realsim reconstruct`; or names of terrains: a test (boxes, stake1, ...), flat, or
            FAMILY:DIFFICULTY:SEED.
        policy: the base policy (.pt) of `realsim pretrain` or of an earlier fine-tuning; if not given, the one
            that ships with realsim for the robot (g1, go2, quadruped).
        from_scratch: train without a base.
        out: folder for the results.
        overwrite: replace the run in a folder that an earlier training wrote; --resume goes on with it.
        trainer: ppo, rsl_rl, or one that an installed package adds.
        task_file: JSON with differences from the paper's task; if not given, that of the base that ships goes with it.
        final_trials: trials on each terrain before and after; 0 leaves both out, and the policy of the best trials on
            the way is delivered without a test.
        first_success: help begins on the same course with wider tops, which narrow as it is crossed, with starts
            along it; plain does not; auto helps where the base crosses a terrain in fewer than 80 %.
    """
    from trainer.commands import common
    from trainer.commands.task_file import load_task
    from trainer.ppo.strategies import STRATEGIES
    from trainer.verdict import judge

    common.check_output(out, overwrite, config)
    if policy is not None and from_scratch:
        raise common.TrainerError(
            "fine-tuning starts from a policy, or from scratch",
            expected="--policy base.pt, or --from-scratch",
            found="both",
        )
    if policy is not None and policy.suffix == ".onnx":
        raise common.TrainerError(
            "training needs the checkpoint, not the exported policy",
            file=policy,
            expected="the policy.pt beside it",
            hint="realsim evaluate takes the exported one",
        )
    begun = Begun()
    if config.resume is not None:
        begun = Begun.of(config.resume.with_name("result.json"))
    elif policy is None and not from_scratch:
        robot = config.robot or "g1"
        policy, begun = base_of(robot), Begun(task_file=TASKS[robot])
        note(f"from the base that ships with realsim: {policy.name}")
    base, task_file, before = policy or begun.base, task_file or begun.task_file, begun.before
    scene = common.find_scene(scenes)
    config = replace(config, task=load_task(task_file))
    train = find(trainer)
    if config.strategy:
        STRATEGIES[config.strategy]  # an unknown name is refused before the trials of the base take minutes
    if policy is not None and final_trials and common.first_rank():
        note("trials of the base policy")
        before = trials(policy, scene, config, final_trials)
    data: dict[str, Any] = {
        "base": None if base is None else str(base.absolute()),
        "task_file": None if task_file is None else str(task_file.absolute()),
        "before": None if before is None else before.as_dict(),
    }
    result_file, made = out / "result.json", out / "policy.pt"
    earlier = read_text(result_file) if config.resume is not None and result_file.is_file() else ""
    since = made.stat().st_mtime_ns if made.is_file() else None
    if common.first_rank():
        write_text(result_file, to_json(data))  # a resume goes on with it
    help_it = first_success == "help" or (first_success == "auto" and before is not None and _hardly_crosses(before))
    lands = scene
    if help_it:
        lands, task = helped(scene, config.task)
        config = replace(config, task=task)
    try:
        result = train(lands, policy, config, out)
    except (RealsimError, KeyboardInterrupt):
        if earlier and common.first_rank() and since == (made.stat().st_mtime_ns if made.is_file() else None):
            write_text(result_file, earlier)  # nothing was trained: what the run had found still holds
        elif not made.is_file():  # nothing was trained: there is no run to go on with
            for name in ("result.json", "history.jsonl"):
                (out / name).unlink(missing_ok=True)
            rmtree(out / "events", ignore_errors=True)
            with suppress(OSError):
                out.rmdir()
        raise
    if not common.first_rank():
        return CommandResult("")
    after = verdict = None
    if final_trials and result.ours:
        note("trials of the fine-tuned policy")
        after = trials(result.policy, scene, config, final_trials)
        if before is not None and base is not None:
            verdict = judge(before, after)
            if not verdict.better:
                deliver_base(base, result, config)
    data = {
        "result": asdict(result),
        **data,
        "after": None if after is None else after.as_dict(),
        "verdict": None if verdict is None else verdict.as_dict(),
        "target": config.loop.target,
        "helped": help_it,
    }
    write_text(result_file, to_json(data))
    lines = common.result_lines(result, config.loop.target)
    for title, evaluation in (("before", before), ("after", after)):
        lines += common.trial_lines(title, evaluation) if evaluation is not None else []
    lines += [] if verdict is None else verdict.lines()
    return CommandResult("\n".join(lines), data)


def _hardly_crosses(before: Evaluation) -> bool:
    hard = [r.terrain for r in before.results if r.rate < HELP_BELOW]
    if hard:
        note(f"the base crosses {', '.join(hard)} in fewer than {HELP_BELOW:.0%}: training begins on wider tops")
    return bool(hard)


def deliver_base(base: Path, result: TrainResult, config: TrainConfig) -> None:
    """Put the base in the place of the policy that did not beat it; the run can still be resumed."""
    from trainer.commands import common
    from trainer.physics import PhysicsConfig
    from trainer.ppo import checkpoint
    from trainer.trainers.ppo import write_onnx

    policy = common.load_policy(base)
    checkpoint.deliver(result.policy, policy)
    if result.onnx is not None:
        physics = PhysicsConfig()
        write_onnx(result.onnx, policy, config.task, physics.timestep * physics.decimation)


def trials(policy: Path, scene: Scene, config: TrainConfig, count: int) -> Evaluation:
    """Trials of a policy on the scene's terrains in the task and engine of the training."""
    from trainer.commands import common
    from trainer.evaluate import evaluate
    from trainer.ppo.distributed import pick_device

    loaded = common.load_policy(policy)
    device = pick_device(config.device, engine=config.engine)
    setting = common.setting(loaded, policy, device, config)
    settings = EvaluationConfig(trials=count, worlds=min(count, 250), seed=config.seed)
    return evaluate(loaded.to(device).act, scene.terrains, settings, setting)
