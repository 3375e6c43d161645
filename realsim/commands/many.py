"""A command over many inputs: itself again for each of them, in processes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from realsim.commands import DO_NOT_USE, WORDS, CommandResult, other_arguments
from realsim.jobs import Job, Outcome, run_many


def run_each(
    command: str, inputs: Sequence[Path], out: Path, *, shows: str, jobs: int, ray: str | None
) -> CommandResult:
    """Run `realsim COMMAND INPUT --out OUT/NAME` for every input with the options that were given to this command.

    Args:
        shows: the key of a finished item's result that a person wants to see.
        jobs: how many at a time on this machine.
        ray: the address of a Ray cluster instead.
    """
    options = other_arguments({"--out": 1, "--jobs": 1, "--ray": 1}, [str(p) for p in inputs])
    todo = []
    for path in inputs:
        target = (out / path.resolve().name).absolute()
        todo.append(Job(target.name, (command, str(path.resolve()), "--out", str(target), *options)))
    outcomes = run_many(todo, workers=jobs, ray_address=ray)
    failed = sum(o.exit_code not in (0, DO_NOT_USE) for o in outcomes)
    rejected = sum(_level(o) == "bad" for o in outcomes)
    lines = [f"{len(outcomes) - failed} of {len(outcomes)} done" + (f", {failed} failed" if failed else "")]
    lines[0] += f", {rejected} not to be used" if rejected else ""
    lines += [f"{o.name}: {_outcome(o, shows)}" for o in outcomes]
    items = [{"name": o.name, "exit_code": o.exit_code, **o.result} for o in outcomes]
    code = 1 if failed else max((o.exit_code for o in outcomes), default=0)
    return CommandResult("\n".join(lines), {"items": items, "failed": failed, "rejected": rejected}, code)


def _level(outcome: Outcome) -> str:
    verdict = outcome.result.get("verdict")
    return str(verdict.get("level", "")) if isinstance(verdict, dict) else ""


def _outcome(outcome: Outcome, shows: str) -> str:
    """The line that is printed for an item: its verdict first."""
    if outcome.exit_code not in (0, DO_NOT_USE):
        return f"FAILED: {outcome.result.get('message')}"
    word = WORDS.get(_level(outcome))
    return (f"{word}: " if word else "") + str(outcome.result.get(shows))
