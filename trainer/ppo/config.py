"""Options of a learner. Every field is a command line option, its docstring the help."""

from dataclasses import dataclass, field
from typing import Literal

from trainer.errors import TrainerError, check_fields


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the networks. Part of a checkpoint: a policy is rebuilt from it."""

    channels: tuple[int, ...] = (16, 32)
    """Output channels of the depth encoder's convolutions; each halves the image."""
    latent: int = 64
    """Width of the depth latent."""
    actor: tuple[int, ...] = (512, 256, 128)
    """Hidden layers of the actor."""
    critic: tuple[int, ...] = (512, 256, 128)
    """Hidden layers of the critic."""
    critic_depth: bool = True
    """Whether the critic sees depth through an encoder of its own, beside its privileged state."""
    std: float = 1.0
    """Standard deviation of the actions at the start."""

    def __post_init__(self) -> None:
        check_fields(self, above={"std": 0}, least=dict.fromkeys(("channels", "latent", "actor", "critic"), 1))
        if not self.actor or not self.critic:
            raise TrainerError("networks need hidden layers", found=f"actor {self.actor}, critic {self.critic}")


@dataclass(frozen=True)
class StrategyConfig:
    """Options of fine-tuning strategies."""

    adapter_width: int = 16
    """Bottleneck of an adapter."""
    residual_hidden: tuple[int, ...] = (128, 64)
    """Hidden layers of the residual network."""
    start_std: float | None = 0.3
    """Exploration noise at the start of fine-tuning; `None` keeps the base's. A base that was still
    exploring has too much noise for the footholds of a hard course."""

    def __post_init__(self) -> None:
        check_fields(self, above={"start_std": 0}, least={"adapter_width": 1, "residual_hidden": 1})


@dataclass(frozen=True)
class AmpConfig:
    """Adversarial motion prior: a discriminator that prefers reference motion."""

    amp: bool = False
    """Add the style reward."""
    amp_weight: float = 0.25
    """Weight of the style reward (the paper's table), times the policy step like every term."""
    amp_hidden: tuple[int, ...] = (256, 128)
    """Hidden layers of the discriminator."""
    amp_learning_rate: float = 1e-4
    """Learning rate of the discriminator."""
    amp_gradient_penalty: float = 10.0
    """Weight of the squared gradient norm on reference motion."""


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation (Schulman et al. 2017), with the values usual for legged robots."""

    steps: int = 24
    """Policy steps of every world per iteration."""
    epochs: int = 3
    """Passes over the samples of an iteration. With mirror samples each has twice as many."""
    minibatches: int = 4
    """Gradient steps per pass."""
    clip: float = 0.2
    """Clipping of the probability ratio, and of the value's change."""
    gamma: float = 0.99
    """Discount per policy step."""
    lam: float = 0.95
    """Lambda of the generalised advantage estimate."""
    value_weight: float = 1.0
    """Weight of the value loss."""
    entropy_weight: float = 0.001
    """Weight of the entropy bonus. With 0.005 the noise of G1's 29 joints grew all through training."""
    std_limits: tuple[float, float] = (1.0, 0.3)
    """Largest exploration noise, at first and after `std_iterations`; fine-tuning has the second all along. Under a
    standard deviation of 0.94 a foot of G1 lands 12 cm off (one sigma), under 0.35 4 cm; hard footholds are 16 cm."""
    std_iterations: int = 400
    """Iterations over which the largest noise falls from the first to the second value, linearly."""
    learning_rate: float | None = None
    """Learning rate at the start; if not given, 1e-3 for a new policy and 1e-4 for fine-tuning. On a resume, a
    different value replaces the saved one."""
    schedule: Literal["adaptive", "fixed"] = "adaptive"
    """Whether the learning rate follows the KL divergence between the policies before and after."""
    desired_kl: float = 0.01
    """Above twice this the learning rate falls by a third, below half of it it rises by a half."""
    learning_rates: tuple[float, float] = (1e-5, 1e-2)
    """Bounds of the adaptive learning rate."""
    critic_rate: float | None = 1e-3
    """Learning rate of the critic, fixed: independent of the policy's, which follows the KL divergence. `None`
    gives it the policy's."""
    max_gradient: float = 1.0
    """Gradient norms above this are scaled down, of policy and critic each on its own."""
    symmetry: Literal["none", "augmentation"] = "augmentation"
    """Left-right symmetry: every sample a second time mirrored (Mittal et al. 2024)."""
    networks: NetworkConfig = field(default_factory=NetworkConfig)
    prior: AmpConfig = field(default_factory=AmpConfig)

    def __post_init__(self) -> None:
        check_fields(
            self,
            above=dict.fromkeys(("gamma", "clip", "learning_rate", "std_limits"), 0),
            least=dict.fromkeys(("steps", "epochs", "minibatches"), 1)
            | dict.fromkeys(("lam", "std_iterations", "critic_rate"), 0),
            most={"gamma": 1, "lam": 1},
        )

    def check_samples(self, worlds: int) -> None:
        """Refuse more minibatches than an iteration of that many worlds has samples.

        Raises:
            TrainerError: what there is.
        """
        if self.minibatches > self.steps * worlds:
            raise TrainerError(
                "there are more minibatches than samples",
                expected=f"at most {self.steps * worlds} of {self.steps} steps x {worlds} worlds",
                found=f"--minibatches {self.minibatches}",
            )

    def std_limit(self, iteration: int, tuned: bool) -> float:
        """Largest exploration noise in an iteration of a new policy, or of one that is fine-tuned."""
        first, last = self.std_limits
        done = 1.0 if tuned or iteration >= self.std_iterations else iteration / self.std_iterations
        return first + (last - first) * done

    def first_rate(self, tuned: bool) -> float:
        """Learning rate with which a new policy begins, or one to be fine-tuned.

        A new optimiser's first steps change every weight by the whole rate. With 1e-3 a policy that could walk
        diverged by 17 to 150 times what is wanted before the schedule had slowed it (docs/training.md).
        """
        return self.learning_rate or (1e-4 if tuned else 1e-3)


@dataclass(frozen=True)
class LoopConfig:
    """How long to train and what to write on the way."""

    iterations: int = 1000
    """Iterations in all, those before a resume included."""
    checkpoint_every: int = 100
    """Iterations between checkpoints."""
    restart_at_checkpoint: bool = False
    """Start all worlds anew after every checkpoint, as a resume has to: an interrupted run is then bit for bit the
    uninterrupted one. It costs samples: for half a second all worlds show the same part of the course."""
    evaluate_every: int = 10
    """Iterations between evaluations on the way; 0 leaves them out."""
    evaluate_share: float = 0.1
    """Largest share of the training time that they may take: an evaluation that is due sooner is left out. 1 leaves
    none out, which makes a run repeatable to its last row."""
    watch: int = 20
    """Iterations over which robots must wait for half of the time before training goes back to the policy of the best
    evaluation and makes the task easier; so it does when success has fallen. 0 never does."""
    target: float = 0.97
    """Success rate whose first evaluation above it is reported (iterations to 97 percent)."""
    stop_at_target: bool = False
    """Stop there."""
    minutes: float = 0.0
    """Stop after this many minutes, at the end of an iteration and with a checkpoint; 0 sets no limit."""
    tensorboard: bool = True
    """Write event files for TensorBoard into the folder."""

    def __post_init__(self) -> None:
        check_fields(
            self,
            above={"target": 0, "evaluate_share": 0},
            least={"iterations": 1, "checkpoint_every": 1, "evaluate_every": 0, "watch": 0, "minutes": 0},
            most={"target": 1, "evaluate_share": 1},
        )
