"""Runs that were recorded after the others, to tell causes apart; the case's folder stays as it is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from realsim.core.errors import GapError
from realsim.core.files import read_json
from realsim.core.types import MjModel
from realsim.gap.case.runs import Layout, Run, read_run
from realsim.gap.case.setups import read_setups

PLAN, RECORDED = "experiment.json", "recorded"
"""In a folder of `realsim excite`: the plan, and the folder for what was recorded."""


def is_recording(path: Path) -> bool:
    """Whether this is a run, or a folder of `realsim excite`, and not a case."""
    return path.suffix in (".npz", ".csv") or (path / PLAN).is_file()


def read_recordings(
    paths: Sequence[Path], want: Layout, model: MjModel, known: Sequence[str], warnings: list[str]
) -> tuple[Run, ...]:
    """The runs of these files and folders. Raises GapError for what cannot be used: none is left out in silence."""
    found: list[Run] = []
    for file in (f for path in paths for f in _files(Path(path))):
        setups = read_setups(_setups(file), model, file.parent / PLAN)
        run = read_run(file, replace(want, setups={**want.setups, **setups}), warnings)
        if run.name in {*known, *(r.name for r in found)}:
            hint = "give the file of the new recording another name"
            raise GapError(f"there is a run {run.name!r} already", file=file, hint=hint)
        found.append(run)
    return tuple(found)


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        below = path / RECORDED
        files = sorted(f for f in below.iterdir() if f.suffix in (".npz", ".csv")) if below.is_dir() else []
        if not files:
            expected = ".npz or .csv files, a run each, named as their commands"
            raise GapError("nothing was recorded yet", file=below, expected=expected)
        return files
    if not path.is_file():
        raise GapError("no such recording", file=path, expected="a run as .npz or .csv, or a folder of realsim excite")
    return [path]


def _setups(file: Path) -> Mapping[str, Any] | None:
    """What experiment.json beside a recording (or one folder up) has on its runs' masses and gains."""
    plan = next((p for f in (file.parent, file.parent.parent) if (p := f / PLAN).is_file()), None)
    content = {} if plan is None else read_json(plan)
    if not isinstance(content, Mapping):
        raise GapError(f"{PLAN} is not an object", file=plan)
    runs = content.get("runs")
    if runs is not None and not isinstance(runs, Mapping):
        raise GapError(f"runs of {PLAN} cannot be read", file=plan, found=repr(runs)[:60])
    return runs
