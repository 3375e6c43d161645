"""Which runs are fitted and which are kept unseen."""

from types import SimpleNamespace

import numpy as np

from realsim.gap.config import DiagnoseConfig
from realsim.gap.logs.runs import Run
from realsim.gap.logs.split import split_runs


def case_of(speeds: list[float]) -> SimpleNamespace:
    time = np.linspace(0, 2, 101)
    runs = [
        Run(f"run_{i}", time, (0.3 + 0.01 * i) * np.sin(speed * time)[:, None], {"joint_pos": np.zeros((101, 1))})
        for i, speed in enumerate(speeds)
    ]
    return SimpleNamespace(runs=runs, joint_names=["axis"])


def test_few_runs_keep_the_last_one_unseen():
    assert split_runs(case_of([2.0, 3.0, 2.5, 2.2, 2.8]), DiagnoseConfig()) == ([0, 1, 2, 3], [4])


def test_a_last_run_that_checks_nothing_is_fitted():
    runs = case_of([2.0, 3.0, 2.5, 2.2, 2.8])
    assert split_runs(runs, DiagnoseConfig(), [80.0, 30.0, 90.0, 20.0, 0.5]) == ([0, 2, 3, 4], [1])


def test_the_only_run_that_shows_the_gap_is_fitted():
    runs = case_of([2.0, 3.0, 2.5, 2.2, 2.8])
    assert split_runs(runs, DiagnoseConfig(), [1.0, 1.2, 0.5, 0.9, 70.0]) == ([1, 2, 3, 4], [0])


def test_an_ordinary_last_run_stays_unseen():
    runs = case_of([2.0, 3.0, 2.5, 2.2, 2.8])
    assert split_runs(runs, DiagnoseConfig(), [10.0, 12.0, 5.0, 9.0, 30.0])[1] == [4]


def test_a_single_run_is_fitted_and_none_is_unseen():
    assert split_runs(case_of([2.0]), DiagnoseConfig()) == ([0], [])


def test_of_many_runs_the_one_of_another_regime_is_unseen_too():
    fitted, held = split_runs(case_of([2.0, 2.1, 2.2, 30.0, 2.3, 2.1, 2.2, 2.0]), DiagnoseConfig())
    assert held == [3, 7]
    assert set(fitted) <= {0, 1, 2, 4, 5, 6}


def test_many_alike_runs_need_no_regime_held_out():
    fitted, held = split_runs(case_of([2.0] * 8), DiagnoseConfig())
    assert held[-1] == 7
    assert not set(fitted) & set(held)


def test_of_many_runs_the_liveliest_are_fitted():
    speeds = [2.0, 2.1, 2.2, 2.3, 2.25, 2.05, 2.15, 2.4, 2.0]
    fitted, held = split_runs(case_of(speeds), DiagnoseConfig())
    assert 8 in held
    assert len(fitted) == 6
    assert 0 not in fitted  # the slowest
