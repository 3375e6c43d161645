"""Evaluation of a policy on a course: trials with fixed seeds, success with its interval, causes and places of failure.

Paper, sec. IV-A: a trial begins on the start platform with a constant forward command and succeeds if the robot reaches
the goal platform without touching the ground or falling; 1000 trials.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import sqrt
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from realsim.core.progress import steps
from trainer.config import Evaluation, EvaluationConfig, Result
from trainer.errors import TrainerError
from trainer.physics import PhysicsConfig
from trainer.robots import TrainedRobot
from trainer.tasks import Observation
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, make
from trainer.tasks.parkour.terminations import OUTCOMES, SUCCESS
from trainer.terrain import Terrain

Policy = Callable[[Observation], Tensor]
"""Observation -> (N, J) actions, without exploration noise."""

ON_ARRIVAL = 1e-3
"""Seconds on the goal platform that are over at the first step there."""
Z95 = 1.959963984540054
"""Quantile of the normal distribution for a 95 percent interval."""


@dataclass(frozen=True)
class Trials:
    """Every trial on one terrain; (T,) rows in the order in which they were started."""

    outcome: Tensor
    """(T,) index into `OUTCOMES`."""
    position: Tensor
    """(T, 3) m, the base at the end."""
    seconds: Tensor
    """(T,)."""
    covered: Tensor
    """(T,) share of the way from start to goal."""


@dataclass(frozen=True)
class Setting:
    """In which simulation the trials are run."""

    robot: str | TrainedRobot = "g1"
    engine: str = "mujoco"
    caster: str | None = None
    task: ParkourConfig = field(default_factory=ParkourConfig)
    physics: PhysicsConfig | None = None
    diagnosis: str | Path | None = None


def evaluate(
    policy: Policy,
    terrains: Terrain | Sequence[Terrain],
    config: EvaluationConfig | None = None,
    setting: Setting | None = None,
    *,
    finer: Sequence[Terrain] = (),
) -> Evaluation:
    """Trials of a policy on terrains. The same seed, worlds and engine give the same trials.

    Args:
        policy: deterministic; a recurrent one must not keep state between calls.
        terrains: one or several, in the contact geometry that was trained on.
        config: how many trials.
        setting: robot, engine and task; the task as it was trained.
        finer: the same courses with contact geometry that was not trained on, to see what the policy owes to it.

    Raises:
        TrainerError: a terrain that is no course, a device that is not there, a simulation that diverges too often.
    """
    config, setting = config or EvaluationConfig(), setting or Setting()
    courses = [terrains] if isinstance(terrains, Terrain) else list(terrains)
    if not courses:
        raise TrainerError("there is no terrain to evaluate on")
    results: list[Result] = []
    warnings: list[str] = []
    with steps() as tick:
        for geometry, group in (("trained", courses), ("finer", list(finer))):
            for terrain in group:
                what = f"trials on {terrain.name}" + (" (finer)" if geometry == "finer" else "")
                tick(what, 0.0)
                env = trial_env(terrain, min(config.worlds, config.trials), config, setting)
                trials = run(policy, env, config.trials, partial(tick, what))
                results.append(summarise(terrain, geometry, trials, env, config))
                warnings += [f"{terrain.name} ({geometry}): {text}" for text in env.warnings]
    robot = setting.robot if isinstance(setting.robot, str) else setting.robot.robot.name
    return Evaluation(tuple(results), config, tuple(warnings), robot, setting.engine)


def trial_env(terrain: Terrain, worlds: int, config: EvaluationConfig, setting: Setting) -> ParkourEnv:
    """Worlds for trials on one terrain: true size, fresh starts, the task otherwise as in training."""
    return make(
        trial_config(setting.task, config),
        [terrain],
        robot=setting.robot,
        worlds=worlds,
        engine=setting.engine,
        caster=setting.caster,
        physics=setting.physics,
        diagnosis=setting.diagnosis,
        seed=config.seed,
        graphs=True,
    )


def trial_config(task: ParkourConfig, config: EvaluationConfig) -> ParkourConfig:
    """A task as it is evaluated."""
    random = replace(task.randomisation, use=config.randomise and task.randomisation.use, terrain_variants=1)
    if not config.pushes:
        random = replace(random, push=0.0)
    if config.finish == "reach":
        task = replace(
            task,
            command=replace(task.command, constant=True),
            termination=replace(task.termination, goal_seconds=ON_ARRIVAL),
        )
    task = replace(
        task,
        randomisation=random,
        reset=replace(task.reset, spread_ages=False, along=0.0, by_failure=0.0),
        amp=False,
    )
    if config.randomise:
        return task
    return replace(task, observation=replace(task.observation, noise=False), depth=task.depth.exact())


@torch.inference_mode()
def run(policy: Policy, env: ParkourEnv, trials: int, tick: Callable[[float], None] = lambda share: None) -> Trials:
    """Every world runs equally many episodes, and all of them count: those that end first would be the short ones.

    Trial `round * worlds + world` is the world's episode of that round.

    Args:
        tick: called with the share of trials that have ended, when some have.
    """
    rounds, worlds, device = -(-trials // env.num_worlds), env.num_worlds, env.device
    finished = torch.zeros(worlds, dtype=torch.long, device=device)
    outcome = torch.zeros(rounds, worlds, dtype=torch.long, device=device)
    position = torch.zeros(rounds, worlds, 3, device=device)
    seconds, covered = torch.zeros(rounds, worlds, device=device), torch.zeros(rounds, worlds, device=device)
    observation = env.reset()
    while bool((finished < rounds).any()):
        observation = env.step(policy(observation)).observation
        if env.ends is not None:
            own = finished[env.ends.ids] < rounds
            ids = env.ends.ids[own]
            at = finished[ids], ids
            outcome[at], position[at] = env.ends.outcome[own], env.ends.position[own]
            seconds[at], covered[at] = env.ends.seconds[own], env.ends.covered[own]
            finished[ids] += 1
            tick(float(finished.sum()) / (rounds * worlds))
    return Trials(*(t.flatten(0, 1)[:trials].cpu() for t in (outcome, position, seconds, covered)))


def summarise(terrain: Terrain, geometry: str, trials: Trials, env: ParkourEnv, config: EvaluationConfig) -> Result:
    """Figures of the trials on one terrain."""
    won = trials.outcome == SUCCESS
    successes, count = int(won.sum()), len(won)
    failures = tuple(
        {
            "trial": i,
            "cause": OUTCOMES[int(trials.outcome[i])],
            "position": [round(float(v), 4) for v in trials.position[i]],
            "seconds": round(float(trials.seconds[i]), 3),
        }
        for i in (~won).nonzero().squeeze(-1).tolist()
    )
    reasons: dict[str, int] = {}
    for failure in failures:
        reasons[failure["cause"]] = reasons.get(failure["cause"], 0) + 1
    return Result(
        terrain=terrain.name,
        geometry=geometry,
        trials=count,
        successes=successes,
        interval=wilson(successes, count),
        reasons=dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
        where=_bins(terrain, failures, config.bin_m),
        failures=failures,
        seconds=float(trials.seconds[won].mean()) if successes else None,
        covered=float(trials.covered.mean()),
        overflowed=env.physics.overflowed,
    )


def wilson(successes: int, trials: int, z: float = Z95) -> tuple[float, float]:
    """Wilson's score interval of a proportion (Wilson 1927): honest at 0 and 100 percent too."""
    p, zz = successes / trials, z * z / trials
    middle = (p + zz / 2) / (1 + zz)
    half = z / (1 + zz) * sqrt(p * (1 - p) / trials + zz / (4 * trials))
    return max(0.0, middle - half), min(1.0, middle + half)


def _bins(terrain: Terrain, failures: Sequence[dict[str, Any]], width: float) -> tuple[dict[str, Any], ...]:
    """Failures by distance from the start platform's centre toward the goal."""
    away = (terrain.goal.centre - terrain.start.centre)[:2]
    ahead = away / sqrt(float(away @ away))
    found: dict[int, dict[str, int]] = {}
    for failure in failures:
        along = float((failure["position"][:2] - terrain.start.centre[:2]) @ ahead)
        causes = found.setdefault(int(along // width), {})
        causes[failure["cause"]] = causes.get(failure["cause"], 0) + 1
    return tuple({"from_m": round(i * width, 4), "to_m": round((i + 1) * width, 4)} | found[i] for i in sorted(found))
