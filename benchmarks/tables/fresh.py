"""The last two fresh seeds of the diagnosis beside what is wanted. No column pools two engines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from statistics import median

from benchmarks.diagnosis import score as gap_score
from benchmarks.tables.stored import Row, answered, counts, stored

FRESH = (2023, "62667f2")
"""(seed, engine) of the last search that was measured on all five robots; README and docs show it. Drawn after that
search was frozen."""
BEFORE = (1823, "304381d")
"""The same of the one before."""
FIXED, WALKING = ("pendulum", "arm2", "arm6"), ("quadruped", "g1")
COLUMNS = {
    f"{FRESH[0]}, fixed base": (FRESH, FIXED),
    f"{FRESH[0]}, walking": (FRESH, WALKING),
    f"{FRESH[0]}, all": (FRESH, (*FIXED, *WALKING)),
    f"{BEFORE[0]}, all, by a search before": (BEFORE, (*FIXED, *WALKING)),
}
"""Title -> the engine on its seed, and which robots."""
WANTED = {
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


def rows_of(seed: int, commit: str) -> list[Row]:
    return [row for row in stored("diagnosis")["rows"] if (row["seed"], row["commit"]) == (seed, commit)]


def fresh() -> list[str]:
    """Each measure, a column for each engine and kind of robot."""
    parts = [[row for row in rows_of(*engine) if row["robot"] in robots] for engine, robots in COLUMNS.values()]
    columns = [measures(rows) for rows in parts]
    lines = [f"| | {' | '.join(COLUMNS)} | wanted |", "|---" * (len(COLUMNS) + 2) + "|"]
    for title, wanted in WANTED.items():
        lines.append(f"| {title} | {' | '.join(share(column[title]) for column in columns)} | {wanted} |")
    return lines


def by_robot() -> list[str]:
    """First places and time, robot by robot."""
    head = "| seed, engine | robot | cases | one cause, named first | both of two | median seconds | slowest |"
    lines = [head, "|---" * 7 + "|"]
    for engine in dict.fromkeys(engine for engine, _ in COLUMNS.values()):
        for robot in (*FIXED, *WALKING):
            rows = [row for row in rows_of(*engine) if row["robot"] == robot]
            took = sorted(float(row["seconds"]) for row in rows if row.get("seconds"))
            times = f"{median(took):.0f} | {took[-1]:.0f}" if took else " | "
            found = counts(rows)
            cells = [
                f"{engine[0]}, {engine[1]}",
                robot,
                str(len(rows)),
                share(found["first"]),
                share(found["both"]),
                times,
            ]
            lines += [f"| {' | '.join(cells)} |"] if rows else []
    return lines


def measures(rows: list[Row]) -> dict[str, tuple[int, int]]:
    """Title -> (hits, cases)."""
    plain = counts(rows)
    return {
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


def share(pair: tuple[int, int]) -> str:
    """Hits and cases, and their share in per cent where there are enough."""
    hits, of = pair
    return f"{hits} of {of}" + (f" ({hits / of:.0%})" if of >= 20 else "") if of else ""


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
