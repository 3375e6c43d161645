"""Test-time training on the thirteen tests: the paper's tables 1 (success), 4 (iterations to 97 %) and 5 (strategies).

    python benchmarks/training/ttt.py prepare --sources rgbd --tests stake1  CPU: the test is rendered and reconstructed
    python benchmarks/training/ttt.py run --tests boxes stake1 --minutes 5  GPU: as often as it takes, what is done is
    kept python benchmarks/training/ttt.py run --methods ttt1 --sources rgbd lidar phone hand --tests stake1 narrow1
    python benchmarks/training/ttt.py run --methods ttt1 --strategies full adapter residual last_layer --tests narrow1
    python benchmarks/training/ttt.py table

Methods: `base` is the policy that ships, `ttt1` fine-tunes it on one test, `ttt13` on all tests at once (`ttt13f`: half
of the episodes on tests drawn by how often they are failed), `scratch` trains without it for the same time. Every
policy is judged on the exact terrain, also if it was trained on a reconstruction (`--sources`): by 1000 trials with
randomisation at 0.3 of its width, by as many with all of it and pushes, and by as many with little of it where the
robot's links collide with each other. Tests are ours, not the paper's: names and families agree, their dimensions are
unknown (docs/paper.md).
"""

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Row, Store
from benchmarks.training.base_policy import SETTINGS, fingerprint
from trainer import terrain as terrains
from trainer.commands.common import load_policy
from trainer.commands.task_file import load_task
from trainer.evaluate import EvaluationConfig, Result, Setting, evaluate
from trainer.physics import PhysicsConfig
from trainer.policies import TASKS, base_of
from trainer.ppo.config import LoopConfig, PPOConfig, StrategyConfig
from trainer.ppo.distributed import pick_device
from trainer.terrain.scene import load as load_scene
from trainer.trainers import Scene, TrainConfig, find

ROOT = Path(__file__).resolve().parents[2]
ALONG = 0.3
"""Share of episodes that begin along a course on which the base never succeeds, as in its own training. Rows up to
commit 81b7fc12 that were helped had a raised floor, too, which is gone: wider tops do more (ladder.json)."""
Source = Literal["exact", "rgbd", "lidar", "phone", "hand"]
Method = Literal["base", "ttt1", "ttt13", "ttt13f", "scratch"]
WATCHED = 250
"""Trials in an evaluation on the way: as long as one of 100, and at 97 % uncertain by one point instead of two."""
KEY = ("base", "test", "method", "source", "strategy", "minutes", "seed", "pushes")
"""`base` is the beginning of the SHA-256 of the policy that was begun with: a new one does not replace old rows.
`pushes` are those of training; `base` has none."""
FEW_PUSHES = "0.5 m/s every 6 s"
"""Those of every training before G1's were made smaller and more frequent."""


@dataclass(frozen=True)
class Options:
    do: Annotated[Literal["prepare", "run", "table"], tyro.conf.Positional]
    tests: tuple[str, ...] = tuple(terrains.TESTS)
    methods: tuple[Method, ...] = ("base", "ttt1", "scratch")
    sources: tuple[Source, ...] = ("exact",)
    """What ttt1, ttt13 and ttt13f are trained on."""
    strategies: tuple[str, ...] = ("full",)
    """What ttt1 changes."""
    minutes: float = 5.0
    """Of training, each."""
    noise: float = 0.3
    """Exploration noise of ttt1, ttt13 and ttt13f at the start, and the most that it may grow to."""
    stop_after: float = float("inf")
    """Begin no training after this many minutes."""
    stop_at_target: bool = False
    """End a training once 97 % of the trials on the way succeed."""
    trials: int = 1000
    worlds: int = 0
    """Simulated robots; 0 takes 4096 on a GPU and 64 on the CPU."""
    policy: Path | None = None
    """The base; the one that ships if not given."""
    task_file: Path = TASKS["g1"]
    seed: int = 0
    device: str = "auto"
    work: Path = Path("out/ttt")
    """Scenes and policies."""
    store: Path = ROOT / "benchmarks" / "results" / "ttt.json"


