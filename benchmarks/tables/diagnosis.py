"""Tables of the diagnosis, of logs and of experiments."""

from statistics import median

from benchmarks.diagnosis import real as gap_real
from benchmarks.diagnosis import sweep as gap_sweep
from benchmarks.tables.fresh import rows_of
from benchmarks.tables.stored import Row, share, stored

REAL = {
    "single_first_right": ("one error: right cause first under a verdict that names one", ""),
    "single_exact": ("one error: `identified`, with exactly that cause", ""),
    "double_both_right": ("two errors: both named", ""),
    "confident_and_wrong": ("`identified` with a wrong cause, one or two errors", "at most 8 %"),
    "nothing_put_in_nothing_named": ("nothing put in, nothing named", "80 %"),
    "first_right": ("lenient: one of the errors first, one or two errors", "75 %"),
}
VISIBLE = (1.0, 1.5, 2.5, 4.0, 8.0)
"""Lower ends of classes: rms change of the motion over the rms that the baseline leaves."""


def real_figures() -> dict[str, tuple[int, int]]:
    """[hits, cases] of each measure on real logs with known errors, by the engine that was measured."""
    rows = stored("gap_real")["rows"]
    exact = [r["verdict"] == "identified" and r["set_right"] for r in rows if r["cls"] == "single"]
    return {name: tuple(v) for name, v in gap_real.figures(rows).items() if name in REAL} | {
        "single_exact": (sum(exact), len(exact))
    }


def real_logs() -> list[str]:
    """Known errors in real logs: the measures, by log, and by how visible the largest error is."""
    rows, found = stored("gap_real")["rows"], real_figures()
    lines = ["| measure | result | bar |", "|---|---|---|"]
    lines += [f"| {title} | {share(found[name])} | {bar} |" for name, (title, bar) in REAL.items()]
    named = [r for r in rows if r["visibility"]]
    right = {id(r): r["first_right"] and r["verdict"] in gap_real.NAMES for r in named}
    for log in sorted({r["log"] for r in named}):
        part = [right[id(r)] for r in named if r["log"] == log]
        lines.append(f"| lenient, {log} | {share((sum(part), len(part)))} | |")
    for low, high in zip(VISIBLE, (*VISIBLE[1:], float("inf")), strict=True):
        part = [right[id(r)] for r in named if low <= max(r["visibility"]) < high]
        title = f"{low:g} to {high:g} times" if high < float("inf") else f"{low:g} times and more"
        lines.append(
            f"| lenient, error changes the motion by {title} the baseline's rest | {share((sum(part), len(part)))} | |"
        )
    return lines


def unseen() -> list[str]:
    """Robots that development never had, drones with known damage, and policies that are run wrongly."""
    rows = stored("gap_put_in")["rows"]
    put_in = [r for r in rows if r["part"] == "put_in" and r["cls"] == "single" and r["judged"] != "not visible"]
    none = [r for r in rows if r["cls"] == "none"]
    once = [r for r in rows if r["part"] == "logs"]
    flown, contract = stored("gap_flights")["rows"], stored("gap_contract")["rows"]
    reports = stored("gap_reports")["rows"]
    damaged, wrong = [r for r in flown if r["truth"]], [r for r in contract if r["kind"]]
    normal, right = [r for r in flown if not r["truth"]], [r for r in contract if not r["kind"]]
    compared = [r for r in flown if r.get("since", "not compared") != "not compared"]
    changed, same = [r for r in compared if r["truth"]], [r for r in compared if not r["truth"]]

    def judged(of: list[Row], *words: str) -> str:
        return share((sum(r["judged"] in words for r in of), len(of)))

    def flagged(of: list[Row], name: str) -> str:
        return share((sum(bool(r[name]) for r in of), len(of)))

    others = stored("gap_strangers")["rows"]
    mistaken, sound = ([r for r in others if r["cls"] == cls] for cls in ("single", "none"))
    alike = ("first right", "equivalent", "among the named")
    lines = [
        ("one visible error in a model: right cause named first", judged(put_in, "first right"), "11 of 13"),
        ("the same, or what moves the robot alike", judged(put_in, *alike), ""),
        ("`identified` with a wrong cause, of all these", judged(rows, "SURE AND WRONG"), "none"),
        ("nothing put in, nothing named", judged(none, "nothing put in, not named"), ""),
        ("logs that once got a wrong answer: right", judged(once, *alike), "all right or honest"),
        ("the same: wrong under a verdict that names a cause", judged(once, "wrong"), ""),
        ("small robots of other shapes, on which it was mended: right cause named first",
         judged(mistaken, "first right"), "60 %"),
        ("the same, or what moves the robot alike", judged(mistaken, *alike), ""),
        ("the same: `identified` with a wrong cause", judged(others, "SURE AND WRONG"), "1 of 20"),
        ("the same: nothing put in, nothing named", judged(sound, "nothing put in, not named"), ""),
        ("damaged drones: mass or thrust, rightly", flagged(damaged, "kind_right"), "80 %"),
        ("damaged drones: at the right arm", flagged(damaged, "arm_right"), "80 %"),
        ("damaged drones: `identified`, and wrong",
         share((sum(r["verdict"] == "identified" and not r["kind_right"] for r in damaged), len(damaged))), "none"),
        ("normal flights, nothing named", flagged(normal, "kind_right"), "all"),
        ("changed since a normal flight: mass or thrust", flagged(changed, "change_right"), "80 %"),
        ("changed since a normal flight: the arm", flagged(changed, "change_arm_right"), "80 %"),
        ("a normal flight since another, no change named", flagged(same, "change_right"), "all"),
        ("policies run wrongly: all mistakes named, and no other", flagged(wrong, "right"), "95 %"),
        ("policies run wrongly: a wrong answer that is sure", flagged(wrong, "wrong_and_sure"), "none"),
        ("policies run rightly: no mistake named", flagged(right, "right"), "40 of 40"),
        ("public reports of errors in the robot: the cause, and no other", judged(reports, "right"), "all"),
        ("the same: something else named", judged(reports, "wrong"), "none"),
    ]  # fmt: skip
    lines = [line for line in lines if compared or "since" not in line[0]]
    return ["| measure | result | bar |", "|---|---|---|", *(f"| {' | '.join(line)} |" for line in lines)]


