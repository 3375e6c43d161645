"""All iterations: checkpoints, evaluations on the way, TensorBoard, progress with the time left."""

from __future__ import annotations

import copy
import json
import math
import time
from collections import deque
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

STANDING = 0.5
"""Share of the time for which robots that are told to go may wait. Bases that ship wait 8 to 15 % of it (starting, and
falling), a policy that had learnt to stand on narrow beams 90 %."""
FALLEN = 0.15
"""By how much success may fall below the best evaluation: of 100 trials at 50 %, chance does it once in sixty."""
SAVED_S = 30.0
"""Seconds after which a checkpoint is written also between two of `checkpoint_every`: an interruption costs no more."""

Evaluate = Callable[[Policy], float]
"""Success rate (0..1) of the deterministic policy in fixed trials; must leave the training's worlds alone."""


@dataclass
class History:
    """Summary of a training; the rows of single iterations are read with `read_rows`."""

    evaluations: list[tuple[int, float]] = field(default_factory=list)
    """(iterations done, success rate)."""
    notes: list[str] = field(default_factory=list)

    def at(self, iteration: int) -> bool:
        """Whether the policy of that iteration was evaluated."""
        return bool(self.evaluations) and self.evaluations[-1][0] == iteration

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
        folder: gets policy.pt, history.jsonl (a line an iteration), and event files. policy.pt holds the policy of the
            best evaluation, the latest without evaluations, and all that it takes to go on from the latest.
        evaluate: asked on the first rank only; without it there is no target.
        resume: a checkpoint of the same policy to go on from.

    An interrupt leaves the last checkpoint, at most `SAVED_S` and an iteration old. The first rank writes files.
    """
    history, best = History(), Best()
    if resume is not None:
        history = _resume(runner, resume)
        best = Best.of_checkpoint(resume, history)
    elif evaluate is not None and config.evaluate_every:
        _evaluate(runner, evaluate, history, best)
    watch = Watch(config.watch if runner.policy.tuned else 0)
    # Whoever requested the training goes on with its policy.pt, also where nothing is left to train.
    until = time.monotonic() + 60 * config.minutes if config.minutes else math.inf
    done = _done(runner, history, config, until)
    began = saved = time.perf_counter()
    evaluating = 0.0
    if done:
        save(runner, history, folder, best)
    else:
        runner.begin()
    with _kept(folder), _writer(folder, runner, config.tensorboard) as write, _progress(runner, config) as show:
        if runner.iteration == 0 and history.evaluations:
            write({"iteration": 0, "success": history.evaluations[0][1]})
        while not done:
            row = {"iteration": runner.iteration, **runner.iterate()}
            write(row)
            due = config.evaluate_every and runner.iteration % config.evaluate_every == 0
            affordable = evaluating <= config.evaluate_share * (time.perf_counter() - began)
            if evaluate is not None and due and affordable:
                begun = time.perf_counter()
                rate = _evaluate(runner, evaluate, history, best)
                write({"iteration": runner.iteration - 1, "success": rate})
                evaluating += time.perf_counter() - begun
            show(row, history)
            done = _done(runner, history, config, until)
            if done and evaluate is not None and config.evaluate_every and not history.at(runner.iteration):
                rate = _evaluate(runner, evaluate, history, best)  # who is stopped has learnt since the last one
                write({"iteration": runner.iteration - 1, "success": rate})
            lost = watch.lost(row.get("env/episode/waiting"), history, runner.iteration, best)
            if not done and any_rank(lost is not None, runner.rank.device):
                note(f"{lost}: back to the policy of the best trials, on an easier course")
                history.notes.append(f"iteration {runner.iteration}: {lost}; training went back to its best policy")
                runner.go_back(best.policy)
                watch.restart()
            regular = runner.iteration % config.checkpoint_every == 0 or done
            overdue = not config.restart_at_checkpoint and time.perf_counter() - saved > SAVED_S
            if any_rank(regular or overdue, runner.rank.device):
                save(runner, history, folder, best)
                saved = time.perf_counter()
                if config.restart_at_checkpoint:
                    runner.begin()
    return history


@dataclass
class Best:
    """The policy of the best evaluation so far, on the first rank."""

    rate: float = -1.0
    policy: Policy | None = None

    @classmethod
    def of_checkpoint(cls, path: Path, history: History) -> Best:
        """That of a run that is resumed."""
        if not history.evaluations:
            return cls()
        return cls(max(rate for _, rate in history.evaluations), checkpoint.load(path)[0])

    def consider(self, rate: float, policy: Policy) -> None:
        """Keep a copy if it is better than all before; the first of equals stays."""
        if rate > self.rate:
            self.rate, self.policy = rate, copy.deepcopy(policy)


class Watch:
    """Whether training has lost what a policy knew: it waits instead of walking, or its success has fallen."""

    def __init__(self, iterations: int) -> None:
        self.waiting: deque[float] = deque(maxlen=iterations)

    def restart(self) -> None:
        """After the policy has been changed."""
        self.waiting.clear()

    def lost(self, waits: float | None, history: History, iteration: int, best: Best) -> str | None:
        """What was lost; None if nothing.

        Args:
            waits: share of the last iteration's time for which robots waited.
            history: with all evaluations.
            iteration: iterations done.
            best: so far.
        """
        most = self.waiting.maxlen
        if not most or waits is None or best.policy is None:
            return None
        self.waiting.append(waits)
        share = sum(self.waiting) / most
        if len(self.waiting) == most and share > STANDING:
            return f"robots wait {share:.0%} of the time"
        if history.at(iteration) and best.rate - history.evaluations[-1][1] > FALLEN:
            return f"success fell from {best.rate:.0%} to {history.evaluations[-1][1]:.0%}"
        return None


@contextmanager
def _kept(folder: Path) -> Iterator[None]:
    """An interrupt says how to go on."""
    try:
        yield
    except KeyboardInterrupt as error:
        latest = folder / "policy.pt"
        raise KeyboardInterrupt(
            f"the last checkpoint is kept; the same command with --resume {latest} goes on from it"
            if latest.is_file()
            else f"there is no checkpoint yet: the first is written after {SAVED_S:.0f} s of training"
        ) from error


def save(runner: Runner, history: History, folder: Path, best: Best) -> None:
    """Write the checkpoint; to be called on all ranks."""
    state = runner.state_dict()
    if runner.rank.first:
        training = {**state, "evaluations": list(map(list, history.evaluations))}
        latest = None if best.policy is None else runner.policy
        checkpoint.save(folder / "policy.pt", best.policy or runner.policy, training, latest)


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
    policy, training = checkpoint.load(path, runner.rank.device, latest=True)
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


def _evaluate(runner: Runner, evaluate: Evaluate, history: History, best: Best) -> float:
    rate = 0.0
    if runner.rank.first:
        rate = evaluate(runner.policy)
        best.consider(rate, runner.policy)
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