@dataclass(frozen=True)
class Job:
    """One policy on the way to being judged; `tests` are all of them for ttt13 and ttt13f."""

    tests: tuple[str, ...]
    method: Method
    source: Source = "exact"
    strategy: str = "full"

    @property
    def name(self) -> str:
        return "_".join((self.tests[0] if len(self.tests) == 1 else "all", self.method, self.source, self.strategy))


def main(options: Options) -> None:
    if options.do == "prepare":
        prepare(options)
    elif options.do == "run":
        run(options)
    print("\n".join(table(Store(options.store, KEY).rows)))


# ---------------------------------------------------------------- reconstructions


def prepare(options: Options) -> None:
    """Scenes of every test and source that is not exact; those that are there stay."""
    from benchmarks.training.ttt_sources import SOURCES  # needs Open3D, which a machine that trains need not have

    for test in options.tests:
        for source in options.sources:
            folder = options.work / "scenes" / source / test
            if source != "exact" and not (folder / "scene" / "report.json").is_file():
                began = time.perf_counter()
                SOURCES[source](terrains.named(test), folder, options.seed)
                print(f"{test} from {source}: {time.perf_counter() - began:.0f} s", flush=True)


# ---------------------------------------------------------------- policies


def jobs(options: Options) -> Iterator[Job]:
    """What there is to do, the cheap first."""
    for method in options.methods:
        if method in ("ttt13", "ttt13f"):
            yield from (Job(options.tests, method, source) for source in options.sources)
        elif method == "ttt1":
            for source in options.sources:
                for strategy in options.strategies:
                    yield from (Job((test,), method, source, strategy) for test in options.tests)
        else:
            yield from (Job((test,), method) for test in options.tests)


def run(options: Options) -> None:
    """Train and judge what is not stored yet."""
    store, began = Store(options.store, KEY), time.monotonic()
    known = {tuple(row.get(name) for name in KEY) for row in store.rows}
    for job in jobs(options):
        todo = [t for t in job.tests if tuple(_identity(job, t, options).values()) not in known]
        if not todo or time.monotonic() - began > 60 * options.stop_after:
            continue
        policy, training = trained(job, options)
        for test in todo:
            row = _identity(job, test, options) | training
            for found in judged(policy, test, options):  # kept one by one: what is cut short has the first
                row = store.add(row | found)
            print("  ".join(f"{k} {v}" for k, v in row.items()), flush=True)


def _identity(job: Job, test: str, options: Options) -> Row:
    minutes = 0.0 if job.method == "base" else options.minutes
    base = fingerprint(options.policy or base_of("g1"))
    random = load_task(options.task_file).randomisation
    pushes = f"{random.push:g} m/s every {random.push_seconds:g} s" if minutes else None
    identity = (base, test, job.method, job.source, job.strategy, minutes, options.seed, pushes)
    return dict(zip(KEY, identity, strict=True))


def trained(job: Job, options: Options) -> tuple[Path, Row]:
    """(policy, figures of its training)."""
    base = options.policy or base_of("g1")
    if job.method == "base":
        return base, {}
    scratch = job.method == "scratch"
    lands = tuple(_terrain(test, job.source, options) for test in job.tests)
    task = load_task(options.task_file)
    if scratch or any(not next(judged(base, test, replace(options, trials=40)))["won"] for test in job.tests):
        task = replace(task, reset=replace(task.reset, along=task.reset.along or ALONG))
    task = replace(task, reset=replace(task.reset, by_failure=0.5 if job.method == "ttt13f" else 0.0))
    config = TrainConfig(
        robot="g1" if scratch else "",
        strategy="" if scratch else job.strategy,
        worlds=options.worlds,
        device=options.device,
        seed=options.seed,
        trials=WATCHED,
        task=task,
        trial_task=SETTINGS["mild"][0],
        loop=LoopConfig(
            iterations=100_000,
            minutes=options.minutes,
            checkpoint_every=400,
            stop_at_target=options.stop_at_target,
            tensorboard=False,
        ),
        ppo=PPOConfig(std_limits=(1.0, 0.35 if scratch else options.noise)),
        tuning=StrategyConfig(start_std=options.noise),
    )
    result = find("ppo")(Scene(lands), None if scratch else base, config, options.work / job.name)
    figures = {
        "iterations": result.iterations,
        "to_target": result.to_target,
        "evaluations": result.evaluations,
        "worlds": result.worlds,
        "training_seconds": round(result.seconds, 1),
        "helped": task.reset.along > 0,
        "noise": None if scratch else options.noise,
    }
    return result.policy, figures


