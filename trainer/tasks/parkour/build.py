"""An environment from names: robot, engine, ray caster, terrains."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from realsim.core.progress import note
from trainer.errors import TrainerError
from trainer.physics import ENGINES, PhysicsConfig
from trainer.rays import CASTERS
from trainer.robots import TrainedRobot, named
from trainer.tasks.parkour.config import DepthConfig, ParkourConfig
from trainer.tasks.parkour.env import ParkourEnv
from trainer.tasks.parkour.gap import load as load_gap
from trainer.tasks.parkour.gap import patched
from trainer.tasks.parkour.randomise import Known, hull, informed, limited, sizes
from trainer.terrain import Terrain
from trainer.terrain.changed import scaled, shifted

_LENGTH_M = (0.5, 60.0)
"""Metres between start and goal that are believable."""
_PLATFORM_M = (0.2, 100.0)
"""Edge lengths of platforms that are believable (practice ground is one large one)."""


def make(
    config: ParkourConfig,
    terrains: Sequence[Terrain],
    *,
    robot: str | TrainedRobot = "g1",
    worlds: int = 256,
    engine: str = "mujoco",
    caster: str | None = None,
    physics: PhysicsConfig | None = None,
    rows: int = 1,
    diagnosis: str | Path | None = None,
    seed: int = 0,
    graphs: bool = False,
) -> ParkourEnv:
    """A parkour environment.

    Args:
        terrains: courses; with `rows` > 1 a curriculum grid, row by row (`trainer.terrain.grid`: 10 rows).
        robot: a name of `trainer.robots.ROBOTS`, or a robot.
        worlds: how many run at once.
        engine: a name of `trainer.physics.ENGINES`.
        caster: a name of `trainer.rays.CASTERS`; None takes `warp` on a GPU and `embree` on the CPU.
        physics: how the engine steps, and the device.
        diagnosis: `diagnosis.json` of `realsim diagnose`, or its folder: its figures replace guessed ranges, and what
            no range can hold goes into the robot's model (`trainer.tasks.parkour.gap`).
        seed: of all draws.
        graphs: on a GPU, make steps CUDA graphs: what a `Step` holds is then overwritten by the next.

    Raises:
        TrainerError: a terrain that cannot be a course, no such device, a diagnosis of another robot.
        UnknownNameError: no such robot, engine or caster.
    """
    body = named(robot) if isinstance(robot, str) else robot
    settings = physics or PhysicsConfig(seed=seed)
    settings = replace(settings, self_collision=settings.self_collision or config.self_collision)
    check_device(settings.device)
    if worlds < 1:
        raise TrainerError("there must be at least one world", found=str(worlds))
    for terrain in terrains:
        check(terrain)
    known = Known() if diagnosis is None else limited(load_gap(diagnosis, body), settings)
    body = patched(body, known)
    terrains, missing = shifted(terrains, known.heights)
    known = replace(known, unused=(*known.unused, *(f"terrain_height (no {place} here)" for place in missing)))
    for effect in known.unused:
        note(f"{diagnosis}: {effect} is not simulated by this task")
    config = with_known(config, known, settings)
    scales = sizes(terrains, informed(config.randomisation, known))
    everything = [scaled(t, ratio) for t in terrains for ratio in scales]
    rays = CASTERS[caster or ("warp" if settings.device.startswith("cuda") else "embree")](everything, settings.device)
    return ParkourEnv(
        ENGINES[engine](body, everything, worlds, settings),
        rays,
        _edges(terrains, scales),
        config,
        rows=rows,
        variants=len(scales),
        known=known,
        seed=seed,
        graphs=graphs,
    )


def check(terrain: Terrain) -> None:
    """Refuse what cannot be a course: no platforms, a wrong scale, a goal that is not in front.

    Raises:
        TrainerError: what is wrong, and what was expected.
    """
    figures = np.concatenate([terrain.start.centre, terrain.goal.centre, terrain.start.size, terrain.goal.size])
    if not np.isfinite(figures).all():
        raise TrainerError(f"{terrain.name}: a platform is not finite")
    low, high = _PLATFORM_M
    for role, platform in (("start", terrain.start), ("goal", terrain.goal)):
        if not ((platform.size >= low) & (platform.size <= high)).all():
            raise TrainerError(
                f"{terrain.name}: the {role} platform's size cannot be right; is the scale wrong?",
                expected=f"edges of {low} to {high} m",
                found=" x ".join(f"{s:.3f}" for s in platform.size) + " m",
            )
    away = float(np.linalg.norm((terrain.goal.centre - terrain.start.centre)[:2]))
    if not _LENGTH_M[0] <= away <= _LENGTH_M[1]:
        raise TrainerError(
            f"{terrain.name}: start and goal are too close or too far apart; is the scale wrong?",
            expected=f"{_LENGTH_M[0]} to {_LENGTH_M[1]} m",
            found=f"{away:.3f} m",
        )


def check_device(device: str) -> None:
    """Refuse a device that this machine does not have."""
    if not device.startswith("cuda"):
        return
    if (torch.device(device).index or 0) >= torch.cuda.device_count():
        raise TrainerError(
            "there is no such CUDA device",
            expected=device,
            found=f"torch {torch.__version__} sees {torch.cuda.device_count()} of them",
            hint='train on the CPU: device "cpu" with the engine "mujoco"',
        )


def with_known(config: ParkourConfig, known: Known, settings: PhysicsConfig) -> ParkourConfig:
    """The config with what a diagnosis says about the camera."""
    depth: DepthConfig = config.depth
    latency, noise = hull(known, "depth_latency"), hull(known, "depth_noise")
    if latency is not None:
        step = settings.timestep * settings.decimation
        low, high = (max(0, round(t / step)) for t in latency)
        depth = replace(depth, latency=(low, max(low, high)))
    if noise is not None:
        depth = replace(depth, noise=depth.noise * sum(noise) / 2)
    if known.mount is not None:  # the robot's camera stands where it was found; what is left is how well that is known
        half = [(high - low) / 2 for low, high in known.mount]
        depth = replace(depth, mount_rotation=max(half[:3]), mount_position=max(half[3:]))
    return replace(config, depth=depth)


def _edges(terrains: Sequence[Terrain], scales: list[float]) -> list[np.ndarray]:
    from trainer.terrain.edges import feature_edges

    return [edges * ratio for edges in map(feature_edges, terrains) for ratio in scales]
