"""The table of the last fresh seed: what counts as a hit, row by row."""

from typing import Any

from benchmarks.diagnosis.score import exactly_right
from benchmarks.tables.fresh import COLUMNS, by_robot, measures, rows_of
from benchmarks.tables.stored import share


def row(cls: str, truth: list[str], verdict: str, causes: list[str], **more: Any) -> dict[str, Any]:
    said = {"equivalent": [], "unexplained_share": 0.0} | more
    return {"cls": cls, "robot": "arm2", "truth": truth, "verdict": verdict, "causes": causes, **said}


def test_each_measure_counts_its_own_cases() -> None:
    late, early = "command_delay@", "observation_delay@"
    pair = ["armature@a", "payload@b"]
    found = measures([
        row("single", [late], "ambiguous", [early], equivalent=[[late]], held=[]),
        row("single", ["armature@a"], "identified", ["armature@a", "payload@b"], held=[True]),
        row("double", pair, "ambiguous", ["armature@a"], equivalent=[pair], held=[False]),
        row("none", [], "no_gap", []),
        row("outside", ["cogging@a"], "unexplained", []),
        row("outside", ["cogging@a"], "ambiguous", ["payload@b"], unexplained_share=0.4),
        row("confounded", [late], "ambiguous", [late], look_alikes_named=True),
        row("confounded", [late], "no_gap", [], look_alikes_named=False),
    ])  # fmt: skip
    assert found["one cause: `identified`, with exactly that cause"] == (0, 2)
    assert found["one cause, named first"] == (1, 2)
    assert found["one cause, first or as an equivalent"] == (2, 2)
    assert found["two causes, both"] == (0, 1)
    assert found["two causes, both, or as an equivalent"] == (1, 1)
    assert found["nothing wrong, something named"] == (0, 1)
    assert found["outside the library, reported as such"] == (2, 2)
    assert found["look-alikes named"] == (1, 2)
    assert found["90 % intervals hold the truth"] == (1, 2)
    assert found["`identified`: causes that are right"] == (1, 2)


def test_a_share_is_stated_of_twenty_cases_or_more() -> None:
    assert share((3, 4)) == "3 of 4"
    assert share((15, 20)) == "15 of 20 (75%)"
    assert share((0, 0)) == ""


def test_every_case_is_counted_with_its_robot() -> None:
    lines = [line.split(" | ") for line in by_robot()[2:]]
    assert sum(int(line[1]) for line in lines) == len(rows_of())
    assert {row["robot"] for row in rows_of()} == set(COLUMNS["all"])


def test_exactly_right_means_all_places_and_nothing_else() -> None:
    assert exactly_right("identified", ["payload@b", "armature@a+c"], ["armature@c+a", "payload@b"])
    assert exactly_right("identified", ["command_delay@"], ["command_delay@"])
    assert not exactly_right("ambiguous", ["armature@a"], ["armature@a"])
    assert not exactly_right("identified", ["armature@a+b"], ["armature@a"])
    assert not exactly_right("identified", ["armature@a", "payload@b"], ["armature@a"])