def _terrain(test: str, source: Source, options: Options) -> terrains.Terrain:
    if source == "exact":
        return terrains.named(test)
    return load_scene(options.work / "scenes" / source / test / "scene")


def judged(file: Path, test: str, options: Options) -> Iterator[Row]:
    """Successes on the exact terrain: with little randomisation, with all of it, and with self-collision."""
    device = pick_device(options.device)
    policy = load_policy(file).to(device)

    def trials(name: str) -> Result:
        task, pushes = SETTINGS[name]
        setting = Setting(
            policy.robot,
            "warp" if device.type == "cuda" else "mujoco",
            task=task,
            physics=PhysicsConfig(device=str(device), seed=options.seed),
        )
        many = EvaluationConfig(options.trials, min(options.trials, 1000), options.seed + 7, pushes=pushes)
        return evaluate(policy.act, terrains.named(test), many, setting).results[0]

    plain = trials("mild")
    row: Row = {"trials": plain.trials, "won": plain.successes, "covered": round(plain.covered, 3)}
    yield row | {"causes": dict(plain.reasons), "device": str(device)}
    yield {"won_robust": trials("full").successes}
    yield {"won_self": trials("self").successes}


# ---------------------------------------------------------------- tables


def table(rows: list[Row], bases: Mapping[str, str] | None = None) -> list[str]:
    """Success by test, a column a policy, with iterations to 97 % and in all; every seed.

    Args:
        rows: of any base.
        bases: those that are shown, and what a column says of them; if not given, only the last, without its name.
    """
    bases = bases or {row["base"]: "" for row in rows[-1:]}
    rows = [r for r in rows if r["base"] in bases]
    columns = sorted({_column(r) for r in rows})
    tests = [t for t in terrains.TESTS if any(r["test"] == t for r in rows)]
    found: dict[Any, list[Row]] = {}
    for r in sorted(rows, key=lambda r: int(r["seed"])):
        found.setdefault((r["test"], *_column(r)), []).append(r)
    lines = ["| test | " + " | ".join(_title(c, bases) for c in columns) + " |", "|---|" + "---|" * len(columns)]
    for test in tests:
        cells = [_cell(found.get((test, *c), [])) for c in columns]
        lines.append(f"| {test} | " + " | ".join(cells) + " |")
    return lines


def _column(row: Row) -> tuple[Any, ...]:
    pushes = row.get("pushes") or FEW_PUSHES
    return row["method"], row["source"], row["strategy"], row["minutes"], row["base"], pushes


def _title(column: tuple[Any, ...], bases: Mapping[str, str]) -> str:
    method, source, strategy, minutes, base, pushes = column
    words = [method, *([source] if source != "exact" else []), *([strategy] if strategy != "full" else [])]
    begun = bases[base] if method != "scratch" else ""
    trained = (f"{minutes:g} min" if minutes else "", "" if pushes == FEW_PUSHES else f"pushes of {pushes}")
    return ", ".join(filter(None, (" ".join(words), *trained, begun)))


def _cell(seeds: list[Row]) -> str:
    """All seeds of a policy and test, one after the other in every figure."""
    if not seeds:
        return ""
    which = f"seeds {', '.join(str(r['seed']) for r in seeds)}: " if len(seeds) > 1 else ""
    text = f"{which}{_shares(seeds, 'won')} %"
    more = {"won_robust": "robust", "won_self": "self-collision"}
    if said := "; ".join(f"{title} {_shares(seeds, k)} %" for k, title in more.items() if any(k in r for r in seeds)):
        text += f" ({said})"
    if seeds[0]["method"] != "base":
        reached = ["never" if r.get("to_target") is None else str(r["to_target"]) for r in seeds]
        text += f", {', '.join(str(r['iterations']) for r in seeds)} iterations, 97 % after {', '.join(reached)}"
    return text


def _shares(seeds: list[Row], what: str) -> str:
    return ", ".join(f"{100 * r[what] / r['trials']:.1f}" if what in r else "-" for r in seeds)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
