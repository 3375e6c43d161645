"""`realsim training report`: look at training runs."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.files import refuse_file, write_text
from trainer.errors import TrainerError
from trainer.report import read_runs, training_page
from trainer.report.tables import as_dict, lines

MOST_TRIALS = 12
"""Of each run: the page holds their pictures, about a megabyte each."""


def training(
    what: Annotated[Literal["report"], tyro.conf.Positional],
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...", help_behavior_hint="")],
    out: Path = Path("report.html"),
    overwrite: bool = False,
    trials: int = 0,
    scene: str = "",
    task_file: Path | None = None,
) -> CommandResult:
    """Show a training run, or several over each other, as one page that needs no network.

    Curves by terrain family, learning, exploration noise, reward terms, ends of episodes, physics and time; and where
    trials failed, if `realsim evaluate` wrote evaluation*.json into the folders. A run may still be going on.

    Args:
        what: report
        runs: folders of `realsim pretrain` or `realsim finetune`.
        out: the page (.html).
        overwrite: replace a file that is there already.
        trials: render this many trials of each run's policy (.pt) on --scene; needs MUJOCO_GL=egl or osmesa without a
            display.
        scene: a folder of `realsim reconstruct`, or the name of a terrain (see `realsim finetune --help`).
        task_file: for the trials: JSON with differences from the paper's task; use that of the training.
    """
    if not runs:
        raise TrainerError("no run was named", expected=f"realsim training {what} RUN ... --out report.html")
    if out.suffix.lower() not in (".html", ".htm"):
        raise TrainerError("the page is HTML", expected="--out NAME.html", found=str(out))
    if not 0 <= trials <= MOST_TRIALS:
        raise TrainerError("too many trials for one page", expected=f"0 to {MOST_TRIALS}", found=f"--trials {trials}")
    if bool(trials) != bool(scene):
        raise TrainerError(
            "rendered trials need their number and a scene", expected="--trials N --scene NAME, or neither"
        )
    refuse_file(out, overwrite)
    found = read_runs(runs)
    extra = []
    if trials:
        from trainer.report.replays import replay_card, replays  # needs torch, which the rest of the page does not

        extra.append(replay_card(replays(found, scene, trials, task_file), scene))
    write_text(out, training_page(found, extra))
    text = [line for run in found for line in lines(run)]
    return CommandResult(
        "\n".join([*text, f"report  {out}"]), {"report": str(out), "runs": [as_dict(r) for r in found]}
    )
