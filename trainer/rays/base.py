"""Rays against terrain meshes: depth images and the height under a point."""

from typing import Protocol

import torch
from torch import Tensor

from realsim.core.registry import Registry

CASTERS = Registry(
    "ray caster",
    {
        "embree": "trainer.rays.embree:Caster",
        "warp": "trainer.rays.warp:Caster",
        "warp_host": "trainer.rays.warp:HostCaster",
    },
)
"""name -> `(terrains, device) -> RayCaster`. `embree` is Open3D's RaycastingScene on the CPU; `warp_host` casts on the
GPU for an engine on the CPU."""


class RayCaster(Protocol):
    """One mesh a terrain plus the terrain's ground plane; each row of rays asks one terrain."""

    def cast(self, origins: Tensor, directions: Tensor, terrain_ids: Tensor, far: float) -> Tensor:
        """(N, R) metres along unit directions (N, R, 3) from origins (N, R, 3); `far` where nothing is hit."""


def ground_distance(origins: Tensor, directions: Tensor, floor_z: Tensor) -> Tensor:
    """(...,) metres from origins (..., 3) along unit directions (..., 3) down to the plane z = `floor_z` (broadcast);
    infinity for rays that start below it or never come down to it."""
    above, down = origins[..., 2] - floor_z, -directions[..., 2]
    reaches = (down > 0) & (above >= 0)
    return torch.where(reaches, above / torch.where(reaches, down, 1.0), torch.inf)


def fall(rays: RayCaster, points: Tensor, terrain_ids: Tensor, far: float) -> Tensor:
    """(N, R) metres from points (N, R, 3) straight down to the terrain; `far` where nothing is hit."""
    down = torch.zeros_like(points)
    down[..., 2] = -1.0
    return rays.cast(points, down, terrain_ids, far)
