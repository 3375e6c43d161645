"""Which runs are fitted and which are kept unseen."""

from types import SimpleNamespace

import numpy as np
import pytest

from realsim.gap.case.runs import Run
from realsim.gap.case.split import split_runs
from realsim.gap.config import DiagnoseConfig


def case_of(speeds: list[float], joints: int = 1) -> SimpleNamespace:
    time = np.linspace(0, 2, 101)
    runs = [
        Run(f"run_{i}", time, (0.3 + 0.01 * i) * np.sin(speed * time)[:, None], {"joint_pos": np.zeros((101, 1))})
        for i, speed in enumerate(speeds)
    ]
    model = SimpleNamespace(nv=joints, opt=SimpleNamespace(timestep=0.002))
    return SimpleNamespace(runs=runs, joint_names=["axis"] * joints, added=(), model=model)


def test_few_runs_keep_the_last_one_unseen():
    assert split_runs(case_of([2.0, 3.0, 2.5, 2.2, 2.8]), DiagnoseConfig()) == ([0, 1, 2, 3], [4])


def moving(sizes: list[float]) -> SimpleNamespace:
    """Runs whose commands are these many times as large."""
    case = case_of([2.0, 3.0, 2.5, 2.2, 2.8])
    for run, size in zip(case.runs, sizes, strict=True):
        run.command[:] *= size
    return case


def test_a_last_run_that_checks_nothing_is_fitted():
    assert split_runs(moving([1.0, 1.0, 1.0, 1.0, 0.01]), DiagnoseConfig())[1] == [2]


def test_the_only_run_that_moves_is_fitted():
    assert split_runs(moving([0.1, 0.1, 0.1, 0.1, 7.0]), DiagnoseConfig())[1] != [4]


def test_an_ordinary_last_run_stays_unseen():
    assert split_runs(moving([1.0, 1.2, 0.5, 0.9, 3.0]), DiagnoseConfig())[1] == [4]


def test_what_was_measured_decides_nothing():
    case = case_of([2.0, 3.0, 2.5, 2.2, 2.8])
    before = split_runs(case, DiagnoseConfig())
    for run in case.runs:
        run.signals["joint_pos"][:] = np.random.default_rng(0).normal(size=(101, 1))
    assert split_runs(case, DiagnoseConfig()) == before


def test_a_single_run_is_fitted_and_none_is_unseen():
    assert split_runs(case_of([2.0]), DiagnoseConfig()) == ([0], [])


def test_with_two_runs_none_is_unseen():
    assert split_runs(case_of([2.0, 3.0]), DiagnoseConfig()) == ([0, 1], [])


def repeated(commands: str) -> SimpleNamespace:
    """Runs whose commands have these names."""
    case = case_of([2.0 + "ABCDEFGH".index(name) for name in commands])
    for run in case.runs:
        run.command[:] /= np.abs(run.command).max()
    return case


@pytest.mark.parametrize(
    ("commands", "held"),
    [
        ("AABB", [2, 3]),
        ("ABAB", [1, 3]),
        ("ABBA", [0, 3]),
        ("AABBCC", [4, 5]),
        ("AABBC", [4]),
        ("ABCA", [2]),
        ("AAA", []),
    ],
)
def test_no_repetition_of_a_fitted_run_is_unseen(commands: str, held: list[int]):
    fitted = [i for i in range(len(commands)) if i not in held]
    assert split_runs(repeated(commands), DiagnoseConfig()) == (fitted, held)


def test_repetitions_that_hardly_move_are_fitted():
    case = repeated("AABBCC")
    for run in case.runs[4:]:
        run.command[:] *= 0.001
    assert split_runs(case, DiagnoseConfig())[1] in ([0, 1], [2, 3])


def test_more_groups_than_there_are_leave_none_unseen():
    assert split_runs(repeated("AABB"), DiagnoseConfig(holdout=2))[1] == []


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
    fitted, _ = split_runs(case_of(speeds), DiagnoseConfig())
    assert len(fitted) == 6
    assert 0 not in fitted  # the slowest


def test_of_runs_that_take_long_three_are_fitted_and_the_others_check():
    fitted, held = split_runs(case_of([2.0, 2.3, 2.1, 2.4, 2.2, 2.05], joints=200), DiagnoseConfig())
    assert fitted == [1, 3, 4]
    assert held == [0, 2, 5]


def test_every_run_that_is_not_fitted_is_a_check():
    fitted, held = split_runs(case_of([2.0 + 0.01 * i for i in range(12)]), DiagnoseConfig())
    assert sorted([*fitted, *held]) == list(range(12))


def test_a_spare_repetition_of_a_fitted_run_is_no_check():
    fitted, held = split_runs(repeated("ABCDEFAG"), DiagnoseConfig())
    assert len(fitted) == 6
    assert held == [7]


def test_nothing_is_a_check_where_none_is_asked_for():
    assert split_runs(case_of([2.0 + 0.01 * i for i in range(12)]), DiagnoseConfig(holdout=0))[1] == []
