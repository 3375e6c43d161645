"""`realsim evaluate`: how often a policy gets there, and what happens when it does not."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.files import refuse_file, to_json, write_text
from trainer.config import EvaluationConfig
from trainer.errors import TrainerError
from trainer.trainers import TrainConfig


def evaluate(
    scenes: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE ...", help_behavior_hint="")],
    policy: Path,
    config: EvaluationConfig,
    finer: tuple[str, ...] = (),
    out: Path = Path("evaluation.json"),
    overwrite: bool = False,
    engine: Annotated[str, tyro.conf.arg(metavar="{mujoco,warp,elliptic}")] = "",
    device: str = "auto",
    task_file: Path | None = None,
    diagnosis: Path | None = None,
    each: bool = False,
) -> CommandResult:
    """Run trials of a policy on a scene with fixed seeds: success rate with Wilson's interval, causes, places.

    Args:
        scenes: folders of `realsim reconstruct`, or names of terrains (see `realsim finetune --help`).
        policy: policy.pt, or the policy.onnx that a robot runs.
        finer: the same scenes with contact geometry that was not trained on.
        out: JSON with every figure and every failed trial.
        overwrite: replace a file that is there already.
        engine: physics engine; by default warp on a GPU and mujoco on the CPU; elliptic is another contact model
            (elliptic friction cones, half the timestep, another solver), to see what a policy owes to its own.
        device: cpu, cuda, or auto.
        task_file: JSON with differences from the paper's task; use that of the training.
        diagnosis: diagnosis.json of `realsim diagnose`, or its folder.
        each: of the diagnosis, run the trials also with no cause and with each cause alone: what costs the success.
    """
    from trainer.commands import common
    from trainer.commands.task_file import load_task
    from trainer.evaluate import evaluate as run_trials
    from trainer.ppo.distributed import pick_device
    from trainer.tasks.parkour.gap import alone

    refuse_file(out, overwrite)
    if each and diagnosis is None:
        raise TrainerError("each cause alone is of a diagnosis", expected="--diagnosis DIAGNOSIS --each", found="none")
    loaded = common.load_policy(policy)
    place = pick_device(device, engine=engine)
    train = TrainConfig(engine=engine, seed=config.seed, task=load_task(task_file), diagnosis=diagnosis)
    setting = common.setting(loaded, policy, place, train)
    scene = common.find_scene(scenes)
    others = common.find_scene(finer).terrains if finer else ()
    found = run_trials(loaded.to(place).act, scene.terrains, config, setting, finer=others)
    data = found.as_dict()
    lines = [f"{'robot':<14} {loaded.robot}", *common.trial_lines("success", found)]
    singles: dict[str, dict[str, Any] | None] = {}
    if each and diagnosis is not None:
        singles = {"no cause": None, **alone(diagnosis)}
    for title, single in singles.items():
        with TemporaryDirectory() as folder:
            file = None if single is None else Path(folder) / "diagnosis.json"
            if file is not None:
                write_text(file, to_json(single))
            apart = run_trials(loaded.to(place).act, scene.terrains, config, replace(setting, diagnosis=file))
        data.setdefault("each", {})[title] = apart.as_dict()
        lines += [title, *common.trial_lines("  alone", apart)]
    write_text(out, to_json(data))
    for r in found.results:
        for low, high, counts in r.bins:
            causes = ", ".join(f"{k} {v}" for k, v in counts.items())
            lines.append(f"{'  failed at':<14} {r.terrain} {low:.2f} to {high:.2f} m: {causes}")
    return CommandResult("\n".join([*lines, f"figures        {out}"]), data)
