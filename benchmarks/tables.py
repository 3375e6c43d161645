"""The tables of figures in README.md and docs/figures.md, made from benchmarks/results.

    python -m benchmarks.tables           # writes them between their marks
    python -m benchmarks.tables --check   # exit code 1 if a page differs from what is stored

A table stands between `<!-- figures: NAME -->` and `<!-- end -->`. Nothing is selected by outcome: the diagnosis has a
row for every seed and engine that was measured on cases unknown to its development, and their sum.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import base_policy, gap_real, gap_score, reconstruct, ttt
from benchmarks import loops as places

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = ("README.md", "docs/figures.md", "docs/gap_figures.md", "docs/captures.md", "benchmarks/results/README.md")
Row = dict[str, Any]


def stored(name: str) -> Any:
    """The content of a file of benchmarks/results."""
    return json.loads((RESULTS / f"{name}.json").read_text())


# ---------------------------------------------------------------- the diagnosis


def answered(row: Row) -> tuple[dict[str, Any], dict[str, Any]]:
    """A stored case as the label and the diagnosis that `gap_score` scores."""

    def cause(text: str) -> dict[str, Any]:
        effect, _, places = text.partition("@")
        return {"effect": effect, "joints": [p for p in re.split(r"[+,]", places) if p], "bodies": []}

    label = {"effects": [cause(t) for t in row["truth"]], "equivalents": []}
    found = {
        "verdict": row["verdict"],
        "causes": [cause(c) for c in row["causes"]],
        "equivalent": [[cause(c) for c in group] for group in row["equivalent"]],
        "unexplained_share": row["unexplained_share"],
    }
    return label, found


def counts(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """Hits and cases of each question that can be put to stored rows."""
    by: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for row in rows:
        by.setdefault(row["cls"], []).append(answered(row))
    single, double, none = by.get("single", []), by.get("double", []), by.get("none", [])
    gaps = [*single, *double, *by.get("outside", [])]
    first = [gap_score.top1(*case) for case in single]
    both = [all(any(gap_score.hit(c, t) for c in f["causes"]) for t in x["effects"]) for x, f in double]
    return {
        "first": (sum(t == 2 for t in first), len(single)),
        "with equivalents": (sum(t >= 1 for t in first), len(single)),
        "both": (sum(both), len(double)),
        "false alarms": (sum(f["verdict"] != "no_gap" for _, f in none), len(none)),
        "missed": (sum(f["verdict"] == "no_gap" for _, f in gaps), len(gaps)),
    }


def of(pair: tuple[int, int]) -> str:
    """Hits and cases as a table shows them."""
    return f"{pair[0]} of {pair[1]}" if pair[1] else ""


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
    return [*lines, f"| all | {len(rows)} cases | {_cells(rows)} |"]


def diagnosis_by_robot() -> list[str]:
    """The same cases by robot."""
    rows = stored("diagnosis")["rows"]
    lines = [
        "| robot | cases | one cause: first | or equivalent | two causes: both | false alarms | missed gaps |",
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
        gone = 100 * s["gap_gone_median_where_right"]
        cells = (of(s["ci90_holds_truth"]), of(s["outside_said"]), of(s["confounded_named"]), f"{gone:.1f} %")
        lines.append(f"| {s['seed']} | {' | '.join(cells)} |")
    return lines


# ---------------------------------------------------------------- the README


FRESH = 202
"""The last seed that the search was measured on with enough cases for a table; its engine is named beside it."""


def readme() -> list[str]:
    """The README's one table: at most eight rows, each with the section of docs/figures.md that it is from."""
    scenes = {
        mode: [
            r for r in stored("reconstruct")["rows"]
            if r["capture"] in reconstruct.NAMES and r["method"] == f"realsim, poses {mode}"
        ]
        for mode in reconstruct.MODES
    }  # fmt: skip
    latest = [row for row in stored("diagnosis")["rows"] if row["seed"] == FRESH]
    fresh = counts(latest)
    engine = ", ".join(dict.fromkeys(row["commit"] for row in latest))
    measured_on = f"seed {FRESH}, drawn after the search was settled, by {engine}: {robots(latest)}"
    contact = next(line for line in stored("contact")["summary"] if line.startswith("| `auto` | 13 exact")).split("|")
    seconds = [r["seconds"] for rows in scenes.values() for r in rows]
    rows = [
        (
            "Scene: height of obstacles, camera poses given / unknown",
            " / ".join(f"{_span([r['delivered_tops_mm'] for r in rows], '{:.1f}')} mm" for rows in scenes.values()),
            "3 rendered captures with sensor noise",
        ),
        (
            "Scene: error of scale, camera poses given / unknown",
            " / ".join(f"{_span([100 * r['scale_error'] for r in rows], '{:.2f}')} %" for rows in scenes.values()),
            "the same; without poses the sensor's own error stays",
        ),
        (
            "Scene: from frames to a checked scene",
            f"{_span(seconds, '{:.0f}')} s",
            "60 frames, two cores, no GPU",
        ),
        (
            "Contact: deviation from the mesh, median / 95th percentile, worst mesh",
            f"{contact[3].strip()} / {contact[4].strip()} mm",
            "13 meshes, measured with balls in MuJoCo",
        ),
        (
            "Diagnosis: a single cause is named first / or as an equivalent",
            f"{of(fresh['first'])} / {of(fresh['with equivalents'])}",
            measured_on,
        ),
        (
            "Diagnosis: both of two causes are found",
            of(fresh["both"]),
            "the same",
        ),
        (
            "Diagnosis: a cause is named where nothing is wrong",
            of(fresh["false alarms"]),
            "the same",
        ),
        (
            "Policy: G1 crosses unseen courses of difficulty 0.5 / 0.8, mean and worst of eight families",
            " / ".join(_families(difficulty) for difficulty in ("0.5", "0.8")),
            "the base that ships, not fine-tuned, in simulation; 49 minutes of training on one GPU",
        ),
    ]
    return ["| | figure | measured on |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]


def _families(difficulty: str) -> str:
    groups = base_policy.grouped(stored("base_policy")["rows"], "mild")
    shares = [100 * won / of for name, (won, of) in groups.items() if name.endswith(f":{difficulty}")]
    return f"{sum(shares) / len(shares):.0f} and {min(shares):.0f} %"


def base() -> list[str]:
    """The base policy on every family, difficulty and test."""
    return base_policy.table(stored("base_policy")["rows"])


def quadruped_base() -> list[str]:
    """The same of the quadruped's."""
    return base_policy.table(stored("base_policy")["rows"], "quadruped")


def tuned() -> list[str]:
    """The thirteen tests before and after fine-tuning on each."""
    return ttt.table(stored("ttt")["rows"])


def _span(values: list[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def captures() -> list[str]:
    """Errors of reconstructed captures with exact truth."""
    head = [
        "| capture, camera poses | scale | tilt | heading | origin | tops, as delivered | F-score at 1 cm / 2 cm |",
        "|---|---|---|---|---|---|---|",
    ]
    return head + reconstruct.readme_table(stored("reconstruct")["rows"])


def loops() -> list[str]:
    """What became of places that look alike, by kind of place."""
    return places.table(stored("loops")["rows"])


VERDICTS = {"good": "good", "look": "check first", "bad": "do not use", "refused": "refused"}


def real_captures() -> list[str]:
    """What becomes of captures that real sensors and apps wrote."""
    head = [
        "| capture | frames | verdict | platforms, goal | contact median / p95, leaks | side rays that stop | "
        "heights off > 2 cm | CPU, memory | known | found |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    return head + [_real_capture(row) for row in stored("real_captures")["rows"]]


def _real_capture(row: Row) -> str:
    cost = f"{row['cpu_s']:.0f} s, {row['peak_gb']:.1f} GB"
    if row["verdict"] == "refused":
        return f"| {row['capture']} | | refused | | | | | {cost} | {row['known']} | |"
    frames = f"{row['frames']} of {row['frames'] + row['dropped']}" if row["frames"] else "scan"
    sides = "too few" if row["sides_stopped"] is None else f"{100 * row['sides_stopped']:.1f} %"
    contact = f"{row['median_mm']:.1f} / {row['p95_mm']:.1f} mm, {row['leaks']}"
    return (
        f"| {row['capture']} | {frames} | {VERDICTS[row['verdict']]} | {row['platforms']}, "
        f"{'yes' if row['goal'] else 'no'} | {contact} ({row['representation']}) | {sides} | "
        f"{100 * row['heights_off']:.0f} % | {cost} | {row['known']} | {row['found']} |"
    )


def hard_matches() -> list[str]:
    """Captures that are hard to match, without and with the learned matcher."""
    lines = [
        "| capture | changed | frames placed | ATE | worst step | seconds | pairs asked, joined |",
        "|---|---|---|---|---|---|---|",
    ]
    pairs: dict[tuple[Any, ...], dict[bool, Row]] = {}
    for row in stored("matching")["rows"]:
        pairs.setdefault((row["capture"], row["kind"], row["frames"]), {})[row["learned"]] = row
    for pair in (p for p in pairs.values() if len(p) == 2):
        row = pair[True]
        asked = row.get("asked")  # not stored where nothing was placed
        both = [row] if asked == 0 else [pair[False], row]
        placed = " / ".join(str(r["placed"]) for r in both)
        figures = [
            " / ".join(f"{r[k]:.0f}{unit}" if k in r else "-" for r in both)
            for k, unit in (("ate_mm", " mm"), ("worst_step_mm", " mm"), ("seconds", ""))
        ]
        change = "" if row["kind"] == "as it is" else row["kind"]
        joined = "not asked" if asked == 0 else f"{asked}, {row['joined']}" if asked else "-"
        lines.append(
            f"| {row['capture']} | {change} | {placed} of {row['frames']} | {' | '.join(figures)} | {joined} |"
        )
    return lines


def contact() -> list[str]:
    """Measured contact by representation."""
    return list(stored("contact")["summary"])


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
    """Known errors in real logs: the measures with their bars, by log, and by how visible the largest error is."""
    rows = stored("gap_real")["rows"]
    found = gap_real.figures(rows)

    def of(share: list[int]) -> str:
        return f"{share[0]} of {share[1]}" + (f" ({share[0] / share[1]:.0%})" if share[1] else "")

    lines = ["| measure | result | bar |", "|---|---|---|"]
    lines += [f"| {title} | {of(found[name])} | {bar} |" for name, (title, bar) in REAL.items()]
    lines += [f"| right cause first, {log} | {of(share)} | |" for log, share in found["first_right_by_log"].items()]
    for low, high in zip(VISIBLE, (*VISIBLE[1:], float("inf")), strict=True):
        part = [r for r in rows if r["visibility"] and low <= max(r["visibility"]) < high]
        right = [sum(r["first_right"] and r["verdict"] in gap_real.NAMES for r in part), len(part)]
        title = f"{low:g} to {high:g}" if high < float("inf") else f"{low:g} and more"
        lines.append(f"| right and named, change {title} times what the baseline leaves | {of(right)} | |")
    for cls, verdicts in found["verdicts"].items():
        said = ", ".join(f"{count} `{verdict}`" for verdict, count in verdicts.items())
        lines.append(f"| verdicts, {cls} | {said} | |")
    return lines


def experiments() -> list[str]:
    """Every ambiguous case, whatever became of it, and the sums."""
    rows = [r for r in stored("gap_next")["rows"] if r["verdict"] == "ambiguous"]
    lines = [
        "| robot, true cause | could not tell | asked for | then | at random | then |",
        "|---|---|---|---|---|---|",
    ]
    for r in rows:
        asked, other = r.get("asked", {}), r.get("random", {})
        sets = " or ".join(" with ".join(s) for s in r["sets"])
        asks = asked.get("excitation") or "nothing"
        lines.append(
            f"| {r['robot']}, {', '.join(r['truth'])} | {sets} | {asks} | {_then(asked)} "
            f"| {other.get('excitation', 'nothing')} | {_then(other)} |"
        )
    right = {key: sum(bool(r.get(key, {}).get("right")) for r in rows) for key in ("asked", "random")}
    lines.append(
        f"| sum: the true cause alone | | | {right['asked']} of {len(rows)} | | {right['random']} of {len(rows)} |"
    )
    return lines


def _then(found: Row) -> str:
    if "verdict" not in found:
        return "-"
    return f"{found['verdict']}{', right' if found.get('right') else ''}"


def drift() -> list[str]:
    """Two logs of one robot, with and without a change in between."""
    rows = stored("gap_since")["rows"]
    lines = ["| robot | cause at both times | change | said |", "|---|---|---|---|"]
    for r in sorted(rows, key=lambda r: (not r["truth"], r["pair"])):
        sets = " or ".join(" with ".join(s) for s in r.get("sets", []) if s)
        both, truth = ", ".join(r["both"]) or "none", ", ".join(r["truth"]) or "none"
        old = "" if "engine" in r else " (by the search before)"
        lines.append(f"| {r['robot']} | {both} | {truth} | {r['verdict']}{f': {sets}' if sets else ''}{old} |")
    return lines


def closing() -> list[str]:
    """What fine-tuning with a diagnosis and with randomisation alone regained, robot by robot."""
    lines = [
        "| the robot | diagnosis | before | randomisation alone | regained | diagnosed and patched | regained |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in stored("close_the_gap")["rows"]:
        causes = [re.sub(r" at ([^:]*,[^:]*,[^:]*,[^:]*):", _counted, c) for c in r["causes"]]
        said = f"{r['verdict']}: {'; '.join(causes)}" if causes else r["verdict"]
        cells = [_walked(r["before"])]
        for arm in ("random", "patch"):
            back = r[f"regained_{arm}"]
            cells += [_walked(r[arm]), f"{100 * back['rate']:.0f} %, {100 * back['speed']:.0f} %"]
        lines.append(f"| {r['truth']} | {said} | {' | '.join(cells)} |")
    return lines


def _counted(places: re.Match[str]) -> str:
    """Many places as their number."""
    return f" at {places[1].count(',') + 1} places:"


def _walked(r: Row) -> str:
    low, high = r["interval"]
    return f"{100 * r['rate']:.0f} % [{100 * low:.0f}, {100 * high:.0f}], {r['speed']:.2f} m/s"


# ---------------------------------------------------------------- the index

INDEX = (
    ("Scenes against exact truth, and against two real captures", "reconstruct", "python benchmarks/reconstruct.py"),
    (
        "Time and memory by the number of frames",
        "reconstruct_scaling",
        "python benchmarks/reconstruct.py --frames N ...",
    ),
    ("Error of the metric scale by source of points and poses", "scale_error", "python benchmarks/scale_error.py"),
    ("Contact against the mesh, by representation", "contact", "python benchmarks/contact.py"),
    ("Diagnosis of generated cases, labels withheld", "diagnosis", "python benchmarks/gap_withheld.py --seed SEED"),
    (
        "Answers for 48 logs whose labels are withheld: not scored here",
        "gap_blind",
        "python benchmarks/gap_blind.py store",
    ),
    (
        "Diagnosis of real logs with known errors in their models",
        "gap_real",
        "python benchmarks/gap_real.py score --part report",
    ),
    ("Diagnosis beside mujoco.sysid", "gap_sysid", "python benchmarks/gap_sysid.py"),
    ("Speed of training", "trainer_speed", "python benchmarks/trainer_speed.py"),
    ("Learning on one CPU core", "trainer_cpu", "python benchmarks/trainer_cpu.py"),
    ("First learning rate of fine-tuning", "trainer_tune", "python benchmarks/trainer_tune.py"),
    ("Places that repeat, and an unregistered Kinect", "captures", "python benchmarks/captures.py"),
    ("Loops in places that look alike", "loops", "python benchmarks/loops.py"),
    ("Captures that real sensors and apps wrote", "real_captures", "python benchmarks/real_captures.py"),
    (
        "Frames that are hard to match, with and without the learned matcher",
        "matching",
        "python benchmarks/matching.py",
    ),
    ("The same frames as a folder and as a ROS bag", "bag_scene", "python benchmarks/bag_scene.py"),
    ("A depth camera that is late, turned, or right", "gap_depth", "python benchmarks/gap_depth.py"),
    ("Mistakes between a policy and its robot", "gap_contract", "python benchmarks/gap_contract.py --seed 2000"),
    ("Damaged input: tracebacks, hangs, silent changes", "fuzz", "python benchmarks/fuzz.py"),
    ("Recordings that decide between causes", "gap_next", "python benchmarks/gap_next.py --seed 27"),
    ("Changes between two logs of one robot", "gap_since", "python benchmarks/gap_since.py --seed 40"),
    ("The base policy without fine-tuning", "base_policy", "python benchmarks/base_policy.py"),
    ("Fine-tuning on one test", "ttt", "python benchmarks/ttt.py run --minutes 5"),
    (
        "Footholds: what a log says of the terrain",
        "footholds",
        "python -m benchmarks.footholds",
    ),
    ("Fine-tuning with a diagnosis, beside randomisation alone", "close_the_gap", "python benchmarks/close_the_gap.py"),
    (
        "Pretraining and fine-tuning on one GPU, an earlier recipe",
        "training_gpu",
        "realsim pretrain, realsim finetune (in the file)",
    ),
)


def bags() -> list[str]:
    """The same frames as a folder and as a bag."""
    lines = ["| terrain | read from | verdict | F at 1 cm | tops off | tilt | CPU seconds |", "|" + "---|" * 7]
    for r in stored("bag_scene")["rows"]:
        figures = f"{r['f_score_1cm']:.3f} | {r['tops_mm']:.2f} mm | {r['tilt_deg']:.3f}°"
        lines.append(f"| {r['terrain']} | {r['source']} | {r['verdict']} | {figures} | {r['cpu_seconds']:.0f} |")
    return lines


def damaged() -> list[str]:
    """What came of damaged files, by what was read, all seeds together."""
    rows = [r for r in stored("fuzz")["rows"] if r["number"] is None]
    harmless = ("moved", "less", "unused", "slight")
    lines = ["| read | trials | refused | said | same | harmless | cannot be told | silent | traceback, hang |"]
    lines.append("|" + "---|" * 9)
    for kind in dict.fromkeys(r["kind"] for r in rows):
        n = Counter({k: sum(r[k] for r in rows if r["kind"] == kind) for k in rows[0] if isinstance(rows[0][k], int)})
        counts = [n["trials"], n["refused"], n["said"], n["same"], sum(n[k] for k in harmless)]
        counts += [n["exchanged"] + n["plausible"], n["silent"], n["traceback"] + n["hang"]]
        lines.append(f"| {kind} | " + " | ".join(map(str, counts)) + " |")
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


KEYS = {
    "bag_scene": ("terrain", "frames", "source"),
    "base_policy": base_policy.KEY,
    "captures": ("kind", "seed", "method"),
    "close_the_gap": ("robot", "iterations"),
    "contact": ("terrain", "representation"),
    "fuzz": ("kind", "seed", "number"),
    "diagnosis": ("seed", "case"),
    "footholds": ("change", "seed"),
    "gap_blind": ("case",),
    "gap_depth": ("case", "seed", "crossings"),
    "gap_contract": ("kind", "seed"),
    "gap_next": ("seed", "case", "engine"),
    "gap_real": ("case", "engine"),
    "gap_since": ("seed", "pair"),
    "gap_sysid": ("case",),
    "matching": ("capture", "kind", "learned", "frames"),
    "real_captures": ("capture",),
    "reconstruct": ("capture", "method"),
    "reconstruct_scaling": ("frames", "poses"),
    "scale_error": ("terrain", "seed", "source", "frames"),
    "trainer_cpu": ("case", "seed"),
    "trainer_speed": ("case",),
    "trainer_tune": ("start", "speed", "seed"),
    "training_gpu": ("case",),
    "ttt": ttt.KEY,
    "loops": ("place",),
}
"""File -> the values that tell its rows apart; each row says by `run` or `commit` what made it."""


def index() -> list[str]:
    """A row for every file: claim, command, commit, date, machine; what a file does not say is said to be unknown."""
    lines = ["| claim | file | command | commit | date | machine |", "|---|---|---|---|---|---|"]
    for claim, name, command in INDEX:
        commits, days, machines = _made(stored(name))
        lines.append(f"| {claim} | {name}.json | `{command}` | {commits} | {days} | {machines} |")
    return lines


def _made(data: Any) -> tuple[str, str, str]:
    """Commits, days and machines of stored rows; what is not stored is said to be."""
    runs = data.get("runs", {})
    commits = [("added by " if "note" in run else "") + run["commit"] for run in runs.values()]
    commits += [row["commit"] for row in data["rows"] if "commit" in row]
    days = [*dict.fromkeys(day[:10] for day in runs), *data.get("days", ())]
    machines = [run.get("gpu") or _processor(run) for run in runs.values()] + list(data.get("machines", ()))
    return _listed(commits), _listed(sorted(days)), _listed(machines)


def _listed(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(filter(None, texts))) or "not stored"


def _processor(run: Row) -> str:
    return f"{run['cores']} cores, {run['cpu']}" if "cores" in run else ""


TABLES: dict[str, Callable[[], list[str]]] = {
    "readme": readme,
    "captures": captures,
    "contact": contact,
    "real captures": real_captures,
    "loops": loops,
    "hard matches": hard_matches,
    "bags": bags,
    "diagnosis by set": diagnosis_by_set,
    "diagnosis by robot": diagnosis_by_robot,
    "diagnosis by seed": diagnosis_intervals,
    "base policy": base,
    "base policy of the quadruped": quadruped_base,
    "test-time training": tuned,
    "footholds": footholds,
    "damaged": damaged,
    "real logs": real_logs,
    "experiments": experiments,
    "drift": drift,
    "closing the loop": closing,
    "index": index,
}
MARKED = re.compile(r"(<!-- figures: ([a-z -]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with its tables as they are stored."""
    return MARKED.sub(lambda m: m[1] + "\n".join(TABLES[m[2]]()) + "\n" + m[3], text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = [page for page in PAGES if filled((ROOT / page).read_text()) != (ROOT / page).read_text()]
    for page in stale:
        if check:
            print(f"{page} differs from benchmarks/results: make readme", file=sys.stderr)
        else:
            (ROOT / page).write_text(filled((ROOT / page).read_text()))
            print(f"{page} written")
    return int(bool(stale) and check)


if __name__ == "__main__":
    sys.exit(main())