def experiments() -> list[str]:
    """Diagnoses that were ambiguous, after the recording that was requested and after one at random."""
    rows = [r for r in stored("gap_next")["rows"] if r["verdict"] == "ambiguous"]
    lines = ["| recording | right: `identified` with the true cause alone |", "|---|---|"]
    for key, title in (("asked", "the one that `realsim excite` asks for"), ("random", "another of the library")):
        lines.append(f"| {title} | {share((sum(bool(r.get(key, {}).get('right')) for r in rows), len(rows)))} |")
    return lines


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
    """The same cases with other nuisance deviations and noise."""
    rows = {r["level"]: r for r in stored("gap_sweep")["rows"] if "strata" not in r}
    levels = [level for level in gap_sweep.LEVELS if level in rows]
    titles = [f"deviations x{d:g}" if n == 1 else f"noise x{n:g}" for d, n in map(gap_sweep.LEVELS.get, levels)]
    lines = [f"| | {' | '.join(titles)} | wanted |", "|---" * (len(levels) + 2) + "|"]
    lines.append(f"| cases | {' | '.join(str(rows[level]['cases']) for level in levels)} | |")
    for column, (title, wanted) in SWEPT.items():
        cells = " | ".join("{} of {}".format(*rows[level][column]) for level in levels)
        lines.append(f"| {title} | {cells} | {wanted} |")
    return lines


WANTED_SECONDS = {"pendulum": 15, "arm2": 45, "arm6": 45, "quadruped": 60, "g1": 120}


def times() -> list[str]:
    """Seconds of a core that the fresh cases took."""
    rows = rows_of()
    lines = ["| robot | cases | median, s | longest, s | wanted, s |", "|---|---:|---:|---:|---:|"]
    for robot, wanted in WANTED_SECONDS.items():
        took = sorted(r["cpu_seconds"] for r in rows if r["robot"] == robot)
        lines.append(f"| {robot} | {len(took)} | {median(took):.0f} | {took[-1]:.0f} | {wanted} |")
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
    """Success of a policy on a robot with an unmodelled effect: before, tuned by randomisation alone, and patched."""
    lines = [
        "| the robot | where | verdict | before, % | randomisation alone, % | patched, % |",
        "|---|---|---|---:|---:|---:|",
    ]
    for r in stored("close_the_gap")["rows"]:
        who = "G1 " if r["robot"].startswith("g1 ") else ""
        rates = " | ".join(f"{100 * r[k]['rate']:.0f}" for k in ("before", "random", "patch"))
        lines.append(f"| {who}{r['truth']} | {r['course']} | {r['verdict']} | {rates} |")
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
