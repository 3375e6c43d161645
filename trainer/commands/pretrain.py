"""`realsim pretrain`: a base policy."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.files import to_json, write_text
from trainer.terrain import ALL, grid
from trainer.trainers import Scene, TrainConfig, find

CURRICULUM_ROWS = 10


def pretrain(
    config: TrainConfig,
    out: Path = Path("pretrained"),
    overwrite: bool = False,
    terrain: str = "grid",
    families: tuple[str, ...] = ALL,
    columns: int = 8,
    trainer: Annotated[str, tyro.conf.arg(metavar="{ppo,rsl_rl}")] = "ppo",
    task_file: Path | None = None,
) -> CommandResult:
    """Train a base policy on generated terrain, from scratch.

    Args:
        out: gets policy.pt, policy.onnx, history.jsonl, result.json and TensorBoard's events.
        overwrite: replace the run in a folder that an earlier training wrote; --resume goes on with it.
        terrain: `grid` is the curriculum of 10 rows; or one terrain: flat, a test's name, or FAMILY:DIFFICULTY:SEED.
        families: of the grid.
        columns: of the grid for each family: terrains of each difficulty.
        trainer: ppo, rsl_rl, or one that an installed package adds.
        task_file: JSON with differences from the paper's task.
    """
    from trainer.commands import common
    from trainer.commands.task_file import load_task

    common.check_output(out, overwrite, config)
    config = replace(config, task=load_task(task_file))
    if terrain == "grid":
        scene = Scene(tuple(grid(config.seed, families, columns)), rows=CURRICULUM_ROWS)
    else:
        scene = common.find_scene([terrain])
    result = find(trainer)(scene, None, config, out)
    if not common.first_rank():
        return CommandResult("")
    data = {"result": asdict(result), "terrain": terrain, "target": config.loop.target}
    write_text(out / "result.json", to_json(data))
    return CommandResult("\n".join(common.result_lines(result, config.loop.target)), data)
