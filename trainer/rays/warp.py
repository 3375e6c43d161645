"""Rays in a Warp kernel: one `wp.Mesh` a terrain, the ground plane by formula, nothing leaves the device."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp
from torch import Tensor

from trainer.terrain import Terrain

wp.config.log_level = wp.LOG_WARNING  # not a line for every kernel that is loaded


@wp.kernel
def _cast(
    meshes: wp.array(dtype=wp.uint64),  # 0 for bare ground
    floors: wp.array(dtype=float),
    terrains: wp.array(dtype=wp.int64),
    origins: wp.array2d(dtype=wp.vec3),
    directions: wp.array2d(dtype=wp.vec3),
    far: float,
    distances: wp.array2d(dtype=float),
):
    world, ray = wp.tid()
    terrain = int(terrains[world])
    origin = origins[world, ray]
    direction = directions[world, ray]
    nearest = far
    above = origin[2] - floors[terrain]
    if direction[2] < 0.0 and above >= 0.0:
        nearest = wp.min(nearest, -above / direction[2])
    if meshes[terrain] != wp.uint64(0):
        hit = wp.mesh_query_ray(meshes[terrain], origin, direction, nearest)
        if hit.result:
            nearest = hit.t
    distances[world, ray] = nearest


class Caster:
    """See `trainer.rays.base.RayCaster`. Launches on torch's stream, so that a CUDA graph can hold it."""

    def __init__(self, terrains: Sequence[Terrain], device: str = "cuda") -> None:
        self.terrains = terrains
        wp.init()
        self._device = wp.get_device(device)
        self._torch = wp.device_to_torch(self._device)
        with wp.ScopedDevice(self._device):
            self._meshes = [_mesh(t) if len(t.triangles) else None for t in terrains]
            ids = np.array([m.id if m else 0 for m in self._meshes], np.uint64)
            self._ids = wp.array(ids, dtype=wp.uint64)
            self._floors = wp.array(np.array([t.floor_z for t in terrains], np.float32), dtype=float)

    def cast(self, origins: Tensor, directions: Tensor, terrain_ids: Tensor, far: float) -> Tensor:
        """See `RayCaster.cast`."""
        distances = torch.empty(origins.shape[:2], dtype=torch.float32, device=self._torch)
        stream = wp.stream_from_torch(torch.cuda.current_stream(self._torch)) if self._device.is_cuda else None
        wp.launch(
            _cast,
            dim=tuple(distances.shape),
            inputs=[
                self._ids,
                self._floors,
                wp.from_torch(terrain_ids.long().contiguous()),
                wp.from_torch(origins.float().contiguous(), dtype=wp.vec3),
                wp.from_torch(directions.float().contiguous(), dtype=wp.vec3),
                float(far),
            ],
            outputs=[wp.from_torch(distances)],
            device=self._device,
            stream=stream,
        )
        return distances


class HostCaster(Caster):
    """Rays on the GPU of worlds whose state is on the CPU."""

    def __init__(self, terrains: Sequence[Terrain], device: str = "cpu") -> None:
        super().__init__(terrains, "cuda")

    def cast(self, origins: Tensor, directions: Tensor, terrain_ids: Tensor, far: float) -> Tensor:
        """See `RayCaster.cast`."""
        there = (x.to(self._torch) for x in (origins, directions, terrain_ids))
        return super().cast(*there, far).to(origins.device)


def _mesh(terrain: Terrain) -> wp.Mesh:
    points = wp.array(np.ascontiguousarray(terrain.vertices, np.float32), dtype=wp.vec3)
    return wp.Mesh(points, wp.array(np.ascontiguousarray(terrain.triangles, np.int32).ravel(), dtype=int))
