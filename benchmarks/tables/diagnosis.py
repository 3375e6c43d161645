"""Tables of the diagnosis, of logs and of experiments."""

from __future__ import annotations

import re
from statistics import median

from benchmarks.diagnosis import real as gap_real
from benchmarks.diagnosis import sweep as gap_sweep
from benchmarks.diagnosis import unstable as gap_unstable
from benchmarks.tables.stored import Row, counts, of, stored


def diagnosis_by_set() -> list[str]:
    """A row for every seed and engine, and one for all of them."""
    rows = stored("diagnosis")["rows"]
    sets: dict[tuple[int, str], list[Row]] = {}
    for row in rows:
        sets.setdefault((row["seed"], row["commit"]), []).append(row)
    lines = [
        "| seed, engine | robots (cases) | one cause: first | or equivalent | two causes: both "
        "| false alarms | missed gaps |",
        "|---|---|---|---|---|---|---|",
    ]
    for (seed, commit), part in sets.items():
        lines.append(f"| {seed}, {commit} | {robots(part)} | {_cells(part)} |")
    return [*lines, f"| all | {len(rows)} answers | {_cells(rows)} |"]


def diagnosis_by_robot() -> list[str]:
    """The same answers by robot."""
    rows = stored("diagnosis")["rows"]
    lines = [
        "| robot | answers | one cause: first | or equivalent | two causes: both | false alarms | missed gaps |",
        "|---|---|---|---|---|---|---|",
    ]
    for robot in ("pendulum", "arm2", "arm6", "quadruped", "g1"):
        part = [row for row in rows if row["robot"] == robot]
        lines.append(f"| {robot} | {len(part)} | {_cells(part)} |")
    return lines


def _cells(rows: list[Row]) -> str:
    return " | ".join(of(pair) for pair in counts(rows).values())


def robots(rows: list[Row]) -> str:
    """Robots of some cases, and how many cases of each."""
    names = [row["robot"] for row in rows]
    return ", ".join(f"{name} {names.count(name)}" for name in dict.fromkeys(sorted(names)))


def diagnosis_intervals() -> list[str]:
    """What is stored of a seed as a whole."""
    lines = [
        "| seed | 90 % intervals that hold the truth | reported as unexplained when the cause is outside the library "
        "| look-alikes named | median share of the gap removed on the held-out run, correct cause |",
        "|---|---|---|---|---|",
    ]
    for s in stored("diagnosis")["sets"]:
        gone = s["gap_gone_median_where_right"]
        held = of(s["ci90_holds_truth"] or (0, 0))
        cells = (held, of(s["outside_said"]), of(s["confounded_named"]), "" if gone is None else f"{100 * gone:.1f} %")
        name = ", ".join(str(s[k]) for k in ("seed", "commit") if k in s)
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


REAL = {
    "confident_and_wrong": ("`identified` with a wrong cause", "at most 8 %"),
    "first_right": ("right cause first under a verdict that names one", "75 %"),
    "right_where_a_cause_is_named": ("right cause first, of the answers that name one", ""),
    "double_both_right": ("both of two errors", ""),
    "nothing_put_in_nothing_named": ("nothing put in, nothing named", "80 %"),
}
VISIBLE = (1.0, 1.5, 2.5, 4.0, 8.0)
"""Lower ends of classes: rms change of the motion over the rms that the baseline leaves."""


def real_logs() -> list[str]:
    """Known errors in real logs: the measures with their bars, by log, and by how visible the largest error is.

    A column for each engine, each of all cases in one go.
    """
    engines: dict[str, list[Row]] = {}
    for row in stored("gap_real")["rows"]:
        engines.setdefault(row["engine"], []).append(row)
    columns = [_of_engine(rows) for rows in engines.values()]
    lines = [f"| measure | {' | '.join(engines)} | bar |", "|---|" + "---|" * (len(engines) + 1)]
    for measure, (_, bar) in columns[0].items():
        lines.append(f"| {measure} | {' | '.join(column[measure][0] for column in columns)} | {bar} |")
    return lines


