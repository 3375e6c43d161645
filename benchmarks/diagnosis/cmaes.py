"""Baseline of the withheld check: joints fitted by CMA-ES as in PACE, beside the diagnosis, on the same cases.

    pip install -e '.[cmaes]'
    python benchmarks/diagnosis/withheld.py ...                # first: cases, labels and diagnoses below --work
    python benchmarks/diagnosis/cmaes.py --per-robot 4

PACE (Bjelonic, Tischhauser and Hutter, 2025, arXiv 2509.06342) fits rotor inertia, viscous and dry friction and zero of
every joint and one delay of the commands, all at once, to the joint positions of a robot that does not touch the
ground. The same is done here, in this simulator, with pycma, on the runs that the diagnosis fitted. Its answer to "what
is the cause" is the parameter that moved most in units of its everyday deviation. Both are then simulated on the runs
that neither saw.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.score import hit, top1
from benchmarks.diagnosis.sysid import ROBOTS, chosen, ratio, summary
from benchmarks.store import Store
from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap import EFFECTS, DiagnoseConfig, load_case
from realsim.gap.answer.check import mean_square
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Setting, Simulator

RESULTS = Path(__file__).parents[1] / "results" / "gap_cmaes.json"
OF_JOINTS = ("armature", "viscous_friction", "coulomb_friction", "joint_offset")
DELAY = "command_delay"


@dataclass(frozen=True)
class Knob:
    """One parameter of the fit, in the coordinate of its effect; 0 is the nominal model."""

    effect: str
    place: tuple[str, ...]
    name: str
    bounds: tuple[float, float]
    step: float
    everyday: float

    def setting(self, value: float) -> Setting:
        return self.effect, self.place, {self.name: value}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-robot", type=int, default=4)
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS), choices=ROBOTS)
    parser.add_argument("--evaluations", type=int, default=2000, help="simulations of all fitted runs, at most")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=Path, default=Path("out/gap_withheld"), help="that of withheld.py")
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    cases = chosen(args.work, args.robots, args.per_robot)
    if not cases:
        print(f"no diagnosed cases with one cause in {args.work}: run withheld.py first", file=sys.stderr)
        return 2
    store = Store(args.store, ("case",))
    store.rows = []
    for name, label in cases.items():
        kept = args.work / "cmaes" / f"{name}.json"
        if not kept.is_file():
            found = json.loads((args.work / "out" / name / "diagnosis.json").read_text())
            row = compare(args.work / "cases" / name, label, found, args)
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(row, indent=1) + "\n")
        row = {"case": name, **json.loads(kept.read_text())}
        store.facts = {"summary": summary([*store.rows, row], "cmaes")}
        store.add(row)
        print(f"{name} {row['truth']['effect']}: {row['cmaes']} | {row['realsim']}", flush=True)
    print(json.dumps(store.facts, indent=1))
    return 0


def compare(folder: Path, label: dict[str, Any], found: dict[str, Any], args: argparse.Namespace) -> dict[str, Any]:
    """What both say of one case, and the squared error that both leave on the unseen runs (1: the nominal one's)."""
    case = load_case(folder)
    names = [r.name for r in case.runs]
    fitted, held = (
        [names.index(n) for n in runs] for runs in (found["statistics"]["fitted_runs"], found["shrinkage"]["runs"])
    )
    began, cpu = time.perf_counter(), time.process_time()
    config = DiagnoseConfig(threads=args.threads)
    with Simulator(case, config) as simulator:
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, config)
        knobs = all_knobs(simulator)
        values, evaluations = fit(simulator, comparison, knobs, fitted, args.evaluations, args.seed)
        predicted = simulator.simulate(settings(knobs, values), runs=held)
        left = [comparison.residual(i, y) for i, y in zip(held, predicted, strict=True)]
    before = [comparison.residual(i, nominal[i]) for i in held]
    moved = [abs(v) / k.everyday for k, v in zip(knobs, values, strict=True)]
    says, truth = knobs[int(np.argmax(moved))], label["effects"][0]
    named = {"effect": says.effect, "joints": list(says.place)}
    equivalent = any(hit(named, t) for e in label["equivalents"] for t in e)
    return {
        "robot": label["robot"],
        "truth": {k: truth.get(k) for k in ("effect", "joints", "bodies")},
        "in_its_set": truth["effect"] in (*OF_JOINTS, DELAY),
        "cmaes": {
            "says": named,
            "top1": hit(named, truth),
            "top1_with_equivalents": hit(named, truth) or equivalent,
            "beyond_three_units": int(sum(m > 3 for m in moved)),
            "parameters": len(knobs),
            "evaluations": evaluations,
            "after": ratio(mean_square(comparison, left, held), mean_square(comparison, before, held)),
            "seconds": round(time.perf_counter() - began, 1),
            "cpu_seconds": round(time.process_time() - cpu, 1),
        },
        "realsim": {
            "verdict": found["verdict"],
            "top1": top1(label, found) == 2,
            "top1_with_equivalents": top1(label, found) >= 1,
            "after": float(found["shrinkage"]["after"]),
            "cpu_seconds": found["cpu_seconds"],
        },
    }


def all_knobs(simulator: Simulator) -> list[Knob]:
    """Rotor inertia, both frictions and zero of every driven joint, and one delay."""
    context = simulator.context
    places = [(effect, (joint,)) for joint in context.driven for effect in OF_JOINTS] + [(DELAY, ())]
    found = []
    for effect, place in places:
        p = next(p for p in EFFECTS[effect].parameters(context, place) if p.strength)
        found.append(Knob(effect, place, p.name, p.bounds, abs(p.step), p.nuisance))
    return found


def settings(knobs: Sequence[Knob], values: Sequence[float]) -> list[Setting]:
    return [k.setting(float(v)) for k, v in zip(knobs, values, strict=True)]


def fit(
    simulator: Simulator, comparison: Comparison, knobs: Sequence[Knob], runs: list[int], evaluations: int, seed: int
) -> tuple[F64, int]:
    """((m,) values with the least mean square of joint positions on `runs`, simulations made)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says that it cannot plot
        import cma

    positions = [c for c, channel in enumerate(simulator.channels) if channel.signal == "joint_pos"]
    steps = np.array([k.step for k in knobs])

    def cost(x: F64) -> float:
        try:
            predicted = simulator.simulate(settings(knobs, steps * x), runs=runs)
        except GapError:
            return float("nan")  # pycma draws another one in its place
        errors = [comparison.residual(i, y)[:, positions] for i, y in zip(runs, predicted, strict=True)]
        return float(np.nanmean(np.concatenate(errors) ** 2)) if all(np.isfinite(e).any() for e in errors) else np.nan

    low, high = ([k.bounds[end] / k.step for k in knobs] for end in (0, 1))
    options = {"bounds": [low, high], "maxfevals": evaluations, "seed": seed, "verbose": -9}
    found, strategy = cma.fmin2(cost, np.zeros(len(knobs)), 1.0, options)
    return steps * np.asarray(found), int(strategy.result.evaluations)


if __name__ == "__main__":
    raise SystemExit(main())
