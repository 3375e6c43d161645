"""The page: whatever the histories hold, it is well formed, complete without a network, and says what is missing."""

import json
import re
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import pages
from tests.trainer import histories
from trainer.report import read_runs, training_page


def titles(html: str) -> list[str]:
    return re.findall(r"<figure><h4>(.*?)</h4>", html)


def test_one_run(tmp_path: Path) -> None:
    folder = histories.run(
        tmp_path / "run", 450, every=50, make=lambda i: histories.row(i) | {"samples": 96.0 * (i + 1)}
    )
    (folder / "evaluation.json").write_text(json.dumps(histories.evaluation("<stakes>")))
    html = training_page(read_runs([folder]))
    said = pages.read(html)
    for words in ("Training of run", "wedges", "stuck", "legs", "Explained variance", "Failures along the course",
                  "<stakes>, evaluation", "Zero throughout: heading error", "is the mean of 3 "):  # fmt: skip
        assert words in said
    assert "collapsed" not in said  # never happened
    assert "Not logged" not in said
    drawn = titles(html)
    assert len(drawn) == len(set(drawn))
    over = {axis: html.count(f'<div class="over {axis}"><svg') for axis in ("iterations", "samples", "minutes")}
    assert len(set(over.values())) == 1
    assert over["iterations"] > 25
    assert html == training_page(read_runs([folder]))


def test_several_runs_are_laid_over_each_other(tmp_path: Path) -> None:
    a = histories.run(tmp_path / "a", 60, pace=3.0, every=20)
    b = histories.run(tmp_path / "b", 45, seed=1)
    old = histories.run(tmp_path / "old", 30, new=False)
    html = training_page(read_runs([a, b, old]))
    said = pages.read(html)
    assert {"Success: wedges", "Success: stakes", "Ended by: ground", "By joint group: legs"} <= set(titles(html))
    assert "Success (old)" in said
    assert "No evaluations on the way: b, old" in said
    assert "at 30 iterations" in said
    minutes = min(60 * (0.5 + 0.25 / 3), 45 * 0.75, 30 * 0.75) / 60
    assert f"at {minutes:.3f} training minutes" in said
    rows = [histories.row(i, pace=3.0) for i in range(10, 30)]
    episodes = sum(r["episodes"] for r in rows)
    mean = sum(r["env/success"] * r["episodes"] for r in rows) / episodes
    assert f"{100 * mean:.1f} %" in said
    success = re.search(r"<h4>Success of the episodes that ended</h4>(.*?)</figure>", html)
    assert success is not None
    assert success[1].count("<path d=") >= 6  # three runs over iterations and over minutes
    assert "Not known over samples" not in said  # no run knows: it cannot be chosen


def test_a_run_that_knows_its_samples_beside_one_that_does_not(tmp_path: Path) -> None:
    a = histories.run(tmp_path / "a", 3, make=lambda i: histories.row(i) | {"samples": 1e6 * (i + 1)})
    said = pages.read(training_page(read_runs([a, histories.run(tmp_path / "b", 3)])))
    assert "million samples" in said
    assert "Not known over samples for every run" in said
    assert "b: no samples were logged" in said


@pytest.mark.parametrize(
    "rows", [[{"iteration": 0}], [{"iteration": 0, "x": None}], [{"iteration": 7, "new/one": 3.0}]]
)
def test_the_least_that_is_a_run(tmp_path: Path, rows: list[dict[str, float | None]]) -> None:
    said = pages.read(training_page(read_runs([histories.write(tmp_path / "run", rows)])))
    assert "Not logged" in said
    assert ("new/one" in said) == ("new/one" in rows[0])


names = st.sampled_from(
    ["env/success", "env/family/<b>/success", "env/family/stakes/row", "env/family/x/end/y/z", "env/end/<i>", "kl",
     "std/", "learning_rate/actor", "gradient/policy", "episodes", "collect_s", "samples", "env/reward/alive", "é\"'&"]
)  # fmt: skip
numbers = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
rows = st.dictionaries(names, numbers, max_size=8)


@settings(max_examples=10)
@given(st.lists(st.tuples(st.integers(0, 10**6), rows), min_size=1, max_size=6), st.integers(1, 2))
def test_no_history_breaks_the_page(lines: list[tuple[int, dict[str, object]]], count: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        written = [{"iteration": i, **row} for i, row in lines]
        folders = [histories.write(Path(name) / str(k), written) for k in range(count)]
        html = training_page(read_runs(folders))
    pages.read(html)
    assert not re.search(r"(?<![a-z])(nan|inf)(?![a-z])", re.sub(r"<title>.*?</title>", "", html))
