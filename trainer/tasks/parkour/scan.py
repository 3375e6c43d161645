"""The critic's height scan: the terrain around the base, as no sensor of the robot sees it."""

import torch
from torch import Tensor

from trainer.physics import State
from trainer.rays import RayCaster, fall
from trainer.tasks.parkour.observations import SCAN
from trainer.tasks.rotations import heading_of

SPACING = 0.1
"""Metres between points."""
BEHIND = 0.4
"""Metres behind the base at which the grid begins."""
LARGEST = 0.5
"""Metres above or below the soles at which heights saturate."""


class HeightScan:
    """Heights of the terrain on a grid in the base's heading frame, by rays straight down."""

    def __init__(self, caster: RayCaster, standing_height: float, device: torch.device) -> None:
        ahead = torch.arange(SCAN[0], device=device) * SPACING - BEHIND
        left = (torch.arange(SCAN[1], device=device) - (SCAN[1] - 1) / 2) * SPACING
        self.points = torch.stack(torch.meshgrid(ahead, left, indexing="ij"), -1).reshape(-1, 2)
        """(S, 2) m, row by row from behind, each from right to left."""
        self.caster, self.standing_height = caster, standing_height

    def __call__(self, state: State, terrain_ids: Tensor) -> Tensor:
        """(N, S) m of the terrain over where the soles of a standing robot would be, within +-`LARGEST`."""
        c, s = heading_of(state.base_quat).unbind(-1)
        x, y = self.points.unbind(-1)
        level = torch.stack([c[:, None] * x - s[:, None] * y, s[:, None] * x + c[:, None] * y], -1)
        origins = torch.cat([level, torch.zeros_like(level[..., :1])], -1) + state.base_pos[:, None]
        below = fall(self.caster, origins, terrain_ids, self.standing_height + LARGEST)
        return (self.standing_height - below).clamp(-LARGEST, LARGEST)


def mirrored() -> tuple[int, ...]:
    """Index of the point that each point of the grid has for its image in the mirror."""
    rows, columns = SCAN
    return tuple(i * columns + (columns - 1 - j) for i in range(rows) for j in range(columns))
