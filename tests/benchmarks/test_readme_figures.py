"""The tables of README and docs are those of benchmarks/results, to the last digit."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.scenes import reconstruct
from benchmarks.tables import diagnosis, index, pages, readme
from benchmarks.tables.stored import RESULTS, counts, stored

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("page", pages.PAGES)
def test_the_tables_are_the_stored_figures(page: str) -> None:
    text = (ROOT / page).read_text()
    assert "<!-- figures: " in text
    assert pages.filled(text) == text, "make readme"


def test_no_measured_set_of_the_diagnosis_is_left_out() -> None:
    rows = stored("diagnosis")["rows"]
    table = diagnosis.diagnosis_by_set()
    assert len({(r["seed"], r["case"], r["commit"]) for r in rows}) == len(rows)
    for seed, commit in {(r["seed"], r["commit"]) for r in rows}:
        assert any(line.startswith(f"| {seed}, {commit} |") for line in table)
    by_robot = [counts([r for r in rows if r["robot"] == robot]) for robot in {r["robot"] for r in rows}]
    for question, total in counts(rows).items():
        assert total == tuple(sum(c[question][i] for c in by_robot) for i in (0, 1))
    assert len(readme.readme()) <= 2 + 8


def test_every_file_of_results_is_in_the_index() -> None:
    assert {name for _, name, _ in index.INDEX} == {path.stem for path in RESULTS.glob("*.json")}
    assert set(index.KEYS) == {name for _, name, _ in index.INDEX}


@pytest.mark.parametrize("name", sorted(index.KEYS))
def test_every_row_has_a_key_of_its_own_and_says_what_made_it(name: str) -> None:
    data = stored(name)
    keys = [tuple(row[part] for part in index.KEYS[name]) for row in data["rows"]]
    assert len(set(keys)) == len(keys)
    for row in data["rows"]:
        assert row.get("commit") or data["runs"][row["run"]]["commit"]


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
