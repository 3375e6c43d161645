"""What a trial asks of a policy, and in which contact model: the thirteen tests, all in one batch of worlds.

    python benchmarks/training/trials.py --engines warp --finishes reach stop
    python benchmarks/training/trials.py --engines mujoco elliptic --trials 40

`soft` and `hard` are the engine `mujoco` with contacts that push back half and twice as fast. Prints a table and stores
the counts of every test. With little randomisation, as the first column of the card (base_policy.py).
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Store
from benchmarks.training.base_policy import SETTINGS, fingerprint, outcomes
from trainer import terrain as terrains
from trainer.commands.common import load_policy
from trainer.evaluate import EvaluationConfig
from trainer.physics import PhysicsConfig
from trainer.policies import base_of
from trainer.ppo.distributed import pick_device

ROOT = Path(__file__).resolve().parents[2]
KEY = ("robot", "base", "name", "course", "engine", "finish", "trials", "seed")
SOFTNESS = {"soft": 2.0, "hard": 0.5}


@dataclass(frozen=True)
class Options:
    policy: Path | None = None
    """The checkpoint; the one that ships for the robot if not given."""
    robot: str = "g1"
    name: str = "base"
    """What the table calls the policy."""
    engines: tuple[Literal["warp", "mujoco", "elliptic", "soft", "hard"], ...] = ("mujoco",)
    finishes: tuple[Literal["reach", "stop"], ...] = ("reach",)
    tests: tuple[str, ...] = field(default_factory=lambda: tuple(terrains.TESTS))
    trials: int = 40
    """On each test."""
    seed: int = 7
    threads: int = 0
    out: Path = ROOT / "benchmarks" / "results" / "trials.json"


def main(options: Options) -> None:
    file = options.policy or base_of(options.robot)
    policy, store = load_policy(file), Store(options.out, KEY)
    for engine in options.engines:
        for finish in options.finishes:
            for test, won in counts(policy, engine, finish, options).items():
                key = (
                    policy.robot,
                    fingerprint(file),
                    options.name,
                    test,
                    engine,
                    finish,
                    options.trials,
                    options.seed,
                )
                store.add(dict(zip(KEY, key, strict=True)) | {"won": won})
    print("\n".join(table(store.rows, options.robot)))


def counts(policy: Any, engine: str, finish: Any, options: Options) -> dict[str, int]:
    """Successes on every test."""
    lands = [terrains.named(name) for name in options.tests]
    config = EvaluationConfig(trials=options.trials, seed=options.seed, finish=finish)
    own = pick_device("auto")
    device = own if engine == "warp" else pick_device("cpu")
    found = outcomes(
        policy,
        lands,
        SETTINGS["mild"][0],
        config,
        device,
        engine="mujoco" if engine in SOFTNESS else engine,
        caster="warp_host" if own.type == "cuda" and device.type == "cpu" else None,
        physics=PhysicsConfig(device=str(device), threads=options.threads, softness=SOFTNESS.get(engine, 1.0)),
    )
    return {name: counts["success"] for name, counts in zip(options.tests, found, strict=True)}


def table(rows: list[dict[str, Any]], robot: str) -> list[str]:
    """A line a test, a column a policy, engine and rule."""
    rows = [r for r in rows if r["robot"] == robot]
    columns = sorted({(r["name"], r["engine"], r["finish"], r["trials"]) for r in rows})
    heads = (f"{name}: {engine}, {finish} ({trials})" for name, engine, finish, trials in columns)
    lines = ["| test | " + " | ".join(heads) + " |", "|---|" + "---|" * len(columns)]
    for test in terrains.TESTS:
        found = {
            (r["name"], r["engine"], r["finish"], r["trials"]): f"{100 * r['won'] / r['trials']:.0f} %"
            for r in rows
            if r["course"] == test
        }
        lines.append(f"| {test} | " + " | ".join(found.get(c, "") for c in columns) + " |")
    return lines


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
