"""`realsim play`: look at a trial."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.files import refuse_file
from realsim.core.progress import note
from trainer.config import EvaluationConfig
from trainer.robots import named
from trainer.trainers import TrainConfig


def play(
    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    policy: Path,
    out: Path = Path("trial.mp4"),
    overwrite: bool = False,
    trial: int = 0,
    seed: int = 0,
    randomise: bool = False,
    task_file: Path | None = None,
) -> CommandResult:
    """Simulate one trial of a policy and write it as a video or model; without a display set MUJOCO_GL=egl or osmesa.

    Args:
        scene: a folder of `realsim reconstruct`, or the name of a terrain (see `realsim finetune --help`).
        policy: policy.pt.
        out: .mp4, .gif, .webp, or .glb (an animated model for any glTF viewer).
        overwrite: replace a file that is there already.
        trial: which of the trials of this seed.
        seed: of the trials.
        randomise: vary friction, masses, delays and noise as in training.
        task_file: JSON with differences from the paper's task; use that of the training.
    """
    from trainer.commands import common
    from trainer.commands.task_file import load_task
    from trainer.evaluate import trial_env
    from trainer.ppo.distributed import pick_device
    from trainer.ppo.policy import check_layout
    from trainer.replay import record, write

    refuse_file(out, overwrite)
    if trial < 0:
        raise common.TrainerError("trials are numbered from 0", found=str(trial))
    loaded = common.load_policy(policy)
    config = TrainConfig(seed=seed, task=load_task(task_file))
    setting = common.setting(loaded, policy, pick_device("cpu"), config)
    terrain, _ = common.find_terrain(scene)
    note("simulating the trial ...")
    env = trial_env(terrain, trial + 1, EvaluationConfig(seed=seed, randomise=randomise), setting)
    check_layout(loaded.layout, env.layout, str(policy))
    recording = record(loaded.act, env, trial)
    write(recording, named(loaded.robot), terrain, out)
    seconds = len(recording.qpos) * recording.dt
    text = f"replay         {out}\noutcome        {recording.outcome} after {seconds:.1f} s"
    return CommandResult(text, {"replay": str(out), "outcome": recording.outcome, "seconds": seconds, "seed": seed})
