"""The index of benchmarks/results: claim, command, commit, date, machine."""

from collections.abc import Iterable
from typing import Any

from benchmarks.diagnosis import sweep as gap_sweep
from benchmarks.diagnosis import unstable as gap_unstable
from benchmarks.tables.stored import Row, stored
from benchmarks.training import base_policy, captures, ladder, pushes, trials, ttt

INDEX = (
    (
        "Scenes against exact truth",
        "reconstruct",
        "python benchmarks/scenes/reconstruct.py",
    ),
    (
        "Error of the metric scale by source of points and poses",
        "scale_error",
        "python benchmarks/scenes/scale_error.py",
    ),
    ("Contact against the mesh, by representation", "contact", "python benchmarks/contact/meshes.py"),
    (
        "Diagnosis of generated cases, labels withheld",
        "diagnosis",
        "python benchmarks/diagnosis/withheld.py --seed SEED",
    ),
    (
        "Answers for 48 logs whose labels are withheld: not scored here",
        "gap_blind",
        "python benchmarks/diagnosis/blind.py store",
    ),
    (
        "Diagnosis of real logs with known errors in their models",
        "gap_real",
        "python benchmarks/diagnosis/real.py score --part report",
    ),
    (
        "Robots that development never had: errors put in, logs that once got a wrong answer",
        "gap_put_in",
        "python benchmarks/diagnosis/batch.py",
    ),
    (
        "Small robots of other shapes, with plain mistakes in their models",
        "gap_strangers",
        "python -m benchmarks.diagnosis.strangers",
    ),
    ("Real flights of drones with known damage", "gap_flights", "python benchmarks/diagnosis/batch.py"),
    (
        "Robots that only their controller holds up",
        "gap_unstable",
        "python benchmarks/diagnosis/unstable.py [--open-loop]",
    ),
    (
        "Diagnosis with everyday deviations and noise beyond their priors",
        "gap_sweep",
        "python benchmarks/diagnosis/sweep.py score --seed SEED",
    ),
    ("Speed of training", "trainer_speed", "python benchmarks/training/trainer_speed.py"),
    ("Learning on one CPU core", "trainer_cpu", "python benchmarks/training/trainer_cpu.py"),
    ("Loops in places that look alike", "loops", "python benchmarks/scenes/loops.py"),
    (
        "Contact from the side, by columns alone and as `auto` chooses",
        "sides",
        "python -m benchmarks.contact.sides [--large]",
    ),
    ("Contact of forty clean meshes", "clean_meshes", "python -m benchmarks.contact.clean_meshes"),
    ("Captures that real sensors and apps wrote", "real_captures", "python benchmarks/scenes/real_captures.py"),
    ("Clouds that do not say from where they were seen", "clouds", "python -m benchmarks.scenes.clouds"),
    ("Somebody who moves, and what moves with the camera", "movers", "python -m benchmarks.scenes.movers"),
    (
        "Frames that are hard to match, with and without the learned matcher",
        "matching",
        "python benchmarks/scenes/matching.py",
    ),
    ("Mistakes between a policy and its robot", "gap_contract", "python benchmarks/diagnosis/contract.py"),
    ("Public reports of errors in the robot, rebuilt", "gap_reports", "python benchmarks/diagnosis/reports.py"),
    ("Damaged input: tracebacks, hangs, silent changes", "fuzz", "python benchmarks/robustness/fuzz.py"),
    (
        "Recordings as strangers write them, read without a hand",
        "recordings",
        "python -m benchmarks.robustness.recordings",
    ),
    ("Recordings that decide between causes", "gap_next", "python benchmarks/diagnosis/next.py --seed 29"),
    ("Changes between two logs of one robot", "gap_since", "python benchmarks/diagnosis/since.py --seed 40"),
    ("The base policy without fine-tuning", "base_policy", "python benchmarks/training/base_policy.py"),
    ("Pushes that a policy withstands", "pushes", "python benchmarks/training/pushes.py"),
    ("Fine-tuning on one test", "ttt", "python benchmarks/training/ttt.py run --minutes 5"),
    (
        "Help on courses that the base hardly crosses, in equal minutes",
        "ladder",
        "python benchmarks/training/ladder.py --course beams:1 --method ladder --minutes 5",
    ),
    ("Trials by their command and contact model", "trials", "python benchmarks/training/trials.py"),
    (
        "Fine-tuning on all tests, by number of worlds",
        "ttt_worlds",
        "python benchmarks/training/ttt.py run --methods ttt13f --minutes 8 --worlds 8192 --store FILE",
    ),
    (
        "Footholds: what a log says of the terrain",
        "footholds",
        "python -m benchmarks.diagnosis.footholds",
    ),
    (
        "From frames of others to a policy, judged on the true course",
        "tuned_captures",
        "python benchmarks/training/captures.py run",
    ),
    (
        "Fine-tuning with a diagnosis, beside randomisation alone",
        "close_the_gap",
        "python benchmarks/training/closed_loop.py",
    ),
)
KEYS = {
    "base_policy": base_policy.KEY,
    "pushes": pushes.KEY,
    "clouds": ("terrain",),
    "movers": ("kind", "poses"),
    "close_the_gap": ("robot", "iterations", "effects_considered", "course"),
    "contact": ("terrain", "representation"),
    "fuzz": ("kind", "seed", "number"),
    "diagnosis": ("seed", "case", "commit"),
    "footholds": ("change", "seed"),
    "gap_blind": ("case",),
    "gap_contract": ("policy", "kind", "seed"),
    "gap_reports": ("case", "seed"),
    "gap_next": ("seed", "case", "engine"),
    "gap_real": ("case", "engine"),
    "gap_put_in": ("case",),
    "gap_strangers": ("case",),
    "gap_flights": ("case",),
    "gap_since": ("seed", "pair"),
    "gap_sweep": gap_sweep.KEY,
    "gap_unstable": gap_unstable.KEY,
    "matching": ("capture", "kind", "learned", "frames"),
    "real_captures": ("capture",),
    "reconstruct": ("capture", "method"),
    "sides": ("scene", "contact"),
    "scale_error": ("terrain", "seed", "source", "frames"),
    "trainer_cpu": ("case", "seed"),
    "trainer_speed": ("case",),
    "clean_meshes": ("mesh",),
    "recordings": ("part", "name"),
    "ladder": ladder.KEY,
    "trials": trials.KEY,
    "ttt": ttt.KEY,
    "ttt_worlds": (*ttt.KEY, "worlds"),
    "tuned_captures": captures.KEY,
    "loops": ("place",),
}
"""File -> the values that tell its rows apart; each row says by `run` or `commit` what made it."""


def index() -> list[str]:
    """A row for every file: claim, command, commit, date, machine; what a file does not hold reads "not stored"."""
    lines = ["| claim | file | command | commit | date | machine |", "|---|---|---|---|---|---|"]
    for claim, name, command in INDEX:
        commits, days, machines = _made(stored(name))
        lines.append(f"| {claim} | {name}.json | `{command}` | {commits} | {days} | {machines} |")
    return lines


def _made(data: Any) -> tuple[str, str, str]:
    """Commits, days and machines of stored rows; or "not stored"."""
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
