"""rsl_rl (rsl-rl-lib 5.5) as the learner: its PPO and runner over the same environment, our networks, our files.

What differs from the built-in learner: at time-outs rsl_rl bootstraps from the value of the observation before the last
step, not of the true last one; its learning rate follows the divergence of the samples as they were seen, ours that
of mirror samples too; it does not resume bit for bit; no style prior, one process. One update on the same samples gives
the same parameters (tests/trainer/test_rsl_rl.py).
"""

import contextlib
import os
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from realsim.core.errors import MissingExtraError
from trainer.errors import TrainerError
from trainer.ppo import checkpoint, gaussian
from trainer.ppo.config import PPOConfig
from trainer.ppo.distributed import Rank, pick_device
from trainer.ppo.loop import Best, History
from trainer.ppo.policy import Policy
from trainer.ppo.symmetry import Mirror
from trainer.tasks import Observation, VecEnv
from trainer.trainers.base import Scene, TrainConfig, TrainResult
from trainer.trainers.ppo import decide, environment, trials, write_onnx
from trainer.trainers.ppo import learner as begun

try:
    from rsl_rl.algorithms import PPO
    from rsl_rl.env import VecEnv as RslVecEnv
    from rsl_rl.runners import OnPolicyRunner
    from rsl_rl.storage import RolloutStorage
    from tensordict import TensorDict
except ImportError as error:
    raise MissingExtraError(str(error.name), "rsl-rl", "the trainer rsl_rl") from error


def train(scene: Scene, policy: Path | None, config: TrainConfig, out: Path) -> TrainResult:
    """See `Trainer`. The folder gets rsl_rl's own log (rsl_rl.log, events) beside our files."""
    began = time.perf_counter()
    cannot = {
        "several processes (torchrun)": int(os.environ.get("WORLD_SIZE", "1")) > 1,
        "--resume": config.resume is not None,
        "--amp": config.ppo.prior.amp,
    }
    refused = [name for name, wanted in cannot.items() if wanted]
    if refused:
        raise TrainerError(f"the trainer rsl_rl does not do {', '.join(refused)}", hint="use the trainer ppo for that")
    rank = Rank(0, 1, pick_device(config.device, engine=config.engine))
    plan = decide(config, policy, rank)
    settings = plan.config
    env = environment(scene, plan)
    learner = begun(policy, plan, env)
    out.mkdir(parents=True, exist_ok=True)
    runner = build(env, learner.to(rank.device), settings.ppo, out / "events", settings.seed, env.mirror)
    history, best = History(), Best()
    evaluate = trials(scene, plan) if scene.goals and settings.loop.evaluate_every else None
    done, chunk = 0, settings.loop.evaluate_every or settings.loop.iterations
    while True:
        if evaluate is not None:
            history.evaluations.append((done, evaluate(learner)))
            best.consider(history.evaluations[-1][1], learner)
        reached = settings.loop.stop_at_target and history.to_target(settings.loop.target) is not None
        if done >= settings.loop.iterations or reached:
            break
        ahead = min(chunk, settings.loop.iterations - done)
        with (out / "rsl_rl.log").open("a") as log, contextlib.redirect_stdout(log):
            runner.learn(ahead)
        done += ahead
    learner = best.policy or learner
    checkpoint.save(out / "policy.pt", learner)
    return TrainResult(
        policy=out / "policy.pt",
        onnx=write_onnx(out / "policy.onnx", learner, plan.task, env.policy_dt),
        robot=plan.robot,
        iterations=done,
        to_target=history.to_target(settings.loop.target),
        evaluations=tuple(history.evaluations),
        worlds=plan.worlds,
        seconds=time.perf_counter() - began,
        warnings=env.warnings,
    )


def build(
    env: VecEnv, policy: Policy, config: PPOConfig, log: Path | None, seed: int = 0, mirror: Mirror | None = None
) -> OnPolicyRunner:
    """rsl_rl's runner over an environment of ours, training our networks in place."""
    torch.manual_seed(seed)

    class OverOurs(PPO):
        @staticmethod
        def construct_algorithm(obs: TensorDict, worlds: Any, cfg: dict[str, Any], device: str) -> PPO:
            return algorithm(obs, worlds.num_envs, policy, config, device, mirror)

    settings = {
        "algorithm": {"class_name": OverOurs},
        "num_steps_per_env": config.steps,
        "save_interval": 10**9,  # the checkpoint is ours
        "obs_groups": {"actor": ["actor", "depth"], "critic": ["critic", "depth"]},
    }
    return OnPolicyRunner(Worlds(env), settings, None if log is None else str(log), str(env.device))


