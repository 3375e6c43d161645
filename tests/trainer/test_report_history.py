"""What is read of a run's folder, and what is said where it cannot be read."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.core.errors import RealsimError
from tests.trainer import histories
from trainer.report.curves import binned
from trainer.report.history import LAST, increments, read_run, read_runs


def test_a_run_is_what_was_written(tmp_path: Path) -> None:
    folder = histories.run(tmp_path / "run", 40, every=10)
    run = read_run(folder, "run")
    assert len(run) == 40
    assert run.over["iterations"].tolist() == list(range(1, 41))
    assert run.over["minutes"][-1] == pytest.approx(40 * 0.75 / 60)
    assert "samples" not in run.over  # the rows do not say
    assert run.on_the_way[:, 0].tolist() == [0, 10, 20, 30, 40]
    assert run.evaluated_over("minutes") == pytest.approx(run.on_the_way[:, 0] * 0.75 / 60)
    value = run.column("env/success")
    assert value is not None
    assert value[7] == histories.row(7)["env/success"]
    assert run.derived["env/physics/solver_limited an iteration"] == pytest.approx(np.full(40, 239.0))


def test_means_of_episodes_count_episodes(tmp_path: Path) -> None:
    rows = [
        {"iteration": i, "env/success": s, "episodes": n} for i, (s, n) in enumerate([(0.5, 10), (None, 0), (0.1, 30)])
    ]
    run = read_run(histories.write(tmp_path / "run", rows), "run")
    assert run.mean("env/success") == pytest.approx((0.5 * 10 + 0.1 * 30) / 40)
    assert run.mean("env/success", 2) == 0.5
    assert math.isnan(run.mean("env/nothing"))
    values = np.arange(100.0)
    long = read_run(
        histories.write(tmp_path / "long", [{"iteration": i, "x": v} for i, v in enumerate(values)]), "long"
    )
    assert long.mean("x") == values[-LAST:].mean()


def test_what_happened_again_after_a_resume_counts_once(tmp_path: Path) -> None:
    rows = [{"iteration": i, "x": float(i)} for i in range(5)] + [{"iteration": 4, "success": 0.5}]
    rows += [{"iteration": i, "x": 10.0 + i, "late": 1.0} for i in range(3, 6)]
    run = read_run(histories.write(tmp_path / "run", rows), "run")
    assert run.columns["x"].tolist() == [0, 1, 2, 13, 14, 15]
    assert run.over["iterations"].tolist() == [1, 2, 3, 4, 5, 6]
    assert np.isnan(run.columns["late"][:3]).all()
    assert len(run.on_the_way) == 0
    assert "history.jsonl goes back from iteration 5 to 4: what follows counts" in run.notes
    assert increments(np.array([2.0, 5.0, np.nan, 1.0, 4.0])).tolist()[:2] == [2, 3]
    assert increments(np.array([2.0, 5.0, np.nan, 1.0, 4.0])).tolist()[3:] == [1, 3]


def test_damaged_lines_are_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    rows = [
        histories.row(0),
        "not json\n",
        "[1, 2]\n",
        '{"iteration": "x"}\n',
        '{"iteration": NaN}\n',
        histories.row(1),
    ]
    odd = {"iteration": 2, "kl": None, "reward": 10**400, "text": "a", "list": [1], "flag": True, "big": 1e300}
    run = read_run(histories.write(tmp_path / "run", [*rows, odd, '{"iteration": 3, "kl": 0.0', ]), "run")  # fmt: skip
    assert len(run) == 3
    assert any("5 of 8 lines could not be read (line 2, 3, 4, 5, 8)" in note for note in run.notes)
    assert np.isnan(run.columns["kl"][2])
    assert np.isnan(run.columns["reward"][2])
    assert {"text", "list", "flag"}.isdisjoint(run.columns)
    assert run.column("big") is None
    nan = histories.write(tmp_path / "nan", ['{"iteration": 0, "kl": NaN, "std": Infinity, "x": 1}\n'])
    assert read_run(nan, "nan").column("kl") is None


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("", "an empty file"),
        ("{}\n", "1 lines, 1 of them unreadable"),
        ('{"iteration": 0, "success": 0}\n', "1 lines, 0"),
    ],
)
def test_a_history_without_an_iteration_is_refused(tmp_path: Path, content: str, found: str) -> None:
    with pytest.raises(RealsimError, match="holds no iteration") as error:
        read_run(histories.write(tmp_path / "run", [content]), "run")
    assert found in str(error.value.found)


def test_folders_that_are_no_run_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    histories.run(tmp_path / "many" / "a", 1)
    for folder, found in (
        (tmp_path / "none", "no such folder"),
        (file, "a file"),
        (tmp_path / "many", "no history.jsonl in it, but in a"),
    ):
        with pytest.raises(RealsimError, match="not the folder of a training run") as error:
            read_runs([folder])
        assert found in str(error.value.found)
        assert error.value.file == str(folder)
    histories.write(tmp_path / "names", [{"iteration": i, f"{i}/{k}": 1} for i in range(30) for k in range(1)])
    with (tmp_path / "names" / "history.jsonl").open("a") as out:
        out.write(json.dumps({"iteration": 40, **{str(k): 1 for k in range(2001)}}) + "\n")
    with pytest.raises(RealsimError, match="not a training history"):
        read_runs([tmp_path / "names"])


def test_runs_are_told_apart_by_the_shortest_name(tmp_path: Path) -> None:
    a, b = histories.run(tmp_path / "a" / "run", 1), histories.run(tmp_path / "b" / "run", 1)
    assert [r.name for r in read_runs([a, b])] == ["a/run", "b/run"]
    assert read_runs([a])[0].name == "run"
    with pytest.raises(RealsimError, match="named twice"):
        read_runs([a, a])


def test_what_lies_beside_the_history(tmp_path: Path) -> None:
    folder = histories.run(tmp_path / "run", 2)
    good = histories.evaluation(trials=30)
    (folder / "evaluation_a.json").write_text(json.dumps(good))
    (folder / "evaluation_b.json").write_text("{")
    (folder / "evaluation_c.json").write_text('{"format": "other"}')
    bad = json.loads(json.dumps(good))
    bad["terrains"][0]["successes"] = 31
    (folder / "evaluation_d.json").write_text(json.dumps(bad))
    (folder / "result.json").write_text(
        json.dumps({"result": {"robot": "g1", "warnings": ["w"]}, "target": 0.9, "before": good})
    )
    run = read_run(folder, "run")
    assert [e.title for e in run.evaluations] == ["before", "evaluation_a"]
    first = run.evaluations[0].result
    assert (first.trials, first.successes, sum(first.reasons.values())) == (30, 20, 10)
    assert sum(sum(counts.values()) for _, _, counts in first.bins) == 10
    assert (run.robot, run.target) == ("g1", 0.9)
    said = " ".join(run.notes)
    assert all(
        name in said for name in ("evaluation_b.json: broken JSON", "evaluation_c: not an", "evaluation_d: not an")
    )
    assert "w" in run.notes
    for text in ("[]", "{", '{"result": 3, "target": "x", "before": 5}'):
        (folder / "result.json").write_text(text)
        assert len(read_run(folder, "run")) == 2


@given(
    st.lists(st.floats(-1e6, 1e6) | st.just(math.nan), min_size=1, max_size=60),
    st.integers(1, 70),
)
def test_bins_keep_the_weighted_mean(values: list[float], width: int) -> None:
    y = np.array(values)
    w = np.arange(len(y), dtype=float)
    means = binned(y, w, width)
    assert len(means) == -(-len(y) // width)
    counted = np.isfinite(y)
    sizes = np.add.reduceat(np.where(counted, w, 0), np.arange(0, len(y), width))
    whole = float(np.nan_to_num(means) @ sizes)
    assert whole == pytest.approx(float((np.nan_to_num(y) * w).sum()), rel=1e-9, abs=1e-3)