def _of_engine(rows: list[Row]) -> dict[str, tuple[str, str]]:
    """Measure -> (result, bar) of one engine."""
    found = gap_real.figures(rows)

    def of(share: list[int]) -> str:
        return f"{share[0]} of {share[1]}" + (f" ({share[0] / share[1]:.0%})" if share[1] else "")

    lines = {title: (of(found[name]), bar) for name, (title, bar) in REAL.items()}
    for log, share in found["first_right_by_log"].items():
        lines[f"right cause first, whatever the verdict, {log}"] = of(share), ""
    for low, high in zip(VISIBLE, (*VISIBLE[1:], float("inf")), strict=True):
        part = [r for r in rows if r["visibility"] and low <= max(r["visibility"]) < high]
        right = [sum(r["first_right"] and r["verdict"] in gap_real.NAMES for r in part), len(part)]
        title = f"{low:g} to {high:g}" if high < float("inf") else f"{low:g} and more"
        lines[f"right and named, change {title} times what the baseline leaves"] = of(right), ""
    for cls, verdicts in found["verdicts"].items():
        said = ", ".join(f"{count} `{verdict}`" for verdict, count in verdicts.items())
        lines[f"verdicts, {cls}"] = said, ""
    return lines


def experiments() -> list[str]:
    """The sums of every seed and engine, and the ambiguous cases of the last, whatever became of them."""
    rows = stored("gap_next")["rows"]
    runs = list(dict.fromkeys((r["seed"], r["engine"]) for r in rows))
    lines = [
        "| robot, true cause | could not tell | asked for | then | at random | then |",
        "|---|---|---|---|---|---|",
    ]
    for seed, engine in runs:
        drawn = [r for r in rows if (r["seed"], r["engine"]) == (seed, engine)]
        ambiguous = [r for r in drawn if r["verdict"] == "ambiguous"]
        lines += [_experiment(r) for r in ambiguous] if (seed, engine) == runs[-1] else []
        right = {key: sum(bool(r.get(key, {}).get("right")) for r in ambiguous) for key in ("asked", "random")}
        of = f"of {len(ambiguous)}"
        lines.append(
            f"| seed {seed}, engine {engine}, {len(drawn)} drawn: the true cause alone | | | {right['asked']} {of} "
            f"| | {right['random']} {of} |"
        )
    return lines


def _experiment(r: Row) -> str:
    asked, other = r.get("asked", {}), r.get("random", {})
    sets = " or ".join(" with ".join(s) for s in r["sets"])
    asks, random = asked.get("excitation") or "nothing", other.get("excitation", "nothing")
    return f"| {r['robot']}, {', '.join(r['truth'])} | {sets} | {asks} | {_then(asked)} | {random} | {_then(other)} |"


def _then(found: Row) -> str:
    if "verdict" not in found:
        return "-"
    return f"{found['verdict']}{', right' if found.get('right') else ''}"


def unstable() -> list[str]:
    """Robots that only their controller holds up: replayed as a whole, and in parts."""
    return gap_unstable.table(stored("gap_unstable")["rows"])


SWEPT = {
    "false_alarms": ("nothing wrong, something named", "10 % at x2"),
    "single_top1": ("one cause, named first", ""),
    "single_top1_with_equivalents": ("one cause, first or as an equivalent", ""),
    "double_both_found": ("two causes, both", ""),
    "outside_said": ("outside the library, reported as such", ""),
    "confounded_named": ("look-alikes named", ""),
    "ci90_holds_truth": ("90 % intervals hold the truth", ""),
    "missed_gaps": ("gaps missed", ""),
    "identified_right": ("`identified`: causes that are right", "90 % at x2"),
}


def sweep() -> list[str]:
    """The same cases with other everyday deviations and noise, by the last engine that was swept."""
    rows = [r for r in stored("gap_sweep")["rows"] if "strata" not in r]
    last = {r["level"]: r for r in rows if r["engine"] == rows[-1]["engine"]}
    levels = [level for level in gap_sweep.LEVELS if level in last]
    titles = [f"deviations x{d:g}" if n == 1 else f"noise x{n:g}" for d, n in map(gap_sweep.LEVELS.get, levels)]
    lines = [f"| | {' | '.join(titles)} | wanted |", "|---" * (len(levels) + 2) + "|"]
    lines.append(f"| cases | {' | '.join(str(last[level]['cases']) for level in levels)} | |")
    for column, (title, wanted) in SWEPT.items():
        cells = " | ".join("{} of {}".format(*last[level][column]) for level in levels)
        lines.append(f"| {title} | {cells} | {wanted} |")
    return lines


WANTED_SECONDS = {"pendulum": 15, "arm2": 45, "arm6": 45, "quadruped": 150, "g1": 300}