def algorithm(
    obs: TensorDict, worlds: int, policy: Policy, config: PPOConfig, device: str, mirror: Mirror | None = None
) -> PPO:
    """rsl_rl's PPO with our networks and settings."""
    storage = RolloutStorage("rl", worlds, config.steps, obs, [len(policy.layout.actions)], device)
    learner = PPO(
        Model(policy.actor, "actor", config.std_limit(0, bool(policy.tuned))),
        Model(policy.critic, "critic"),
        storage,
        num_learning_epochs=config.epochs,
        num_mini_batches=config.minibatches,
        clip_param=config.clip,
        gamma=config.gamma,
        lam=config.lam,
        value_loss_coef=config.value_weight,
        entropy_coef=config.entropy_weight,
        learning_rate=config.first_rate(bool(policy.tuned)),
        max_grad_norm=config.max_gradient,
        schedule=config.schedule,
        desired_kl=config.desired_kl,
        symmetry_cfg=_symmetry(config, mirror),
        device=device,
    )
    noise, largest = policy.actor.get_parameter("log_std"), learner.actor.largest
    gaussian.keep_within(noise, largest)
    learner.optimizer.register_step_post_hook(lambda *_: gaussian.keep_within(noise, largest))
    return learner


def _symmetry(config: PPOConfig, mirror: Mirror | None) -> dict[str, Any] | None:
    """rsl_rl's settings of what ours are; without a mirror there is no symmetry."""
    if mirror is None or config.symmetry == "none":
        return None

    def both(env: Any, obs: TensorDict | None, actions: Tensor | None) -> tuple[TensorDict | None, Tensor | None]:
        if obs is not None:
            o = mirror.observation(Observation(obs["actor"], obs["critic"], obs.get("depth", None)))
            obs = TensorDict.cat([obs, _groups(o, len(obs))])
        return obs, None if actions is None else torch.cat([actions, mirror.action(actions)])

    return {
        "env": None,
        "data_augmentation_func": both,
        "use_data_augmentation": True,
        "use_mirror_loss": False,
        "mirror_loss_coeff": 0.0,
    }


class Worlds(RslVecEnv):
    """Our environment with rsl_rl's face. Episode ages are the environment's own; `episode_length_buf` only mirrors."""

    def __init__(self, env: VecEnv) -> None:
        self.env = env
        self.num_envs, self.num_actions, self.device = env.num_worlds, env.num_actions, env.device
        self.max_episode_length = env.max_steps
        self.episode_length_buf = torch.zeros(env.num_worlds, dtype=torch.long, device=env.device)
        self.cfg: dict[str, Any] = {}
        self.now = env.reset()

    def get_observations(self) -> TensorDict:
        """The present observation."""
        return _groups(self.now, self.num_envs)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """(observation, reward (N,), done (N,), extras with time-outs and the log)."""
        result = self.env.step(actions)
        self.now = result.observation
        done = result.terminated | result.truncated
        self.episode_length_buf = torch.where(done, 0, self.episode_length_buf + 1)
        late = (result.truncated & ~result.terminated).float()
        log = {f"/{name}": value for name, value in result.log.items() if value == value}  # not-a-number: no episodes
        return _groups(self.now, self.num_envs), result.reward, done.long(), {"time_outs": late, "log": log}


class Model(nn.Module):
    """A network of ours with the face of rsl_rl's `MLPModel`."""

    is_recurrent = False

    def __init__(self, network: nn.Module, group: str, largest: float = 1.0) -> None:
        super().__init__()
        self.network, self.group, self.largest = network, group, largest
        self.output: tuple[Tensor, Tensor] | None = None  # mean and logarithm of the standard deviation

    def forward(self, obs: TensorDict, *_: Any, stochastic_output: bool = False, **__: Any) -> Tensor:
        """Value (N, 1), deterministic or sampled action (N, J)."""
        out = self.network(obs[self.group], obs.get("depth", None))
        if self.group == "critic":
            return out.unsqueeze(-1)
        self.output = out, gaussian.bounded(self.network.log_std, self.largest)  # type: ignore[arg-type]
        if not stochastic_output:
            return out
        return out + self.output[1].exp() * torch.randn_like(out)

    def get_output_log_prob(self, action: Tensor) -> Tensor:
        """(N,) of the last forward pass."""
        return gaussian.log_prob(action, *self._distribution)

    @property
    def output_distribution_params(self) -> tuple[Tensor, Tensor]:
        mean, log_std = self._distribution
        return mean, log_std.exp().expand_as(mean)

    @property
    def output_std(self) -> Tensor:
        return self._distribution[1].exp()

    @property
    def output_entropy(self) -> Tensor:
        mean, log_std = self._distribution
        return gaussian.entropy(log_std).expand(len(mean))

    def get_kl_divergence(self, old: tuple[Tensor, Tensor], new: tuple[Tensor, Tensor]) -> Tensor:
        """(N,) from (mean, std) to (mean, std)."""
        return gaussian.divergence(old[0], old[1].log(), new[0], new[1].log())

    def update_normalization(self, obs: TensorDict) -> None:
        """Take observations into the normaliser, unless it is frozen with its base."""
        self.network.normaliser.update(obs[self.group])  # type: ignore[union-attr,operator]

    def reset(self, dones: Tensor | None = None, hidden_state: Any = None) -> None:
        """Nothing is kept between steps."""

    def get_hidden_state(self) -> None:
        """There is none."""

    @property
    def _distribution(self) -> tuple[Tensor, Tensor]:
        assert self.output is not None
        return self.output


def _groups(observation: Observation, worlds: int) -> TensorDict:
    groups = {"actor": observation.actor, "critic": observation.critic, "depth": observation.depth}
    return TensorDict({k: v for k, v in groups.items() if v is not None}, batch_size=[worlds])
