"""The tables of README and docs are those of benchmarks/results, to the last digit."""

import subprocess
from pathlib import Path

import pytest

from benchmarks.scenes import reconstruct
from benchmarks.tables import index, pages, plots
from benchmarks.tables.stored import RESULTS, stored

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("page", pages.PAGES)
def test_the_tables_are_the_stored_figures(page: str) -> None:
    text = (ROOT / page).read_text()
    assert "<!-- figures: " in text
    assert pages.filled(text) == text, "make readme"


def test_every_picture_of_the_report_is_of_the_stored_figures() -> None:
    for name, picture in plots.pictures().items():
        assert (pages.PLOTS / name).read_text() == picture, "make readme"
        assert f"plots/{name}" in (ROOT / "benchmarks" / "REPORT.md").read_text()
    for name, picture in plots.pictures_of_docs().items():
        assert (pages.IMAGES / name).read_text() == picture, "make readme"


def test_the_results_are_of_one_engine_and_small() -> None:
    assert sum(path.stat().st_size for path in RESULTS.glob("*.json")) < 1_000_000
    assert len({r["commit"] for r in stored("diagnosis")["rows"]}) == 1
    for name in ("gap_real", "gap_unstable", "gap_since", "gap_sweep"):
        assert len({row["engine"] for row in stored(name)["rows"]}) == 1, name


def test_every_commit_that_made_a_row_is_in_the_history() -> None:
    def known(commit: str) -> bool:
        command = ["git", "-C", str(ROOT), "merge-base", "--is-ancestor", commit, "HEAD"]
        return subprocess.run(command, capture_output=True).returncode == 0

    if not known("62667f2"):
        pytest.skip("no history of git here")
    for name in index.KEYS:
        data = stored(name)
        commits = {row["commit"] for row in data["rows"] if "commit" in row}
        commits |= {run["commit"] for run in data.get("runs", {}).values()}
        assert [c for c in sorted(commits) if not known(c)] == [], name


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
