"""A command over many inputs: itself again for each of them, as jobs."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from realsim.cli.commands import WORDS, CommandResult, other_arguments
from realsim.core.errors import RealsimError
from realsim.jobs import FOLDER, ManyConfig, Outcome, make_job, run_many

DROPPED = {"--out": 1, "--jobs": 1, "--executor": 1, "--ray": 1, "--slurm": 1}
"""Options that say how many items are handled, and not how one is -> how many values they take."""


def run_each(
    command: str,
    inputs: Sequence[Path],
    out: Path,
    many: ManyConfig,
    *,
    shows: str,
    place: Callable[[Path], Path] | None = None,
    parts: Sequence[str] = (),
    levels: Mapping[str, str] | None = None,
) -> CommandResult:
    """Run `realsim COMMAND INPUT --out OUT/NAME` for every input with the options that were given to this command.

    Args:
        out: gets a folder for each input, and the folder of the jobs.
        shows: the key of a finished item's result that a person wants to see.
        place: output folder of an input; OUT/NAME if None.
        parts: names of the folders in it that appear by themselves; see `make_job`.
        levels: verdict -> good, look or bad, of a command whose verdict is a word.

    Raises:
        RealsimError: one of the inputs is not there; nothing is begun.
    """
    for path in inputs:
        if not path.exists():
            name = " ".join(map(str, inputs))
            hint = f'put the name in quotes: "{name}"' if Path(name).exists() else "check the path"
            raise RealsimError("no such input", file=path, hint=hint)
    options = other_arguments(DROPPED, [str(p) for p in inputs])
    targets = [out / path.resolve().name if place is None else place(path) for path in inputs]
    jobs = [
        make_job(command, path.resolve(), target, options, parts) for path, target in zip(inputs, targets, strict=True)
    ]
    outcomes = run_many(jobs, out / FOLDER, many)
    failed = sum(not o.ok for o in outcomes)
    level = partial(_level, levels or {})
    rejected = sum(level(o) == "bad" for o in outcomes)
    counts = {
        "failed": failed,
        "not to be used": rejected,
        "kept from an earlier run": sum(o.kept for o in outcomes),
    }
    first = f"{len(outcomes) - failed} of {len(outcomes)} done"
    lines = [
        ", ".join([first, *(f"{count} {what}" for what, count in counts.items() if count)]),
        *_table([(o.name, *_cells(o, shows, level(o))) for o in outcomes]),
    ]
    lines.append(f"logs: {out / FOLDER}/*/log.txt" if failed else f"jobs: {out / FOLDER}")
    items = [
        {"name": o.name, "exit_code": o.exit_code, "seconds": o.seconds, "kept": o.kept, "result": o.result}
        for o in outcomes
    ]
    code = 1 if failed else max((o.exit_code for o in outcomes), default=0)
    data = {"items": items, "failed": failed, "rejected": rejected, "jobs": str(out / FOLDER)}
    return CommandResult("\n".join(lines), data, code)


def _table(rows: Sequence[tuple[str, str, str, str]]) -> list[str]:
    """Name, verdict, time and result of every item."""
    widths = [max(len(row[i]) for row in rows) for i in range(3)] if rows else []
    return ["  " + "  ".join([*(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=False)), row[3]]) for row in rows]


def _cells(outcome: Outcome, shows: str, level: str) -> tuple[str, str, str]:
    seconds = f"{outcome.seconds:.0f} s" if outcome.seconds else ""
    if not outcome.ok:
        found = outcome.result.get("found") or outcome.result.get("file")
        return "FAILED", seconds, f"{outcome.result.get('message')}" + (f" ({_line(found)})" if found else "")
    return WORDS.get(level, "done"), seconds, str(outcome.result.get(shows) or "")


def _level(levels: Mapping[str, str], outcome: Outcome) -> str:
    verdict = outcome.result.get("verdict")
    return str(verdict.get("level", "")) if isinstance(verdict, dict) else levels.get(str(verdict), "")


def _line(text: object) -> str:
    """The start of a text on one line."""
    first = str(text).partition("\n")[0]
    return first if len(first) <= 80 else first[:77] + "..."
