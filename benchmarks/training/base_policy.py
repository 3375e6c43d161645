"""How far a base policy comes without fine-tuning: generated courses of every family, and the thirteen tests.

    python benchmarks/training/base_policy.py                        the policy that ships, 40 trials a course
    python benchmarks/training/base_policy.py --policy base/policy.pt --trials 100

All courses run in one batch of worlds, which takes as long as one of them. Courses have seeds from 900 on: the
curriculum's grid uses others. Everything is run three times: with little randomisation (0.3 of its width, no pushes),
with all of it and pushes, and with little of it where the robot's links collide with each other too. Prints a table
and stores the counts of every family at a difficulty, and of every test.
"""

import hashlib
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Store
from trainer import terrain as terrains
from trainer.commands.common import load_policy
from trainer.evaluate import EvaluationConfig, run, trial_config, wilson
from trainer.physics import PhysicsConfig
from trainer.policies import base_of
from trainer.ppo.distributed import pick_device
from trainer.tasks.parkour import ParkourConfig, make
from trainer.tasks.parkour.config import RandomisationConfig
from trainer.tasks.parkour.terminations import OUTCOMES

ROOT = Path(__file__).resolve().parents[2]
DIFFICULTIES = (0.5, 0.8, 1.0)
FIRST_SEED = 900
KEY = ("robot", "base", "course", "setting", "seed")
"""`base` is the beginning of the SHA-256 of the policy: a new one does not replace old rows."""
SETTINGS = {
    "mild": (ParkourConfig(randomisation=RandomisationConfig(strength=0.3, push_seconds=0.0)), False),
    "full": (ParkourConfig(), True),
}
SETTINGS["self"] = (replace(SETTINGS["mild"][0], self_collision=True), False)
"""Name -> the task that policies are judged in, and whether the robot is pushed. In `self` its links collide with each
other too."""


@dataclass(frozen=True)
class Options:
    policy: Path | None = None
    """The checkpoint; the one that ships for the robot if not given."""
    robot: str = "g1"
    trials: int = 40
    """On each course."""
    courses: int = 5
    """Of each family and difficulty."""
    seed: int = 7
    """Of the trials."""
    settings: tuple[str, ...] = tuple(SETTINGS)
    """See SETTINGS."""
    device: str = "auto"
    """torch device."""
    out: Path = ROOT / "benchmarks" / "results" / "base_policy.json"
    """Where the counts go."""


def main(options: Options) -> None:
    """Run all trials, store them, print them."""
    device = pick_device(options.device)
    file = options.policy or base_of(options.robot)
    policy, name = load_policy(file).to(device), fingerprint(file)
    lands = {
        f"{family}:{difficulty:g}:{FIRST_SEED + k}": terrains.generate(family, difficulty, FIRST_SEED + k)
        for family in terrains.ALL
        for difficulty in DIFFICULTIES
        for k in range(options.courses)
    }
    lands |= {name: terrains.named(name) for name in terrains.TESTS}
    store = Store(options.out, KEY)
    for setting in options.settings:
        for row in rows(lands, setting, policy, device, options):
            store.add(row | {"base": name})
    print("\n".join(table(store.rows, policy.robot)))


def fingerprint(policy: Path) -> str:
    """What a policy is called in rows."""
    return hashlib.sha256(policy.read_bytes()).hexdigest()[:8]


def rows(lands: dict[str, Any], setting: str, policy: Any, device: Any, options: Options) -> list[dict[str, Any]]:
    """Counts of outcomes, courses of one family and difficulty together."""
    task, pushes = SETTINGS[setting]
    config = EvaluationConfig(trials=options.trials, seed=options.seed, pushes=pushes)
    counts: dict[str, Counter[str]] = {}
    for name, found in zip(lands, outcomes(policy, list(lands.values()), task, config, device), strict=True):
        counts.setdefault(":".join(name.split(":")[:2]), Counter()).update(found)
    same = {"robot": policy.robot, "setting": setting, "seed": options.seed}
    return [{"course": kind, "trials": found.total(), **found, **same} for kind, found in counts.items()]


def outcomes(
    policy: Any, lands: list[Any], task: ParkourConfig, config: EvaluationConfig, device: Any, **more: Any
) -> list[Counter[str]]:
    """How trials on each course end: `config.trials` on each, all in one batch of worlds. `more` goes to `make`."""
    count = config.trials * len(lands)
    config = replace(config, trials=count, worlds=count)
    options = {"engine": "warp" if device.type == "cuda" else "mujoco", "physics": PhysicsConfig(device=str(device))}
    env = make(trial_config(task, config), lands, robot=policy.robot, worlds=count, seed=config.seed, **options | more)
    ends = [OUTCOMES[o] for o in run(policy.to(device).act, env, count).outcome.tolist()]
    return [Counter(ends[i :: len(lands)]) for i in range(len(lands))]  # world k is on course k modulo their number


def grouped(rows: list[dict[str, Any]], setting: str, robot: str = "g1", base: str = "") -> dict[str, tuple[int, int]]:
    """(successes, trials) of a robot's base in a setting by family and difficulty, or by test; of the last base that
    was measured, if none is given."""
    base = base or bases(rows, robot)[-1]
    sums: dict[str, tuple[int, int]] = {}
    for row in rows:
        if (row["robot"], row["base"], row["setting"]) == (robot, base, setting):
            sums[row["course"]] = row.get("success", 0), row["trials"]
    return sums


def bases(rows: list[dict[str, Any]], robot: str = "g1") -> list[str]:
    """Of a robot, the last measured last."""
    return list(dict.fromkeys(row["base"] for row in rows if row["robot"] == robot))


def table(rows: list[dict[str, Any]], robot: str = "g1") -> list[str]:
    """A line for each family and difficulty, and for each test, with Wilson's intervals of 95 %; in brackets the base
    that was measured before."""
    titles = {"mild": "little randomisation", "full": "all of it, and pushes", "self": "little, with self-collision"}
    found = {s: [grouped(rows, s, robot, base) for base in bases(rows, robot)[:-3:-1]] for s in SETTINGS}
    found = {setting: groups for setting, groups in found.items() if any(groups) or setting != "self"}
    head = ["courses", *(titles[s] for s in found), "trials"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name in dict.fromkeys(name for now, *_ in found.values() for name in now):
        counts = [[groups.get(name, (0, 0)) for groups in both] for both in found.values()]
        cells, trials = [_cell(*c) for c in counts], max(now[1] for now, *_ in counts)
        lines.append(f"| {' | '.join([name, *cells, str(trials)])} |")
    return lines


def _cell(now: tuple[int, int], before: tuple[int, int] = (0, 0)) -> str:
    return _share(now) + (f" ({100 * before[0] / before[1]:.1f})" if before[1] else "")


def _share(counts: tuple[int, int]) -> str:
    if not counts[1]:
        return "not run"
    low, high = wilson(*counts)
    return f"{100 * counts[0] / counts[1]:.1f} % [{100 * low:.0f}, {100 * high:.0f}]"


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
