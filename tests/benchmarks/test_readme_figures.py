"""The README's figures are those of benchmarks/results, to the last digit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import reconstruct

ROOT = Path(__file__).resolve().parents[2]


def test_the_table_of_captures_is_the_stored_one() -> None:
    readme = (ROOT / "README.md").read_text()
    lines = reconstruct.readme_table(json.loads((ROOT / "benchmarks/results/reconstruct.json").read_text())["rows"])
    assert len(lines) == 7
    assert [line for line in lines if line not in readme] == []


def test_absent_captures_are_named_and_no_figure_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconstruct, "SHARED", tmp_path)
    monkeypatch.setattr(reconstruct, "RESULTS", tmp_path)
    with pytest.raises(SystemExit, match=r"stake_a.*REALSIM_SHARED"):
        reconstruct.main(reconstruct.Options())
    assert not list(tmp_path.iterdir())


def test_a_failure_takes_the_place_of_no_figure(tmp_path: Path) -> None:
    store = reconstruct.Store(tmp_path / "rows.json", ("capture",))
    reconstruct._kept(store, {"capture": "a", "seconds": 1.0})
    reconstruct._kept(store, {"capture": "a", "seconds": float("nan"), "error": "died"})
    assert [r["seconds"] for r in store.rows] == [1.0]
