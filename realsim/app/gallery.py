"""Earlier results below a folder: scenes and diagnoses, the latest first."""

from dataclasses import dataclass
from pathlib import Path

from realsim.core.errors import RealsimError
from realsim.core.files import read_json

DEPTH = 3
"""Folders below the first that are looked into."""
MOST = 60


@dataclass(frozen=True)
class Result:
    """A finished scene or diagnosis."""

    folder: Path
    kind: str
    """scene or diagnosis."""
    level: str
    """good, look or bad; of a diagnosis its verdict."""
    headline: str
    page: Path | None
    when: float
    """Seconds since 1970 at which it was written."""


def results_below(root: Path) -> list[Result]:
    """The results in a folder and up to DEPTH folders below it; what cannot be read is left out."""
    found = []
    waiting = [(root, 0)]
    while waiting:
        folder, depth = waiting.pop()
        result = result_of(folder)
        if result is not None:
            found.append(result)
        elif depth < DEPTH:
            waiting += [(p, depth + 1) for p in _folders(folder)]
    return sorted(found, key=lambda r: -r.when)[:MOST]


def result_of(folder: Path) -> Result | None:
    """The result in a folder, or None."""
    page = folder / "report.html"
    shown = page if page.is_file() else None
    for name, kind in (("diagnosis.json", "diagnosis"), ("report.json", "scene"), ("contact.json", "scene")):
        file = folder / name
        if not file.is_file():
            continue
        try:
            data = read_json(file)
            when = file.stat().st_mtime
        except (RealsimError, OSError):
            return None
        if not isinstance(data, dict):
            return None
        if kind == "diagnosis":
            level, headline = str(data.get("verdict", "")), str(data.get("sentence", ""))
        else:
            verdict = data.get("verdict")
            verdict = verdict if isinstance(verdict, dict) else {}
            level, headline = str(verdict.get("level", "")), str(verdict.get("headline", ""))
        return Result(folder, kind, level, headline, shown, when)
    return None


def _folders(folder: Path) -> list[Path]:
    try:
        return [p for p in folder.iterdir() if p.is_dir() and not p.is_symlink() and not p.name.startswith(".")]
    except OSError:
        return []
