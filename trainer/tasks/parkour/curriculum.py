"""Which terrain a world gets next. In a grid, columns are kinds and rows difficulties: worlds move up and down their
column. Terrains without an order of difficulty may be drawn by how often they are failed instead."""

from typing import Any

import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.tasks.parkour.draw import rand, randint

DEMOTE = 0.5
"""An episode that ends with less than this share of the way covered moves its world one row down."""
KEPT = 0.998
"""Share of the counted episodes that a step keeps: those of the last 500 steps, ten simulated seconds, count. An
episode is about as long, so each of thirteen terrains is judged by some 300 trials of 4096 worlds. Not tuned."""


class Curriculum:
    """Rows of each world. Terrain index = row * columns + column, as `trainer.terrain.grid` orders them."""

    def __init__(
        self,
        terrains: int,
        rows: int,
        worlds: int,
        device: torch.device,
        generator: torch.Generator,
        by_failure: float = 0.0,
        keep_last: float = 0.0,
    ) -> None:
        """`by_failure`: share of new episodes whose terrain is drawn by how often it is failed, where there are several
        and `rows` is 1. `keep_last`: see `ResetConfig`."""
        if rows < 1 or terrains % rows:
            raise TrainerError(
                "the terrains do not fill the grid", expected=f"a multiple of {rows} rows", found=str(terrains)
            )
        self.rows, self.columns = rows, terrains // rows
        self.column = torch.arange(worlds, device=device) % self.columns
        self.keep_last = keep_last
        # The easy half first: the harder rows have to be earned. Who knows the course begins everywhere on its ladder.
        top = rows if keep_last else max(1, (rows + 1) // 2)
        self.row = randint(0, top, worlds, generator)
        self.by_failure = by_failure if rows == 1 and self.columns > 1 else 0.0
        self.tried = torch.ones(self.columns, device=device)
        """(columns,) trials that ended lately."""
        self.failed = torch.ones(self.columns, device=device)
        """(columns,) those of them that failed."""

    def count(self, tried: Tensor, success: Tensor) -> None:
        """A step: of all worlds, (N,) whether a trial ended, and whether it succeeded."""
        if not self.by_failure:
            return
        column = (self.column[:, None] == torch.arange(self.columns, device=self.column.device)).float()
        for total, now in ((self.tried, tried), (self.failed, tried & ~success)):
            total.mul_(KEPT).add_(now.float() @ column)

    def update(self, ids: Tensor, success: Tensor, covered: Tensor, generator: torch.Generator) -> None:
        """Move worlds `ids` (K,) after episodes that succeeded (K,) bool or covered a share (K,) of the way.

        Who masters the last row is sent to a random one, but for `keep_last`, so that no row is forgotten.
        """
        row = self.row[ids] + success.long() - ((covered < DEMOTE) & ~success).long()
        anywhere = randint(0, self.rows, len(ids), generator)
        if self.keep_last:
            stays = rand((len(ids),), generator) < self.keep_last
            anywhere = torch.where(stays, torch.full_like(anywhere, self.rows - 1), anywhere)
        self.row[ids] = torch.where(row >= self.rows, anywhere, row.clamp_min(0))
        if self.by_failure:
            chance = self.chances().cumsum(0)
            drawn = torch.searchsorted(chance, rand((len(ids),), generator), right=True)
            self.column[ids] = drawn.clamp_max(self.columns - 1)

    def ease(self) -> None:
        """Every world goes back by one row."""
        self.row.sub_(1).clamp_(min=0)

    def chances(self) -> Tensor:
        """(columns,) with which a new episode gets each terrain: a share of them by how often it is failed, the others
        evenly, so that none is forgotten (prioritised level replay, Jiang et al., ICML 2021, draws by the error of the
        value function instead)."""
        failing = self.failed / self.tried.clamp_min(1e-9)
        share = failing / failing.sum().clamp_min(1e-9)
        chances = (1 - self.by_failure) / self.columns + self.by_failure * share
        return chances / chances.sum()  # where nothing fails, evenly

    def terrain(self, ids: Tensor) -> Tensor:
        """(K,) terrain index of worlds `ids`."""
        return self.row[ids] * self.columns + self.column[ids]

    def state_dict(self) -> dict[str, Any]:
        lately = {"tried": self.tried.clone(), "failed": self.failed.clone()} if self.by_failure else {}
        return {"row": self.row.clone(), "rows": self.rows, "columns": self.columns} | lately

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Rows of as many worlds as there are now; with another number each world takes one saved for its column."""
        if (state["rows"], state["columns"]) != (self.rows, self.columns):
            raise TrainerError(
                "the curriculum was saved on another grid of terrains",
                expected=f"{self.rows} x {self.columns}",
                found=f"{state['rows']} x {state['columns']}",
            )
        if self.by_failure and "failed" in state:
            self.tried.copy_(state["tried"])
            self.failed.copy_(state["failed"])
        saved = state["row"].to(self.row.device)
        if len(saved) == len(self.row):
            self.row.copy_(saved)
            return
        for column in range(min(self.columns, len(saved))):
            rows, worlds = saved[column :: self.columns], self.row[column :: self.columns]
            worlds.copy_(rows[torch.arange(len(worlds), device=rows.device) % len(rows)])
