"""All iterations: checkpoints, evaluations on the way, TensorBoard, progress with the time left."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from realsim.core.files import explain_write_errors, write_text
from realsim.core.progress import console, note, visible
from trainer.errors import TrainerError
from trainer.ppo import checkpoint
from trainer.ppo.config import LoopConfig
from trainer.ppo.distributed import any_rank
from trainer.ppo.policy import Policy
from trainer.ppo.runner import Runner

Evaluate = Callable[[Policy], float]
"""Success rate (0..1) of the deterministic policy in fixed trials; must leave the training's worlds alone."""


@dataclass
class History:
    """Summary of a training; the rows of single iterations are read with `read_rows`."""

    evaluations: list[tuple[int, float]] = field(default_factory=list)
    """(iterations done, success rate)."""
    notes: list[str] = field(default_factory=list)

    def to_target(self, target: float) -> int | None:
        """Iterations done at the first evaluation that reached the target; None if none did."""
        return next((iteration for iteration, rate in self.evaluations if rate >= target), None)


def train(
    runner: Runner, config: LoopConfig, folder: Path, *, evaluate: Evaluate | None = None, resume: Path | None = None
) -> History:
    """Train until `config.iterations`, or until the target.

    Args:
        runner: see there.
        config: see `LoopConfig`.
        folder: gets policy.pt (the latest checkpoint), history.jsonl (a line an iteration), and event files.
        evaluate: asked on the first rank only; without it there is no target.
        resume: a checkpoint of the same policy to go on from.

    An interrupt leaves the last checkpoint. Files are written by the first rank.
    """
    history = History()
    if resume is not None:
        history = _resume(runner, resume)
    elif evaluate is not None and config.evaluate_every:
        _evaluate(runner, evaluate, history)
    # Whoever asked for the training goes on with its policy.pt, also where nothing is left to train.
    until = time.monotonic() + 60 * config.minutes if config.minutes else math.inf
    done = _done(runner, history, config, until)
    began, evaluating = time.perf_counter(), 0.0
    if done:
        save(runner, history, folder)
    else:
        runner.begin()
    with _writer(folder, runner, config.tensorboard) as write, _progress(runner, config) as show:
        if runner.iteration == 0 and history.evaluations:
            write({"iteration": 0, "success": history.evaluations[0][1]})
        while not done:
            row = {"iteration": runner.iteration, **runner.iterate()}
            write(row)
            due = config.evaluate_every and runner.iteration % config.evaluate_every == 0
            affordable = evaluating <= config.evaluate_share * (time.perf_counter() - began)
            if evaluate is not None and due and affordable:
                asked = time.perf_counter()
                write({"iteration": runner.iteration - 1, "success": _evaluate(runner, evaluate, history)})
                evaluating += time.perf_counter() - asked
            show(row, history)
            done = _done(runner, history, config, until)
            if runner.iteration % config.checkpoint_every == 0 or done:
                save(runner, history, folder)
                if config.restart_at_checkpoint:
                    runner.begin()
    return history


def save(runner: Runner, history: History, folder: Path) -> None:
    """Write the checkpoint; to be called on all ranks."""
    state = runner.state_dict()
    if runner.rank.first:
        training = {**state, "evaluations": list(map(list, history.evaluations))}
        checkpoint.save(folder / "policy.pt", runner.policy, training)


def read_rows(folder: Path) -> list[dict[str, float | None]]:
    """The logged rows in order: one per iteration with its number (from 0), losses, reward terms and seconds; one per
    evaluation with `success`, its number that of the iteration before it, or 0 before the first. None where a figure
    is not a number (no episode ended)."""
    path = folder / "history.jsonl"
    if not path.is_file():
        return []
    whole_lines = path.read_text("utf-8").split("\n")[:-1]  # what follows the last line feed was cut off
    return [json.loads(line) for line in whole_lines]


def _resume(runner: Runner, path: Path) -> History:
    policy, training = checkpoint.load(path, runner.rank.device)
    if training is None:
        raise TrainerError(
            "the checkpoint holds a policy but no training state", file=path, hint="pass it as --policy instead"
        )
    if policy.tuned != runner.policy.tuned or policy.networks != runner.policy.networks:
        raise TrainerError(
            "the checkpoint belongs to another run",
            file=path,
            expected=f"strategies {[n for n, _ in runner.policy.tuned]}, {runner.policy.networks}",
            found=f"strategies {[n for n, _ in policy.tuned]}, {policy.networks}",
        )
    runner.policy.actor.load_state_dict(policy.actor.state_dict())
    runner.policy.critic.load_state_dict(policy.critic.state_dict())
    try:
        notes = runner.load_state_dict(training)
        evaluations = [(int(i), float(rate)) for i, rate in training["evaluations"]]
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise TrainerError(
            "cannot resume training from this checkpoint",
            file=path,
            found=f"{type(error).__name__}: {error}",
            hint="it was edited, or written by a changed version; its policy may still work with --policy",
        ) from error
    return History(evaluations, notes)


def _evaluate(runner: Runner, evaluate: Evaluate, history: History) -> float:
    rate = evaluate(runner.policy) if runner.rank.first else 0.0
    history.evaluations.append((runner.iteration, rate))
    return rate


def _done(runner: Runner, history: History, config: LoopConfig, until: float) -> bool:
    reached = config.stop_at_target and history.to_target(config.target) is not None
    reached = reached or time.monotonic() > until
    # Only the first rank evaluates: all must hear of it, or they would wait for each other's gradients.
    return runner.iteration >= config.iterations or any_rank(reached, runner.rank.device)


@contextmanager
def _writer(folder: Path, runner: Runner, tensorboard: bool) -> Iterator[Callable[[Mapping[str, float]], None]]:
    """A function that logs a row: into history.jsonl, and for TensorBoard."""
    if not runner.rank.first:
        yield lambda row: None
        return
    # Rows that came after the checkpoint which is gone on from happen again.
    kept = [row for row in read_rows(folder) if (row["iteration"] or 0) < runner.iteration]
    path = folder / "history.jsonl"
    write_text(path, "".join(json.dumps(row) + "\n" for row in kept))
    board = _board(folder) if tensorboard else None
    with path.open("a", encoding="utf-8", buffering=1) as file:

        def write(row: Mapping[str, float]) -> None:
            plain = {name: value if math.isfinite(value) else None for name, value in row.items()}
            with explain_write_errors(path):
                file.write(json.dumps(plain) + "\n")
            if board is not None:
                for name, value in row.items():
                    if name != "iteration":
                        board.add_scalar(name, value, int(row["iteration"]))

        try:
            yield write
        finally:
            if board is not None:
                board.close()


def _board(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        note("tensorboard is not installed: no event files (history.jsonl has the same figures)")
        return None
    return SummaryWriter(str(folder / "events"))


@contextmanager
def _progress(runner: Runner, config: LoopConfig) -> Iterator[Callable[[Mapping[str, float], History], None]]:
    """A function that shows how far it is, when it will end, and how well it goes."""
    if not (visible() and runner.rank.first):
        yield lambda row, history: None
        return
    columns = (
        TextColumn("training"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=config.iterations, completed=runner.iteration)

        def show(row: Mapping[str, float], history: History) -> None:
            success = f", success {history.evaluations[-1][1]:.0%}" if history.evaluations else ""
            text = f"reward {row['reward']:.3f}, {row['collect_s'] + row['update_s']:.2f} s{success}"
            bar.update(task, completed=runner.iteration, description=text)

        yield show
