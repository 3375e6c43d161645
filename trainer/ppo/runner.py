"""One iteration of training: collect, improve, report. And all that it takes to go on from a checkpoint exactly."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.graphs import Graph, places, room
from trainer.ppo.algorithm import PPO, Action, Augment, bootstrap
from trainer.ppo.amp import StylePrior
from trainer.ppo.config import PPOConfig
from trainer.ppo.distributed import Rank, all_sum, broadcast, gather
from trainer.ppo.policy import Policy, check_layout
from trainer.ppo.storage import Rollout
from trainer.tasks import Observation, Step, VecEnv


class Runner:
    """Trains a policy in an environment, an iteration at a time.

    Args:
        env: this rank's worlds.
        policy: trained in place.
        config: see `PPOConfig`.
        rank: which of the processes this is.
        seed: of the action noise and the shuffling; each rank draws its own.
        prior: the style prior, if motion is to look like a reference.
        augment: adds samples to every minibatch.
        groups: joints by part of the body, whose noise is logged by itself.
    """

    def __init__(
        self,
        env: VecEnv,
        policy: Policy,
        config: PPOConfig,
        *,
        rank: Rank,
        seed: int = 0,
        prior: StylePrior | None = None,
        augment: Augment | None = None,
        groups: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        check_layout(policy.layout, env.layout)
        config.check_samples(env.num_worlds)
        self.env, self.policy, self.config, self.rank, self.prior = env, policy.to(rank.device), config, rank, prior
        if rank.device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32: the noise of PPO is far above its rounding
            torch.backends.cudnn.benchmark = True  # the same few shapes over and over
        broadcast(policy.actor, policy.critic, None if prior is None else prior.layers)
        self.ppo = PPO(policy.actor, policy.critic, config, augment=augment, tuned=bool(policy.tuned))
        self.groups = dict(groups or {})
        self.rollout = Rollout(config.steps, env.num_worlds, env.layout, rank.device)
        self.rng = torch.Generator(rank.device).manual_seed(seed * 1009 + rank.index)
        self.iteration = 0
        self.samples = 0
        self.observation: Observation | None = None
        self.episodes = _Episodes(env.num_worlds, rank.device)
        self.padded = env.graphs
        """Whether batches have one of a few sizes, instead of as many rows as are needed."""
        self._step = torch.zeros(1, dtype=torch.long, device=rank.device)
        self._acting = Graph(self._act, self.rng, env.graphs, calls=2)
        self._keeping = Graph(self._keep, self.rng, env.graphs, calls=2)

    def begin(self) -> None:
        """Start all worlds anew: at the start and on a resume."""
        self.observation = self.env.reset()
        self.rollout.restart()
        self.episodes.restart()

    def iterate(self) -> dict[str, float]:
        """One iteration; its losses, the environment's log, mean reward, episode figures and seconds."""
        if self.observation is None:
            self.begin()
        began = time.perf_counter()
        self.ppo.limit_noise(self.iteration)
        log = self._collect()
        self._wait()
        collected = time.perf_counter()
        losses = self.ppo.update(self.rollout, self.rng)
        std = self.ppo.log_std.detach().exp()
        losses |= {f"std/{name}": std[list(joints)].mean() for name, joints in self.groups.items()}
        if self.prior is not None:
            losses |= self.prior.update(self.rng)
        self.rollout.carry()
        result = _read(losses, {**log, **self.episodes.take()})
        ended = time.perf_counter()
        self.iteration += 1
        self.samples += self.config.steps * self.env.num_worlds * self.rank.count
        for name in ("policy_loss", "value_loss"):
            if not result[name] == result[name] or abs(result[name]) == float("inf"):
                raise TrainerError(
                    f"training diverged in iteration {self.iteration}: {name} is {result[name]}",
                    hint="resume from the last checkpoint with a smaller --learning-rate",
                )
        result["collect_s"], result["update_s"] = collected - began, ended - collected
        result["samples"] = float(self.samples)
        return result

    def go_back(self, policy: Policy | None) -> None:
        """Train on from an earlier policy of this run, that of the first rank, in an easier task; on all ranks at once.

        None on the first rank: from where it is.
        """
        if policy is not None:
            self.policy.actor.load_state_dict(policy.actor.state_dict())
            self.policy.critic.load_state_dict(policy.critic.state_dict())
        broadcast(self.policy.actor, self.policy.critic)
        self.ppo.forget()
        self.env.ease()
        self.begin()

    def state_dict(self) -> dict[str, Any]:
        """Everything but the networks. To be taken on all ranks at once; the same on all."""
        here = {"env": self.env.state_dict(), "rng": self.rng.get_state(), "torch": torch.get_rng_state()}
        return {
            "iteration": self.iteration,
            "samples": self.samples,
            "ppo": self.ppo.state_dict(),
            "prior": None if self.prior is None else self.prior.state_dict(),
            "ranks": gather(here),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> list[str]:
        """Go on from there; the returned notes name what is not exact.

        With another number of ranks, rank r takes the curriculum of rank r modulo the old number. Then, and on another
        kind of device, whose random numbers are others, each rank draws anew.
        """
        notes: list[str] = []
        self.iteration, self.samples = int(state["iteration"]), int(state["samples"])
        self.ppo.load_state_dict(state["ppo"])
        if self.prior is not None and state["prior"] is not None:
            self.prior.load_state_dict(state["prior"])
        ranks = state["ranks"]
        mine = ranks[self.rank.index % len(ranks)]
        alike = len(mine["rng"]) == len(self.rng.get_state())
        fresh = None if alike and len(ranks) == self.rank.count else (self.iteration + 1) * 100003 + self.rank.index
        try:
            self.env.load_state_dict(mine["env"], fresh)
        except TrainerError as error:
            notes.append(f"the curriculum restarts: {error.message} ({error.found} instead of {error.expected})")
        if fresh is None:
            self.rng.set_state(mine["rng"])
            torch.set_rng_state(mine["torch"])
        else:
            self.rng.manual_seed(fresh)
            where = f"{self.rank.count} ranks instead of {len(ranks)}" if alike else "another kind of device"
            notes.append(f"resumed on {where}: not bit for bit the same run")
        self.observation = None
        return notes

    @torch.no_grad()
    def _collect(self) -> dict[str, Tensor]:
        """Fill the rollout; what the environment logged, on the device."""
        assert self.observation is not None
        logs: dict[str, list[float | Tensor]] = {}
        self._step.zero_()
        for _ in range(self.config.steps):
            action, value = self._acting(self.observation)
            result = self.env.step(action.sample)
            style = None if self.prior is None or result.amp is None else self.prior.reward(result.amp)
            rows = self._late(result)
            final = result.final_observation if rows else None
            self._keeping(action, value, result.reward, style, result.terminated, result.truncated, final, rows=rows)
            self.observation = result.observation
            for name, entry in result.log.items():
                logs.setdefault(name, []).append(entry)
        self.ppo.finish(self.rollout, self.observation)
        device = self.rank.device
        return {
            f"env/{k}": torch.stack([torch.as_tensor(x, device=device) for x in v]).float().nanmean()
            for k, v in logs.items()
        }

    def _late(self, result: Step) -> int:
        """How many rows hold the worlds whose time ran out at this step."""
        if result.final_observation is None:
            return 0
        if self.padded:
            worlds = self.env.num_worlds
            return room(worlds if result.ended is None else result.ended, worlds)
        # The environment has waited for the device at this step already: asking it again costs little.
        return int((result.truncated & ~result.terminated).sum())

    def _act(self, observation: Observation) -> tuple[Action, Tensor]:
        """What the policy does, and the value; the observation is kept."""
        seen = self.rollout.see(self._step, observation)
        return self.ppo.act(seen, self.rng), self.policy.critic.of(seen)

    def _keep(
        self,
        action: Action,
        value: Tensor,
        reward: Tensor,
        style: Tensor | None,
        terminated: Tensor,
        truncated: Tensor,
        final: Observation | None,
        rows: int,
    ) -> None:
        """What came of an action; the last observation of worlds whose time ran out, at most `rows`, is valued."""
        done, late = terminated | truncated, truncated & ~terminated
        self.episodes.add(reward, done)
        reward = reward if style is None else reward + style
        if final is not None:
            ids, _ = places(late, rows)
            last = torch.zeros_like(value)
            last[ids] = self.policy.critic.of(final.map(lambda x: x[ids]))
            reward = bootstrap(reward, last, late, self.config.gamma)
        self.rollout.add(self._step, action.sample, action.mean, action.log_prob, value, reward, done)
        self._step += 1

    def _wait(self) -> None:
        if self.rank.device.type == "cuda":
            torch.cuda.synchronize()


class _Episodes:
    """Return and length of episodes that ended, without waiting for the device."""

    def __init__(self, worlds: int, device: torch.device) -> None:
        self.running = torch.zeros(2, worlds, device=device)
        self.sums = torch.zeros(3, device=device)
        self.reward, self.steps = torch.zeros((), device=device), torch.zeros((), device=device)

    def restart(self) -> None:
        """All worlds begin anew, and so do the figures."""
        for tensor in (self.running, self.sums, self.reward, self.steps):
            tensor.zero_()

    def add(self, reward: Tensor, done: Tensor) -> None:
        self.running += torch.stack([reward, torch.ones_like(reward)])
        ended = done.float()
        self.sums += torch.cat([self.running @ ended, ended.sum()[None]])
        self.running *= 1 - ended
        self.reward += reward.mean()
        self.steps += 1

    def take(self) -> dict[str, Tensor]:
        """Means since the last call (not-a-number where no episode ended)."""
        sums, reward = self.sums.clone(), self.reward / self.steps
        for tensor in (self.sums, self.reward, self.steps):
            tensor.zero_()
        return {"reward": reward, "return": sums[0] / sums[2], "length": sums[1] / sums[2], "episodes": sums[2]}


def _read(losses: Mapping[str, Tensor], figures: Mapping[str, Tensor]) -> dict[str, float]:
    """All values at once: the only wait for the device in an iteration. Ranks' means are taken.

    Among figures not-a-number says that there was nothing to count: such ranks are left out, and a figure of the
    environment (`env/...`) that no rank has is left out too. A loss that is not a number on one rank is none at all.
    """
    values = {**losses, **figures}
    device = next(iter(figures.values())).device
    stacked = torch.stack([v.detach().to(device, torch.float32).reshape(()) for v in values.values()])
    counted = ~stacked.isnan()
    counted[: len(losses)] = True
    sums, counts = all_sum(torch.stack([torch.where(counted, stacked, 0.0), counted.float()]))
    means = dict(zip(values, (sums / counts).tolist(), strict=True))
    return {name: mean for name, mean in means.items() if mean == mean or not name.startswith("env/")}
