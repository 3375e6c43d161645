"""The built-in learner: `trainer.ppo` in the parkour task."""

import gc
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from realsim.core.errors import MissingExtraError
from realsim.core.progress import note
from trainer.errors import TrainerError
from trainer.evaluate import EvaluationConfig, Setting, run, trial_env
from trainer.physics import PhysicsConfig
from trainer.ppo import checkpoint, export, loop
from trainer.ppo import policy as policies
from trainer.ppo.amp import StylePrior
from trainer.ppo.distributed import Rank, ranks
from trainer.ppo.policy import Policy
from trainer.ppo.runner import Runner
from trainer.ppo.symmetry import MirrorSamples
from trainer.robots import named
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, make
from trainer.tasks.parkour.terminations import SUCCESS
from trainer.trainers.base import Scene, TrainConfig, TrainResult

FEWEST_WORLDS = 16


@dataclass(frozen=True)
class Plan:
    """A config with everything that it leaves open decided."""

    config: TrainConfig
    task: ParkourConfig
    robot: str
    engine: str
    physics: PhysicsConfig
    worlds: int


def train(scene: Scene, policy: Path | None, config: TrainConfig, out: Path) -> TrainResult:
    """See `Trainer`. Under torchrun every rank calls this; the first writes."""
    began = time.perf_counter()
    with ranks(config.device, config.engine) as rank:
        plan = decide(config, policy, rank)
        warnings: list[str] = []
        while True:
            try:
                runner, history = _attempt(scene, policy, plan, rank, out)
                break
            except RuntimeError as error:
                plan = _with_fewer_worlds(plan, error, rank)
                warnings.append(f"the GPU's memory was not enough: {plan.worlds} worlds instead of {2 * plan.worlds}")
                note(warnings[-1])
                gc.collect()  # an environment and its graphs hold each other
                torch.cuda.empty_cache()
        onnx: Path | None = None
        if rank.first:
            try:
                delivered, _ = checkpoint.load(out / "policy.pt")
                onnx = write_onnx(out / "policy.onnx", delivered, plan.task, runner.env.policy_dt)
            except MissingExtraError as error:  # a training machine need not be able to export; the checkpoint is there
                warnings.append(f"no policy.onnx was written: {error.message}; {error.hint}")
    untouched = ("nothing was trained: the target was reached before the first iteration",)
    return TrainResult(
        policy=out / "policy.pt",
        onnx=onnx,
        robot=plan.robot,
        iterations=runner.iteration,
        to_target=history.to_target(config.loop.target),
        evaluations=tuple(history.evaluations),
        worlds=plan.worlds,
        seconds=time.perf_counter() - began,
        warnings=(*warnings, *runner.env.warnings, *history.notes, *(() if runner.iteration else untouched)),
    )


def decide(config: TrainConfig, policy: Path | None, rank: Rank) -> Plan:
    """Robot, engine, device and number of worlds."""
    gpu = rank.device.type == "cuda"
    source = config.resume or policy
    robot = config.robot
    if source is not None:
        trained = str(checkpoint.read(source)["robot"])
        if robot and robot != trained:
            raise TrainerError("the policy is for another robot", file=source, expected=robot, found=trained)
        robot = trained
    robot = robot or "g1"
    engine = config.engine or ("warp" if gpu else "mujoco")
    worlds = config.worlds or (4096 if gpu else 64)
    config.ppo.check_samples(worlds)
    seed = config.seed * 1009 + rank.index
    physics = PhysicsConfig(device=str(rank.device), threads=config.threads, seed=seed)
    task = replace(config.task, amp=config.ppo.prior.amp)
    if named(robot, source).camera is None:
        task = replace(task, depth=replace(task.depth, use=False))
    return Plan(replace(config, seed=seed), task, robot, engine, physics, worlds)


def start(scene: Scene, file: Path | None, plan: Plan, rank: Rank) -> Runner:
    """Environment, policy and what is optional, ready to iterate."""
    config = plan.config
    env = environment(scene, plan, graphs=config.graphs)
    if config.resume is not None:
        policy, _ = checkpoint.load(config.resume, latest=True)
        applied = policy.tuned[-1][0] if policy.tuned else "full"
        if config.strategy not in ("", applied):
            raise TrainerError(
                "the checkpoint belongs to a run with another strategy",
                file=config.resume,
                expected=f"--strategy {config.strategy}",
                found=applied,
                hint="leave --strategy out to resume, or start a new run from it with --policy",
            )
    else:
        policy = learner(file, plan, env)
    policies.check_layout(policy.layout, env.layout, str(config.resume or ""))
    return Runner(
        env,
        policy,
        config.ppo,
        rank=rank,
        seed=config.seed,
        prior=_prior(plan, env),
        augment=MirrorSamples(env.mirror) if config.ppo.symmetry == "augmentation" else None,
        groups=named(plan.robot).groups,
    )


