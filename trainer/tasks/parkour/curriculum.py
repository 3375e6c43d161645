"""The grid of terrains: columns are kinds, rows are difficulties; worlds move up and down their column."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.tasks.parkour.draw import randint

DEMOTE = 0.5
"""An episode that ends with less than this share of the way covered moves its world one row down."""


class Curriculum:
    """Rows of each world. Terrain index = row * columns + column, as `trainer.terrain.grid` orders them."""

    def __init__(self, terrains: int, rows: int, worlds: int, device: torch.device, generator: torch.Generator) -> None:
        if rows < 1 or terrains % rows:
            raise TrainerError(
                "the terrains do not fill the grid", expected=f"a multiple of {rows} rows", found=str(terrains)
            )
        self.rows, self.columns = rows, terrains // rows
        self.column = torch.arange(worlds, device=device) % self.columns
        # The easy half first: the harder rows have to be earned.
        top = max(1, (rows + 1) // 2)
        self.row = randint(0, top, worlds, generator)

    def update(self, ids: Tensor, success: Tensor, covered: Tensor, generator: torch.Generator) -> None:
        """Move worlds `ids` (K,) after episodes that succeeded (K,) bool or covered a share (K,) of the way.

        Who masters the last row is sent to a random one, so that no row is forgotten.
        """
        row = self.row[ids] + success.long() - ((covered < DEMOTE) & ~success).long()
        anywhere = randint(0, self.rows, len(ids), generator)
        self.row[ids] = torch.where(row >= self.rows, anywhere, row.clamp_min(0))

    def terrain(self, ids: Tensor) -> Tensor:
        """(K,) terrain index of worlds `ids`."""
        return self.row[ids] * self.columns + self.column[ids]

    def state_dict(self) -> dict[str, Any]:
        return {"row": self.row.clone(), "rows": self.rows, "columns": self.columns}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Rows of as many worlds as there are now; with another number each world takes one saved for its column."""
        if (state["rows"], state["columns"]) != (self.rows, self.columns):
            raise TrainerError(
                "the curriculum was saved on another grid of terrains",
                expected=f"{self.rows} x {self.columns}",
                found=f"{state['rows']} x {state['columns']}",
            )
        saved = state["row"].to(self.row.device)
        if len(saved) == len(self.row):
            self.row.copy_(saved)
            return
        for column in range(min(self.columns, len(saved))):
            rows, worlds = saved[column :: self.columns], self.row[column :: self.columns]
            worlds.copy_(rows[torch.arange(len(worlds), device=rows.device) % len(rows)])
