"""Rays on the CPU: Open3D's RaycastingScene (Embree), one scene a terrain."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trainer.rays.base import ground_distance
from trainer.terrain import Terrain


class Caster:
    """See `trainer.rays.base.RayCaster`. Rays of all worlds on a terrain are cast together."""

    def __init__(self, terrains: Sequence[Terrain], device: str = "cpu") -> None:
        self.terrains = terrains
        self._device = torch.device(device)
        self._scenes: dict[int, Any] = {}
        self._floor = torch.tensor([t.floor_z for t in terrains], dtype=torch.float32)

    def cast(self, origins: Tensor, directions: Tensor, terrain_ids: Tensor, far: float) -> Tensor:
        """See `RayCaster.cast`."""
        rays = torch.cat([origins, directions], dim=-1).to("cpu", torch.float32)
        terrain_ids = terrain_ids.cpu()
        hit = ground_distance(rays[..., :3], rays[..., 3:], self._floor[terrain_ids][:, None])
        flat, distance = rays.numpy(), hit.numpy()
        for index in np.unique(terrain_ids):
            scene = self._scene(int(index))
            if scene is not None:  # bare ground needs no Open3D
                from realsim.core.open3d import o3d

                rows = np.flatnonzero(terrain_ids.numpy() == index)
                found = scene.cast_rays(o3d.core.Tensor.from_numpy(np.ascontiguousarray(flat[rows])))["t_hit"].numpy()
                distance[rows] = np.minimum(distance[rows], found)
        return torch.from_numpy(np.minimum(distance, np.float32(far))).to(self._device)

    def _scene(self, index: int) -> Any:
        """Made when a world first asks for that terrain; None for bare ground."""
        terrain = self.terrains[index]
        if not len(terrain.triangles):
            return None
        if index not in self._scenes:
            from realsim.core.open3d import o3d

            scene = o3d.t.geometry.RaycastingScene()
            scene.add_triangles(
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(terrain.vertices, np.float32)),
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(terrain.triangles, np.uint32)),
            )
            self._scenes[index] = scene
        return self._scenes[index]
