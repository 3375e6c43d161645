"""Rendered trials of runs' policies, to look at beside their curves."""

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from realsim.core.progress import track
from realsim.report import page
from trainer.commands import common
from trainer.commands.task_file import load_task
from trainer.evaluate import EvaluationConfig, trial_env
from trainer.ppo.distributed import pick_device
from trainer.ppo.policy import check_layout
from trainer.replay import record, video
from trainer.report.history import Run
from trainer.robots import named
from trainer.trainers import TrainConfig

SIZE, FPS = (320, 180), 8.0
"""Of the pictures: a trial of 20 s is then about a megabyte, and the page holds all of them."""
SEED = 0


@dataclass(frozen=True)
class Replayed:
    """A trial."""

    run: str
    trial: int
    outcome: str
    seconds: float
    uri: str
    """The animated picture, as a data URI."""


def replays(runs: Sequence[Run], scene: str, trials: int, task_file: Path | None) -> list[Replayed]:
    """The first trials of each run's policy on a scene, without randomisation. All runs begin in the same poses.

    Raises:
        RealsimError: a run without a policy, one that does not fit the task, a machine that cannot render.
    """
    terrain, _ = common.find_terrain(scene)
    found = []
    for run in runs:
        file = run.folder / "policy.pt"
        policy = common.load_policy(file)
        setting = common.setting(policy, file, pick_device("cpu"), TrainConfig(task=load_task(task_file)))
        env = trial_env(terrain, trials, EvaluationConfig(trials=trials, seed=SEED, randomise=False), setting)
        check_layout(policy.layout, env.layout, str(file))
        begin = env.state_dict()
        for trial in track(range(trials), f"trials of {run.name}"):
            env.load_state_dict(begin)
            recording = record(policy.act, env, trial)
            with tempfile.TemporaryDirectory() as folder:
                path = video(recording, named(policy.robot), terrain, Path(folder) / "t.gif", size=SIZE, fps=FPS)
                data = base64.b64encode(path.read_bytes()).decode()
            seconds = len(recording.qpos) * recording.dt
            found.append(Replayed(run.name, trial, recording.outcome, seconds, f"data:image/gif;base64,{data}"))
    return found


def replay_card(found: Sequence[Replayed], scene: str) -> str:
    """The trials side by side."""
    items = [(r.uri, f"{r.run}, trial {r.trial}: {r.outcome} after {r.seconds:.1f} s", r.run) for r in found]
    note = "Deterministic policy, no randomisation; trial 0 of every run begins in the same pose, and so on."
    return page.card(f"Trials on {scene}", f'<div class="trials">{page.thumbnails(items)}</div>', note, wide=True)
