"""Figures for the log, added up on the device and fetched once an interval."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.tasks.parkour.terminations import OUTCOMES

_FEW = 10
"""Diverged worlds in an interval that never stop a run: a share of a few worlds says nothing."""


class Tally:
    """Sums since the last report."""

    def __init__(self, terms: list[str], worlds: int, device: torch.device) -> None:
        self.terms, self.worlds = terms, worlds
        self._codes = torch.arange(len(OUTCOMES), device=device)
        self._rewards = torch.zeros(len(terms), device=device)
        self._outcomes = torch.zeros(len(OUTCOMES), device=device)
        self._covered = torch.zeros((), device=device)
        self._age = torch.zeros((), device=device)
        self.steps = 0
        self.diverged = 0
        """Worlds that diverged in all reports so far."""

    def add(self, rewards: Tensor, outcome: Tensor, covered: Tensor, seconds: Tensor) -> None:
        """One step: (terms,) mean rewards, and for all worlds (N,) outcome code, share covered and age."""
        self._rewards += rewards
        self._outcomes += (outcome[:, None] == self._codes).sum(0)
        ended = outcome > 0
        self._covered += (covered * ended).sum()
        self._age += (seconds * ended).sum()
        self.steps += 1

    def report(self, row: Tensor, overflowed: int, divergence_limit: float) -> dict[str, float]:
        """Means since the last report, which starts the sums anew. The one place that waits for the device.

        Always the same names, as ranks must agree on them: figures of episodes are not-a-number where none ended.

        Raises:
            TrainerError: more worlds diverged than `divergence_limit` of all world steps.
        """
        parts = [
            self._rewards / self.steps,
            self._outcomes,
            self._covered[None],
            self._age[None],
            row.float().mean()[None],
        ]
        values = torch.cat(parts).tolist()
        rewards, values = values[: len(self.terms)], values[len(self.terms) :]
        outcomes = dict(zip(OUTCOMES, values, strict=False))
        covered, seconds, level = values[len(OUTCOMES) :]
        diverged = outcomes["diverged"]
        self.diverged += int(diverged)
        if diverged > max(_FEW, divergence_limit * self.worlds * self.steps):
            raise TrainerError(
                "the simulation diverges too often",
                expected=f"at most {divergence_limit:.1%} of world steps",
                found=f"{int(diverged)} of {self.worlds * self.steps}",
                hint="a smaller physics timestep, or softer randomisation of gains and masses",
            )
        # Worlds that diverged say nothing about the policy.
        ended = sum(n for name, n in outcomes.items() if name not in ("running", "diverged"))
        log = {f"reward/{name}": value for name, value in zip(self.terms, rewards, strict=True)}
        log |= {"terrain/level": level, "physics/diverged": diverged, "physics/overflowed": float(overflowed)}
        log |= {
            f"end/{n}": _ratio(v, ended) for n, v in outcomes.items() if n not in ("running", "diverged", "success")
        }
        log |= {
            "success": _ratio(outcomes["success"], ended),
            "episode/covered": _ratio(covered, ended and ended + diverged),
            "episode/seconds": _ratio(seconds, ended and ended + diverged),
        }
        self.steps = 0
        for tensor in (self._rewards, self._outcomes, self._covered, self._age):
            tensor.zero_()
        return log


def _ratio(value: float, count: float) -> float:
    return value / count if count else math.nan
