"""How hard a push a policy withstands on each of the thirteen tests.

    python benchmarks/training/pushes.py  the policy that ships, 400 trials a test and push
    python benchmarks/training/pushes.py --policy tuned/policy.pt --name narrow3 --tests narrow3

A push adds a velocity to the base every six seconds: along and across, each uniform up to the size given. All else is
randomised a little (0.3 of its width), so that what is lost is lost by pushes. All tests run in one batch of worlds.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Store
from benchmarks.training.base_policy import outcomes
from trainer import terrain as terrains
from trainer.commands.common import load_policy
from trainer.evaluate import EvaluationConfig
from trainer.policies import base_of
from trainer.ppo.distributed import pick_device
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import RandomisationConfig

ROOT = Path(__file__).resolve().parents[2]
KEY = ("policy", "test", "push", "seed")
STRENGTH = 0.3


@dataclass(frozen=True)
class Options:
    policy: Path | None = None
    """The checkpoint; the G1 that ships if not given."""
    name: str = "base"
    """What the policy is called in the rows."""
    tests: tuple[str, ...] = tuple(terrains.TESTS)
    pushes: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    """m/s, at most, along and across."""
    trials: int = 400
    """On each test."""
    seed: int = 7
    device: str = "auto"
    out: Path = ROOT / "benchmarks" / "results" / "pushes.json"


def main(options: Options) -> None:
    """Run all trials, store them, print them."""
    device = pick_device(options.device)
    policy = load_policy(options.policy or base_of("g1")).to(device)
    store = Store(options.out, KEY)
    for push in options.pushes:
        for row in rows(push, policy, device, options):
            store.add(row)
    print("\n".join(table(store.rows)))


def rows(push: float, policy: Any, device: Any, options: Options) -> list[dict[str, Any]]:
    """Counts of outcomes on every test."""
    random = RandomisationConfig(strength=STRENGTH, push=push / STRENGTH, push_seconds=6.0 if push else 0.0)
    config = EvaluationConfig(trials=options.trials, seed=options.seed, pushes=push > 0)
    lands = [terrains.named(name) for name in options.tests]
    found = outcomes(policy, lands, ParkourConfig(randomisation=random), config, device)
    same = {"policy": options.name, "push": push, "trials": options.trials, "seed": options.seed}
    return [{"test": name, **counts, **same} for name, counts in zip(options.tests, found, strict=True)]


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A line for each policy and test: the share of trials that arrive, for each size of push."""
    sizes = sorted({row["push"] for row in rows})
    lines = [f"| test | policy | {' | '.join(f'{p:g} m/s' for p in sizes)} | trials |", "|---" * (len(sizes) + 3) + "|"]
    found = {(r["policy"], r["test"], r["push"]): r for r in rows}
    for policy, test in sorted({k[:2] for k in found}, key=lambda k: (list(terrains.TESTS).index(k[1]), k[0])):
        here = [found.get((policy, test, p)) for p in sizes]
        cells = ["not run" if r is None else f"{100 * r.get('success', 0) / r['trials']:.1f} %" for r in here]
        trials = max(r["trials"] for r in here if r is not None)
        lines.append(f"| `{test}` | {policy} | {' | '.join(cells)} | {trials} |")
    return lines


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
