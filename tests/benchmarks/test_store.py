"""Figures are kept row by row."""

import json
from pathlib import Path

from benchmarks.store import Store


def test_every_row_is_on_disk_at_once(tmp_path: Path) -> None:
    store = Store(tmp_path / "figures.json", ("capture", "method"))
    store.add({"capture": "a", "method": "ours", "seconds": 1.0})
    kept = json.loads((tmp_path / "figures.json").read_text())
    assert kept["rows"] == [{"capture": "a", "method": "ours", "seconds": 1.0, "run": store.run}]
    assert kept["runs"][store.run]["cores"] >= 1


def test_a_later_run_replaces_what_it_measured_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    first = Store(path, ("capture", "method"))
    first.run = "first"
    first.runs = {"first": {"cores": 2}}
    for name in "ab":
        first.add({"capture": name, "method": "ours", "seconds": 1.0})
    second = Store(path, ("capture", "method"))
    second.add({"capture": "b", "method": "ours", "seconds": 2.0})
    kept = json.loads(path.read_text())
    assert [(r["capture"], r["seconds"], r["run"]) for r in kept["rows"]] == [
        ("a", 1.0, "first"),
        ("b", 2.0, second.run),
    ]
    assert set(kept["runs"]) == {"first", second.run}
    third = Store(path, ("capture", "method"))
    third.run = "third"
    third.runs["third"] = {}
    for name in "ab":
        third.add({"capture": name, "method": "ours", "seconds": 3.0})
    assert set(json.loads(path.read_text())["runs"]) == {"third"}, "runs without rows are forgotten"
