"""How a fine-tuning begins: the learning rate and the critic's head start, on the CPU.

    python benchmarks/training/trainer_cpu.py --out walk              the base: the quadruped on flat ground, 0.6 m/s
    python benchmarks/training/trainer_tune.py --base walk --out tune

The base goes on under randomisation at its own speed, where there is only something to lose, and at a higher one, where
its critic is wrong and there is much to gain. Runs that are there already are not repeated. The report is written to
benchmarks/results/trainer_tune.json.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store
from trainer import terrain
from trainer.commands.task_file import load_task
from trainer.ppo import checkpoint
from trainer.ppo.config import PPOConfig
from trainer.ppo.loop import LoopConfig, read_rows
from trainer.tasks.parkour.config import CommandConfig, RandomisationConfig
from trainer.trainers import Scene, TrainConfig, find

ROOT = Path(__file__).resolve().parents[2]
WORLDS, TRIALS = 128, 48
STARTS = {"1e-3": (1e-3, 0), "1e-4": (1e-4, 0), "1e-3, critic first": (1e-3, 5), "1e-4, critic first": (1e-4, 5)}
"""Name -> (learning rate, iterations of the critic alone)."""
COLUMNS = ("reward", "kl", "learning_rate", "value_loss")


def tune(base: Path, out: Path, start: str, speed: float, seed: int, iterations: int, every: int) -> dict[str, Any]:
    """One fine-tuning; what its iterations and evaluations were."""
    folder = out / f"{speed}_{start.replace(', ', '_').replace(' ', '_')}_{seed}"
    if len([row for row in read_rows(folder) if "reward" in row]) < iterations:
        task = load_task(base / "task.json")
        task = replace(
            task, command=CommandConfig(speed=(speed, speed)), randomisation=RandomisationConfig(terrain_variants=1)
        )
        rate, critic_first = STARTS[start]
        config = TrainConfig(
            worlds=WORLDS,
            engine="mujoco",
            device="cpu",
            threads=1,
            trials=TRIALS,
            seed=seed,
            ppo=PPOConfig(learning_rate=rate, critic_first=critic_first),
            task=task,
            loop=LoopConfig(
                iterations=iterations, evaluate_every=every, evaluate_share=1, checkpoint_every=1000, tensorboard=False
            ),
        )
        find("ppo")(Scene((terrain.flat(),)), base / "policy.pt", config, folder)
    steps = [row for row in read_rows(folder) if "reward" in row]
    evaluations = checkpoint.read(folder / "policy.pt")["training"]["evaluations"]
    columns = {name: [row[name] for row in steps] for name in COLUMNS}
    return {"start": start, "speed": speed, "seed": seed, "evaluations": evaluations, **columns}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", type=Path, default=Path("walk"))
    parser.add_argument("--out", type=Path, default=Path("tune"))
    parser.add_argument("--speeds", type=float, nargs="+", default=[0.6, 1.0])
    parser.add_argument("--starts", nargs="+", default=list(STARTS), choices=list(STARTS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument("--every", type=int, default=2, help="iterations between evaluations")
    a = parser.parse_args()
    store = Store(ROOT / "benchmarks" / "results" / "trainer_tune.json", ("start", "speed", "seed"))
    what = "the quadruped of trainer_cpu.py, fine-tuned on flat ground with randomisation, the full strategy"
    store.facts = {"what": what, "threads": 1, "worlds": WORLDS, "trials": TRIALS}
    for speed in a.speeds:
        for start in a.starts:
            for seed in a.seeds:
                run = tune(a.base, a.out, start, speed, seed, a.iterations, a.every)
                success = " ".join(f"{rate:.2f}" for _, rate in run["evaluations"])
                print(
                    f"{speed} m/s, {start}, seed {seed}: largest kl {max(run['kl']):.3f}, success {success}", flush=True
                )
                store.add(run)


if __name__ == "__main__":
    main()