def times() -> list[str]:
    """Seconds of a diagnosis on two free cores, by the last engine that was timed."""
    rows = stored("gap_times")["rows"]
    rows = [r for r in rows if (r["seed"], r["engine"]) == (rows[-1]["seed"], rows[-1]["engine"])]
    lines = ["| robot | cases | median, s | all, s | wanted |", "|---|---|---|---|---|"]
    for robot, wanted in WANTED_SECONDS.items():
        took = sorted(r["seconds"] for r in rows if r["robot"] == robot)
        each = ", ".join(f"{s:.0f}" for s in took)
        lines.append(f"| {robot} | {len(took)} | {median(took):.0f} | {each} | {wanted} |")
    return lines


def drift() -> list[str]:
    """Two logs of one robot, with and without a change in between."""
    rows = stored("gap_since")["rows"]
    lines = ["| robot | cause at both times | change | answer |", "|---|---|---|---|"]
    for r in sorted(rows, key=lambda r: (not r["truth"], r["pair"])):
        sets = " or ".join(" with ".join(s) for s in r.get("sets", []) if s)
        both, truth = ", ".join(r["both"]) or "none", ", ".join(r["truth"]) or "none"
        old = "" if "engine" in r else " (by the search before)"
        lines.append(f"| {r['robot']} | {both} | {truth} | {r['verdict']}{f': {sets}' if sets else ''}{old} |")
    return lines


def closing() -> list[str]:
    """What fine-tuning with a diagnosis and with randomisation alone regained, robot by robot."""
    lines = [
        "| the robot | where | diagnosis | before | randomisation alone | regained | patched | regained |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in stored("close_the_gap")["rows"]:
        causes = [re.sub(r" at ([^:]*,[^:]*,[^:]*,[^:]*):", _counted, c) for c in r["causes"]]
        said = f"{r['verdict']}: {'; '.join(causes)}" if causes else r["verdict"]
        cells = [_walked(r["before"])]
        for arm in ("random", "patch"):
            back = r[f"regained_{arm}"]
            cells += [_walked(r[arm]), f"{100 * back['rate']:.0f} %, {100 * back['speed']:.0f} %"]
        many = "all effects" if r["effects_considered"] == "all" else "five effects"
        who = "G1 " if r["robot"].startswith("g1 ") else ""
        lines.append(f"| {who}{r['truth']} | {r['course']} | {many}; {said} | {' | '.join(cells)} |")
    return lines


def _counted(places: re.Match[str]) -> str:
    """Many places as their number."""
    return f" at {places[1].count(',') + 1} places:"


def _walked(r: Row) -> str:
    low, high = r["interval"]
    return f"{100 * r['rate']:.0f} % [{100 * low:.0f}, {100 * high:.0f}], {r['speed']:.2f} m/s"


def bags() -> list[str]:
    """The same frames as a folder and as a bag."""
    lines = ["| terrain | read from | verdict | F at 1 cm | tops off | tilt | CPU seconds |", "|" + "---|" * 7]
    for r in stored("bag_scene")["rows"]:
        figures = f"{r['f_score_1cm']:.3f} | {r['tops_mm']:.2f} mm | {r['tilt_deg']:.3f}°"
        lines.append(f"| {r['terrain']} | {r['source']} | {r['verdict']} | {figures} | {r['cpu_seconds']:.0f} |")
    return lines


def footholds() -> list[str]:
    """By change: how often it was named, what else was, and the range of values."""
    rows = [r for r in stored("footholds")["rows"] if "fell" not in r]
    lines = [
        "| change under one of 18 footholds | cases | named | other names | value found |",
        "|---|---|---|---|---|",
    ]
    for change in dict.fromkeys(r["change"] for r in rows):
        mine = [r for r in rows if r["change"] == change]
        named = "-" if change == "none" else f"{sum(r['right'] for r in mine)} of {len(mine)}"
        what, scale, unit = FOOTHOLDS.get(change, ("", 1.0, ""))
        found = [scale * r[what][0] for r in mine if what in r]
        value = f"{min(found):.3g} to {max(found):.3g}{unit}" if found else "-"
        lines.append(f"| {change} | {len(mine)} | {named} | {sum(r['false'] for r in mine)} | {value} |")
    return lines


FOOTHOLDS = {
    "lower 2 cm": ("height", 1000.0, " mm"),
    "higher 2 cm": ("height", 1000.0, " mm"),
    "tilted 6 deg": ("tilt_y", 57.2958, "°"),
    "soft 4 kN/m": ("give", 1000.0, " mm under the robot's weight"),
    "friction 0.12": ("friction", 1.0, ""),
    "rocks 45 N m/rad": ("wobble", 1000.0, " mm"),
}
"""Change -> the quantity that shows it, its scale and unit."""
