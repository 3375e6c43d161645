"""Trials that were run on a policy: evaluation*.json of `realsim evaluate`, and before and after in result.json."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from realsim.core.errors import RealsimError
from realsim.core.files import read_json
from trainer.config import Evaluation, Result


@dataclass(frozen=True)
class Evaluated:
    """A policy on one terrain."""

    title: str
    """Which evaluation: the name of its file, or before or after."""
    result: Result

    @property
    def terrain(self) -> str:
        """Its name, and whether its contact geometry is another than the one trained on."""
        r = self.result
        return r.terrain if r.geometry == "trained" else f"{r.terrain}, {r.geometry} contact"


def read_evaluations(folder: Path, result: Mapping[str, Any]) -> tuple[tuple[Evaluated, ...], list[str]]:
    """All that the folder of a run holds, and what could not be read.

    Args:
        folder: of the run.
        result: what its result.json says, as far as it was readable.
    """
    sources = [(folder / name, result[name]) for name in ("before", "after") if result.get(name) is not None]
    notes: list[str] = []
    found: list[Evaluated] = []
    for path in sorted(folder.glob("evaluation*.json")):
        try:
            sources.append((path, read_json(path)))
        except RealsimError as error:
            notes.append(f"{path.name}: {error.message}")
    for path, data in sources:
        try:
            found += [Evaluated(path.stem, result) for result in Evaluation.of(data, path).results]
        except RealsimError as error:
            notes.append(f"{path.stem}: not an evaluation of realsim ({error.message}; {error.found})")
    return tuple(found), notes
