"""Figures go to disk row by row, so that a run that is interrupted keeps what is finished."""

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from realsim.core.files import to_json, write_text
from realsim.report.summary import versions

Row = dict[str, Any]


class Store:
    """A JSON file {"runs": {id: what it ran on}, facts about all rows, "rows": [...]}, a row a line.

    A row replaces the one with the same key. Rows of earlier runs stay until they are measured again; each says by
    `run` which run it is from, so that figures from different machines or versions cannot be mistaken for one run.
    """

    def __init__(self, path: Path, key: tuple[str, ...]) -> None:
        """
        Args:
            path: the file; it is created with the first row.
            key: names of the values that together identify a row.
        """
        self.path, self.key = path, key
        self.run = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        self.runs: dict[str, Any] = {}
        self.rows: list[Row] = []
        self.facts: Row = {}
        """Facts about all rows together; written with the next row, or by `save`."""
        if path.is_file():
            self.facts = json.loads(path.read_text())
            self.runs, self.rows = self.facts.pop("runs"), self.facts.pop("rows")
        self.runs[self.run] = described_run()

    def add(self, row: Row) -> Row:
        """Write the row at once; it is handed back."""
        same = self._key(row)
        self.rows = [r for r in self.rows if self._key(r) != same] + [{**row, "run": self.run}]
        self.save()
        return row

    def get(self, **key: Any) -> Row | None:
        """The row with that key."""
        return next((row for row in self.rows if self._key(row) == self._key(key)), None)

    def save(self) -> None:
        """Write all rows, and the runs that some of them are from."""
        used = {r["run"] for r in self.rows}
        runs = {name: run for name, run in self.runs.items() if name in used}
        head = to_json({"runs": runs, **self.facts}).rstrip().removesuffix("}").rstrip()
        rows = ",\n".join(json.dumps(json.loads(to_json(row)), ensure_ascii=False) for row in self.rows)
        write_text(self.path, f'{head},\n "rows": [\n{rows}\n ]\n}}\n')

    def _key(self, row: Row) -> tuple[Any, ...]:
        return tuple(row.get(name) for name in self.key)


def described_run() -> dict[str, Any]:
    """What a run is made with: machine, its load before the start, versions, commit."""
    # The GPU that this process computes on, if it has requested one.
    torch = sys.modules.get("torch")
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "system": platform.system(),
        "commit": os.environ.get("REALSIM_COMMIT") or _commit(),
        **({"gpu": torch.cuda.get_device_name()} if torch is not None and torch.cuda.is_available() else {}),
        "versions": versions(),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _commit() -> str | None:
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() or None
