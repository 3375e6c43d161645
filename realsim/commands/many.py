"""A command over many inputs: itself again for each of them, in processes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from realsim.commands import CommandResult, other_arguments
from realsim.jobs import Job, run_many


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
    lines = [
        f"{o.name}: {o.result.get(shows) if o.ok else 'FAILED: ' + str(o.result.get('message'))}" for o in outcomes
    ]
    failed = sum(not o.ok for o in outcomes)
    lines.append(f"{len(outcomes) - failed} of {len(outcomes)} done" + (f", {failed} failed" if failed else ""))
    items = [{"name": o.name, "exit_code": o.exit_code, **o.result} for o in outcomes]
    return CommandResult("\n".join(lines), {"items": items, "failed": failed}, 1 if failed else 0)
