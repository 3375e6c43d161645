"""A small task learnt end to end on the CPU: the quadruped stands up and walks forward on flat ground.

    python benchmarks/training/trainer_cpu.py --out walk              trains, or goes on from walk/policy.pt
    python benchmarks/training/trainer_cpu.py --out walk --report     figures of what there is
    realsim play flat --policy walk/policy.pt --task-file walk/task.json --out walk.mp4

Training is exact over interruptions: it goes on from its last checkpoint as if there had been none. The report is
written to benchmarks/results/trainer_cpu.json; `make readme` draws it.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store
from realsim.core.files import to_json, write_text
from trainer import terrain
from trainer.commands.task_file import load_task
from trainer.evaluate import EvaluationConfig, Setting, evaluate
from trainer.physics import PhysicsConfig
from trainer.ppo import checkpoint
from trainer.ppo.config import NetworkConfig, PPOConfig
from trainer.ppo.loop import LoopConfig, read_rows
from trainer.trainers import Scene, TrainConfig, find

ROOT = Path(__file__).resolve().parents[2]
TASK: dict[str, Any] = {
    "depth": {"use": False},
    "command": {"speed": 0.6},
    "termination": {"seconds": 10.0},
    "randomisation": {"use": False},
    "observation": {"steered": True},
}
"""Flat ground needs no camera; no randomisation, so that minutes are enough. The paper's robot is told to go straight
on and finds the goal with its camera; one without has to be steered, or it walks past (0 of 50 trials arrived)."""
WORLDS = 128
PIECE = 25
"""Iterations between checkpoints."""


def config(folder: Path, iterations: int) -> TrainConfig:
    """One thread, small networks."""
    last = folder / "policy.pt"
    networks = NetworkConfig(actor=(128, 64), critic=(128, 64), std=0.6)
    return TrainConfig(
        robot="quadruped",
        worlds=WORLDS,
        engine="mujoco",
        device="cpu",
        threads=1,
        trials=16,
        resume=last if last.is_file() else None,
        loop=LoopConfig(iterations=iterations, checkpoint_every=PIECE, evaluate_every=PIECE, tensorboard=False),
        ppo=PPOConfig(
            networks=networks,
            epochs=4,
            minibatches=2,
            entropy_weight=0.0,
            desired_kl=0.015,
            learning_rates=(1e-4, 3e-3),  # small batches: the divergence is noisy, and must not stop the learning
        ),
        task=load_task(folder / "task.json"),
    )


def train(folder: Path, iterations: int, seconds: float) -> None:
    """Continue until this many iterations have been done in all, or the time is over."""
    write_text(folder / "task.json", to_json(TASK))
    last, began = folder / "policy.pt", time.perf_counter()
    done = checkpoint.read(last)["training"]["iteration"] if last.is_file() else 0
    while done < iterations and time.perf_counter() - began < seconds:
        result = find("ppo")(Scene((terrain.flat(),)), None, config(folder, min(done + PIECE, iterations)), folder)
        done = result.iterations
        print(f"{done} iterations, {result.seconds:.0f} s, success {result.evaluations[-1:]}", flush=True)


def report(folder: Path, trials: int) -> None:
    """Final trials, the curve, and what the machine was."""
    policy, training = checkpoint.load(folder / "policy.pt")
    assert training is not None
    rows = [row for row in read_rows(folder) if "reward" in row]
    setting = Setting("quadruped", "mujoco", None, load_task(folder / "task.json"), PhysicsConfig(threads=1))
    found = evaluate(policy.act, terrain.flat(), EvaluationConfig(trials=trials, worlds=min(trials, 100)), setting)
    last = found.results[0]
    store = Store(ROOT / "benchmarks" / "results" / "trainer_cpu.json", ("case", "seed"))
    store.facts = {"what": "quadruped, flat ground, from scratch: stand up and walk 4 m to the goal platform"}
    data = {
        "case": "quadruped, flat ground",
        "seed": 0,
        "threads": 1,
        "worlds": WORLDS,
        "iterations": len(rows),
        "samples": training["samples"],
        "seconds": sum((row["collect_s"] or 0) + (row["update_s"] or 0) for row in rows),
        "success": {"rate": last.rate, "interval": last.interval, "trials": last.trials, "reasons": last.reasons},
        "seconds_to_goal": last.seconds,
        "covered": last.covered,
        "curve": {
            name: [row[name] for row in rows] for name in ("reward", "return", "length", "env/reward/linear_velocity")
        },
        "evaluations": training["evaluations"],
    }
    store.add(data)
    print(json.dumps({k: v for k, v in data.items() if k != "curve"}, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("walk"))
    parser.add_argument("--iterations", type=int, default=400, help="in all")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop at the next checkpoint after this time")
    parser.add_argument("--report", action="store_true", help="evaluate instead of training")
    parser.add_argument("--trials", type=int, default=200)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    report(a.out, a.trials) if a.report else train(a.out, a.iterations, a.seconds)


if __name__ == "__main__":
    main()