def environment(scene: Scene, plan: Plan, graphs: bool = False) -> ParkourEnv:
    """The worlds to train in."""
    return make(
        plan.task,
        scene.terrains,
        robot=plan.robot,
        worlds=plan.worlds,
        engine=plan.engine,
        physics=plan.physics,
        rows=scene.rows,
        diagnosis=plan.config.diagnosis,
        seed=plan.config.seed,
        graphs=graphs,
    )


def learner(file: Path | None, plan: Plan, env: ParkourEnv) -> Policy:
    """A new policy, or the base in `file` made ready for fine-tuning."""
    config = plan.config
    if file is None:
        return policies.new(env.layout, config.ppo.networks, plan.robot, config.seed)
    base, _ = checkpoint.load(file)
    policies.check_layout(base.layout, env.layout, str(file))
    return policies.fine_tune(base, config.strategy or "full", config.tuning, config.seed)


def trials(scene: Scene, plan: Plan) -> loop.Evaluate:
    """Success rate in the same trials whenever it is requested; worlds of its own, made when first asked."""
    task = plan.config.trial_task or plan.task
    task = replace(task, depth=replace(task.depth, use=plan.task.depth.use))
    setting = Setting(plan.robot, plan.engine, None, task, plan.physics, plan.config.diagnosis)
    settings = EvaluationConfig(trials=plan.config.trials, worlds=min(plan.config.trials, 250), seed=plan.config.seed)
    envs: list[tuple[ParkourEnv, dict[str, object]]] = []

    @torch.inference_mode()
    def evaluate(policy: Policy) -> float:
        if not envs:
            made = [trial_env(t, settings.worlds, settings, setting) for t in scene.goals]
            envs.extend((env, env.state_dict()) for env in made)
        won, count = 0, 0
        for env, state in envs:
            env.load_state_dict(state)
            outcome = run(policy.act, env, settings.trials).outcome
            won, count = won + int((outcome == SUCCESS).sum()), count + len(outcome)
        return won / count

    return evaluate


def write_onnx(path: Path, policy: Policy, task: ParkourConfig, policy_dt: float) -> Path:
    """Export with everything that a robot must know; the file written."""
    depth = (task.depth.near, task.depth.far)
    facts = export.deployment(policy, named(policy.robot), policy_dt, depth, task.action_limit)
    export.export(path, policy, facts)
    return path


def _attempt(scene: Scene, file: Path | None, plan: Plan, rank: Rank, out: Path) -> tuple[Runner, loop.History]:
    runner = start(scene, file, plan, rank)
    # A grid's success is in its own log; trials on each of its hundreds of terrains would take longer than it.
    evaluate = trials(scene, plan) if scene.goals else None
    config = plan.config
    return runner, loop.train(runner, config.loop, out, evaluate=evaluate, resume=config.resume)


def _with_fewer_worlds(plan: Plan, error: RuntimeError, rank: Rank) -> Plan:
    """The plan with half the worlds if memory ran out; any other error goes on its way."""
    if not (isinstance(error, torch.OutOfMemoryError) or "out of memory" in str(error).lower()):
        raise error
    if rank.count > 1 or plan.worlds // 2 < FEWEST_WORLDS or plan.config.resume is not None:
        raise TrainerError(
            "the GPU's memory is not enough",
            found=f"{plan.worlds} worlds on {rank.device}",
            hint=f"--worlds {max(FEWEST_WORLDS, plan.worlds // 2)}",
        ) from error
    return replace(plan, worlds=plan.worlds // 2)


def _prior(plan: Plan, env: ParkourEnv) -> StylePrior | None:
    settings = plan.config.ppo.prior
    if not settings.amp:
        return None
    from trainer.ppo.motion import reference

    features = reference(named(plan.robot), env.policy_dt).to(env.device)
    return StylePrior(features, settings, env.policy_dt)
