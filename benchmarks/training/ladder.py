"""Help on courses that the base hardly crosses: wider tops against none, in equal minutes. Stored rows of a raised
floor (`floor`) are of commit 81b7fc12 and before, which had one.

    python benchmarks/training/ladder.py --course beams:1 --method ladder --minutes 5
    python benchmarks/training/ladder.py table

Trials are those of `realsim finetune`: all randomisation, nobody pushed. Several processes can share a GPU; rows say
how many did. Each keeps its rows in a file of its own (--out), which `merge FILE ...` adds to the store.
"""

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Store
from benchmarks.training.base_policy import fingerprint
from trainer.commands.common import find_scene, load_policy
from trainer.commands.common import setting as setting_of
from trainer.commands.task_file import load_task
from trainer.config import EvaluationConfig
from trainer.evaluate import Evaluation, evaluate
from trainer.policies import TASKS, base_of
from trainer.ppo.config import LoopConfig
from trainer.ppo.distributed import pick_device
from trainer.trainers import TrainConfig, find
from trainer.trainers.ladder import helped
from trainer.verdict import judge

ROOT = Path(__file__).resolve().parents[2]
KEY = ("base", "course", "method", "minutes", "seed", "shared")


@dataclass(frozen=True)
class Options:
    do: Annotated[Literal["run", "table", "merge"], tyro.conf.Positional] = "run"
    files: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Rows to merge."""
    course: str = "beams:1"
    method: Literal["ladder", "plain"] = "ladder"
    minutes: float = 5.0
    seed: int = 0
    shared: int = 1
    """Trainings that share the GPU."""
    robot: str = "g1"
    worlds: int = 0
    trials: int = 1000
    work: Path = Path("out/ladder")
    out: Path = ROOT / "benchmarks" / "results" / "ladder.json"
    device: str = "auto"


def main(options: Options) -> None:
    store = Store(options.out, KEY)
    if options.do == "merge":
        for file in options.files:
            other = Store(file, KEY)
            store.runs |= other.runs
            for row in other.rows:
                store.rows = [r for r in store.rows if store._key(r) != store._key(row)] + [row]
        store.save()
    elif options.do == "run":
        store.add(measured(options))
    print("\n".join(table(store.rows)))


def measured(options: Options) -> dict[str, Any]:
    """One training, judged before and after."""
    base, scene = base_of(options.robot), find_scene([options.course])
    task = load_task(TASKS[options.robot])
    lands = scene
    if options.method == "ladder":
        lands, task = helped(scene, task)
    loop = LoopConfig(iterations=100_000, minutes=options.minutes, checkpoint_every=400, tensorboard=False)
    config = TrainConfig(worlds=options.worlds, device=options.device, seed=options.seed, task=task, loop=loop)

    def trials(file: Path) -> Evaluation:
        policy, device = load_policy(file), pick_device(options.device)
        many = EvaluationConfig(options.trials, options.trials, options.seed + 7)
        return evaluate(policy.to(device).act, scene.terrains, many, setting_of(policy, file, device, config))

    name = f"{options.course.replace(':', '_')}_{options.method}_{options.seed}"
    before, began = trials(base), time.perf_counter()
    result = find("ppo")(lands, base, config, options.work / name)
    seconds = time.perf_counter() - began
    after = trials(result.policy)
    verdict = judge(before, after)
    causes: Counter[str] = Counter()
    for r in after.results:
        causes.update(r.reasons)
    return {
        "base": fingerprint(base),
        **{name: getattr(options, name) for name in KEY[1:]},
        "trials": options.trials,
        "before": before.results[0].successes,
        "after": after.results[0].successes,
        "delivered": "tuned" if verdict.better else "base",
        "causes": dict(causes),
        "iterations": result.iterations,
        "worlds": result.worlds,
        "to_target": result.to_target,
        "evaluations": result.evaluations,
        "went_back": [w for w in result.warnings if "went back" in w],
        "seconds": round(seconds, 1),
    }


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Success before and after by course and method."""
    lines = [
        "| course | method | minutes (shared by) | iterations | before | after | delivered |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in sorted(rows, key=lambda r: (r["course"], r["method"], r["seed"])):
        lines.append(
            f"| {r['course']} | {r['method']} | {r['minutes']:g} ({r['shared']}) | {r['iterations']} "
            f"| {100 * r['before'] / r['trials']:.1f} % | {100 * r['after'] / r['trials']:.1f} % | {r['delivered']} |"
        )
    return lines


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
