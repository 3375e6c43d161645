"""The fresh seeds of the diagnosis beside what is wanted: one engine, every answer."""

from collections.abc import Callable, Iterable

from benchmarks.diagnosis import score as gap_score
from benchmarks.tables.stored import Row, answered, counts, share, stored

ENGINE = "0bf1f62c"
"""Commit of the engine that README and REPORT show."""
DRAWN = {3900: 64}
"""Fresh seed -> its draws, of which two gave no usable case."""
FIXED, WALKING = ("pendulum", "arm2", "arm6"), ("quadruped", "g1")
COLUMNS = {
    "fixed base": FIXED,
    "walking": WALKING,
    "all": (*FIXED, *WALKING),
}
"""Title -> which robots."""
WANTED = {
    "one cause: `identified`, with exactly that cause": "80 %",
    "two causes: `identified`, with exactly these": "",
    "one or two: `identified`, with exactly the true causes": "80 %",
    "one cause, named first": "88 %",
    "one cause, first or as an equivalent": "95 %",
    "two causes, both": "70 %",
    "two causes, both, or as an equivalent": "",
    "nothing wrong, something named": "at most 3 %",
    "outside the library, reported as such": "85 %",
    "look-alikes named": "85 %",
    "90 % intervals hold the truth": "85 to 95 %",
    "`identified`: causes that are right": "",
}


def rows_of() -> list[Row]:
    return [row for row in stored("diagnosis")["rows"] if row["commit"] == ENGINE and row["seed"] in DRAWN]


def fresh() -> list[str]:
    """Each measure, a column for each engine and kind of robot."""
    parts = [[row for row in rows_of() if row["robot"] in robots] for robots in COLUMNS.values()]
    columns = [measures(rows) for rows in parts]
    lines = [f"| | {' | '.join(COLUMNS)} | wanted |", "|---" * (len(COLUMNS) + 2) + "|"]
    for title, wanted in WANTED.items():
        lines.append(f"| {title} | {' | '.join(share(column[title]) for column in columns)} | {wanted} |")
    return lines


def by_robot() -> list[str]:
    """Exact answers and first places, robot by robot."""
    head = "| robot | cases | one cause: exact | one cause: first | two causes: exact | both of two |"
    lines = [head, "|---" * 6 + "|"]
    for robot in (*FIXED, *WALKING):
        rows = [row for row in rows_of() if row["robot"] == robot]
        found = counts(rows)
        exact = [share(exactly(rows, (cls,))) for cls in ("single", "double")]
        cells = [robot, str(len(rows)), exact[0], share(found["first"]), exact[1], share(found["both"])]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def exactly(rows: Iterable[Row], classes: tuple[str, ...]) -> tuple[int, int]:
    """Answers that are `identified` and name the true causes, at all their places, and nothing else."""
    return _share(
        gap_score.exactly_right(row["verdict"], row["causes"], row["truth"]) for row in rows if row["cls"] in classes
    )


def measures(rows: list[Row]) -> dict[str, tuple[int, int]]:
    """Title -> (hits, cases)."""
    plain = counts(rows)
    return {
        "one cause: `identified`, with exactly that cause": exactly(rows, ("single",)),
        "two causes: `identified`, with exactly these": exactly(rows, ("double",)),
        "one or two: `identified`, with exactly the true causes": exactly(rows, ("single", "double")),
        "one cause, named first": plain["first"],
        "one cause, first or as an equivalent": plain["with equivalents"],
        "two causes, both": plain["both"],
        "two causes, both, or as an equivalent": _share(_among(row) for row in rows if row["cls"] == "double"),
        "nothing wrong, something named": plain["false alarms"],
        "outside the library, reported as such": _share(
            gap_score.reported_unexplained(row) for row in rows if row["cls"] == "outside"
        ),
        "look-alikes named": _share(
            row["look_alikes_named"] for row in rows if row.get("look_alikes_named") is not None
        ),
        "90 % intervals hold the truth": _share(held for row in rows for held in row.get("held") or ()),
        "`identified`: causes that are right": _share(_each(rows, "identified", gap_score.hit)),
    }


def _share(hits: Iterable[bool]) -> tuple[int, int]:
    found = list(hits)
    return sum(found), len(found)


def _among(row: Row) -> bool:
    """Whether a set that is named holds both causes."""
    label, found = answered(row)
    sets = [found["causes"], *found["equivalent"]]
    return any(all(any(gap_score.hit(c, t) for c in s) for t in label["effects"]) for s in sets)


def _each(rows: list[Row], verdict: str, hit: Callable[..., bool]) -> Iterable[bool]:
    """Every cause that is named under a verdict: whether it is one of the true ones."""
    for row in rows:
        label, found = answered(row)
        if row["verdict"] == verdict:
            yield from (any(hit(c, t) for t in label["effects"]) for c in found["causes"])
