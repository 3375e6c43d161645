"""The interface of trainers: scene + policy + config -> result."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Protocol

import tyro

from trainer.errors import TrainerError
from trainer.ppo.config import LoopConfig, PPOConfig, StrategyConfig
from trainer.tasks.parkour import ParkourConfig
from trainer.terrain import Terrain


@dataclass(frozen=True)
class Scene:
    """Terrain to train on: one (TTT-1), several (TTT-n), or a curriculum grid."""

    terrains: tuple[Terrain, ...]
    rows: int = 1
    """Rows of a curriculum grid, row by row; 1 without a curriculum."""
    judged: tuple[Terrain, ...] = ()
    """Terrains of the trials on the way, where those trained on are easier too; () judges on those without rows."""
    folders: tuple[Path, ...] = ()
    """Reconstructed scenes that the terrains come from, for engines that load `scene.xml` themselves."""

    def __post_init__(self) -> None:
        if not self.terrains:
            raise TrainerError("there is no terrain to train on")

    @property
    def goals(self) -> tuple[Terrain, ...]:
        """The terrains that success is measured on; none of a curriculum whose success is in its own log."""
        return self.judged or (self.terrains if self.rows == 1 else ())


@dataclass(frozen=True)
class TrainConfig:
    """Options of training; every trainer supports it, or names the options that it does not."""

    robot: Annotated[str, tyro.conf.arg(metavar="{g1,go2,quadruped,FILE.toml}")] = ""
    """Robot of a new policy: a name, or a file of `realsim robot new`; a given policy brings its own."""
    strategy: Annotated[str, tyro.conf.arg(metavar="{full,adapter,residual,last_layer}")] = ""
    """What fine-tuning changes: full (if not given), adapter, residual, last_layer."""
    worlds: int = 0
    """Simulated robots on each rank; 0 takes 4096 on a GPU and 64 on the CPU."""
    engine: Annotated[str, tyro.conf.arg(metavar="{mujoco,warp,elliptic}")] = ""
    """Physics engine; by default warp on a GPU and mujoco on the CPU."""
    device: str = "auto"
    """cpu, cuda, or auto: a GPU where there is one, unless the engine is mujoco, which runs on the CPU."""
    threads: int = 0
    """Threads of the physics on the CPU; 0 takes all cores."""
    graphs: bool = True
    """On a GPU, run the task around the physics as CUDA graphs (the trainer ppo)."""
    seed: int = 0
    """Seed of networks, noise and worlds."""
    trials: int = 100
    """Trials on each terrain in an evaluation on the way."""
    diagnosis: Path | None = None
    """diagnosis.json of `realsim diagnose`, or its folder: its figures replace the assumed ranges of randomisation."""
    resume: Path | None = None
    """Checkpoint of the same run to resume from."""
    loop: LoopConfig = field(default_factory=LoopConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    tuning: StrategyConfig = field(default_factory=StrategyConfig)
    task: Annotated[ParkourConfig, tyro.conf.Suppress] = field(default_factory=ParkourConfig)
    """The task; from Python, or from a file (--task-file)."""
    trial_task: Annotated[ParkourConfig | None, tyro.conf.Suppress] = None
    """The task in which evaluations on the way are run, from Python; None for that of the training."""

    def __post_init__(self) -> None:
        if self.worlds < 0:
            raise TrainerError("there must be at least one world", found=f"--worlds {self.worlds}")
        if self.worlds:
            self.ppo.check_samples(self.worlds)


@dataclass(frozen=True)
class TrainResult:
    """The result of a training."""

    policy: Path
    """The .pt file."""
    onnx: Path | None
    """The same for a robot; None where the trainer makes none."""
    robot: str
    iterations: int
    """Iterations done in all."""
    to_target: int | None
    """Iterations done at the first evaluation that reached the target (97 percent); None if none did."""
    evaluations: tuple[tuple[int, float], ...]
    """(iterations done, success rate) on the way."""
    worlds: int
    """Simulated robots on each rank that were used."""
    seconds: float
    warnings: tuple[str, ...] = ()
    ours: bool = True
    """Whether `policy` is a checkpoint that `realsim evaluate` reads."""


class Trainer(Protocol):
    """A learner. Found by the name of its entry point in the group `realsim.trainers`."""

    def __call__(self, scene: Scene, policy: Path | None, config: TrainConfig, out: Path) -> TrainResult:
        """Train on a scene.

        Args:
            scene: where.
            policy: a checkpoint (.pt) to fine-tune; None trains from scratch.
            config: how.
            out: folder for everything that is written.

        Raises:
            RealsimError: what a person can mend.
        """
