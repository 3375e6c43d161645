"""A floor that is raised under the course at first, and sinks to the real one (`FloorConfig`)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from trainer.tasks.parkour.config import FloorConfig
from trainer.tasks.parkour.draw import rand
from trainer.terrain import Terrain

_LOW = 0.005
"""Metres above the real floor below which a raised floor is none."""


class RaisedFloor:
    """At what height the ground collides, in each world and episode."""

    def __init__(self, config: FloorConfig, terrains: Sequence[Terrain], worlds: int, device: torch.device) -> None:
        self.config = config
        self.real = torch.tensor([t.floor_z for t in terrains], dtype=torch.float32, device=device)
        """(T,) m."""
        self.difficulty = torch.tensor([t.difficulty for t in terrains], dtype=torch.float32, device=device)
        self.fails = torch.tensor([t.ground_fails for t in terrains], device=device)
        self.height = torch.zeros(worlds, device=device)
        """(N,) m, where the ground collides."""
        self.raised = torch.zeros(worlds, dtype=torch.bool, device=device)
        self.touched = torch.zeros(worlds, dtype=torch.bool, device=device)
        """(N,) whether a raised floor was touched in this episode."""

    def reset(self, ids: Tensor, terrain: Tensor, seconds: float | Tensor, generator: torch.Generator) -> Tensor:
        """(K,) heights for new episodes of worlds `ids` on terrains (K,), `seconds` of simulation into the training."""
        self.touched.index_fill_(0, ids, False)
        real = self.real[terrain]
        if self.config.share > 0:
            chosen = rand((len(ids),), generator) < self.config.share
            top = torch.full_like(real, -self.config.top)
            height = torch.lerp(top, real, self._sunk(terrain, seconds))
            raised = chosen & self.fails[terrain] & (height > real + _LOW)
        else:
            height, raised = real, torch.zeros_like(real, dtype=torch.bool)
        self.raised[ids] = raised
        self.height[ids] = torch.where(raised, height, real)
        return self.height[ids]

    def touch(self, ground_contact: Tensor) -> Tensor:
        """(N,) whether a raised floor is touched at this step; remembered for the episode."""
        now = ground_contact & self.raised
        self.touched |= now
        return now

    def _sunk(self, terrain: Tensor, seconds: float | Tensor) -> Tensor:
        """(K,) share of the way down to the real floor."""
        c = self.config
        share = self.difficulty[terrain] / c.difficulty if c.difficulty > 0 else torch.zeros_like(self.real[terrain])
        return (share if c.seconds <= 0 else share.clamp_min(seconds / c.seconds)).clamp_max(1.0)
