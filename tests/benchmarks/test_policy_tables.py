"""Tables of policies: bases are distinguished, and nothing of two is added up."""

import hashlib

from benchmarks.tables.stored import stored
from benchmarks.training import base_policy, ttt
from trainer.policies import BASES, base_of


def test_a_base_stands_beside_the_one_before_it() -> None:
    rows = [
        {"robot": "g1", "base": base, "course": "beams:0.8", "setting": "full", "trials": 40, "success": won}
        for base, won in (("first", 2), ("second", 10), ("third", 20))
    ]
    line = base_policy.table(rows)[-1]
    assert "50.0 %" in line
    assert "(25.0)" in line
    assert line.endswith("| 40 |")
    assert base_policy.grouped(rows, "full", base="first") == {"beams:0.8": (2, 40)}
    assert not any("(" in line for line in base_policy.table(rows[:1]))


def test_the_tables_are_of_the_bases_that_ship() -> None:
    for robot in BASES:
        bases = base_policy.bases(stored("base_policy")["rows"], robot)
        assert hashlib.sha256(base_of(robot).read_bytes()).hexdigest().startswith(bases[-1])


def test_fine_tuning_says_what_it_began_with() -> None:
    row = {"test": "boxes", "source": "exact", "strategy": "full", "minutes": 5.0, "seed": 0, "trials": 10, "won": 9}
    row |= {"iterations": 3, "to_target": None}
    rows = [
        row | {"base": "a", "method": "ttt1"},
        row | {"base": "b", "method": "ttt1", "won": 10},
        row | {"base": "a", "method": "scratch", "won": 0},
    ]
    head, _, line = ttt.table(rows, {"a": "from A", "b": "from B"})
    assert head == "| test | scratch, 5 min | ttt1, 5 min, from A | ttt1, 5 min, from B |"
    assert line.count("3 iterations, 97 % after never") == 3
    assert [cell in line for cell in ("0.0 %", "90.0 %", "100.0 %")] == [True] * 3
    assert ttt.table(rows[:2])[0] == "| test | ttt1, 5 min |"


def test_every_seed_stands_in_its_cell() -> None:
    row = {"base": "a", "test": "boxes", "method": "ttt1", "source": "exact", "strategy": "full", "minutes": 5.0}
    rows = [
        row | {"seed": 1, "trials": 10, "won": 8, "iterations": 5, "to_target": None},
        row | {"seed": 0, "trials": 10, "won": 9, "won_robust": 7, "iterations": 4, "to_target": 2},
    ]
    assert "seeds 0, 1: 90.0, 80.0 % (robust 70.0, - %), 4, 5 iterations, 97 % after 2, never" in ttt.table(rows)[-1]
