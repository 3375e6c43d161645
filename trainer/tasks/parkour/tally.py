"""Figures for the log, added up on the device and fetched once an interval."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.tasks.parkour.terminations import OUTCOMES

_FEW = 10
"""Diverged worlds in an interval that never stop a run: a share of a few worlds says nothing."""


class Tally:
    """Sums since the last report, of all worlds and of each family of terrain."""

    def __init__(self, terms: list[str], families: Sequence[str], worlds: int, device: torch.device) -> None:
        """`families`: of each terrain (T,)."""
        self.terms, self.worlds = terms, worlds
        self.families = sorted({f for f in families if f})
        index = {name: i for i, name in enumerate(self.families)}
        # What has no family is counted in a last row, which is not reported by itself.
        self.family = torch.tensor([index.get(f, len(index)) for f in families], device=device)
        """(T,) number of each terrain's family."""
        kinds = len(index) + 1
        self._codes = torch.arange(len(OUTCOMES), device=device)
        self._kinds = torch.arange(kinds, device=device)
        self._rewards = torch.zeros(len(terms), device=device)
        self._outcomes = torch.zeros(kinds, len(OUTCOMES), device=device)
        self._covered = torch.zeros(kinds, device=device)
        self._age = torch.zeros((), device=device)
        self._waiting = torch.zeros((), device=device)
        self._steps = torch.zeros((), device=device)
        self.diverged = 0
        """Worlds that diverged in all reports so far."""

    def add(
        self,
        rewards: Tensor,
        outcome: Tensor,
        covered: Tensor,
        seconds: Tensor,
        terrain_ids: Tensor,
        waiting: Tensor,
    ) -> None:
        """One step: (terms,) mean rewards, and for all worlds (N,) outcome code, share covered, age, terrain, and
        whether the robot waits though it is told to go."""
        self._rewards += rewards
        ended = (outcome > 0).float()
        kind = (self.family[terrain_ids][:, None] == self._kinds).float()
        self._outcomes += kind.T @ (outcome[:, None] == self._codes).float()
        self._covered += (covered * ended) @ kind
        self._age += (seconds * ended).sum()
        self._waiting += waiting.float().mean()
        self._steps += 1

    def report(
        self, row: Tensor, terrain_ids: Tensor, counters: Mapping[str, float], divergence_limit: float
    ) -> dict[str, float]:
        """Means since the last report, which starts the sums anew. The one place that waits for the device.

        Always the same names, as ranks must agree on them: figures of episodes are not-a-number where none ended.

        Args:
            row: (N,) of the curriculum.
            terrain_ids: (N,).
            counters: what else to report.

        Raises:
            TrainerError: more worlds diverged than `divergence_limit` of all world steps.
        """
        kind = (self.family[terrain_ids][:, None] == self._kinds).float()
        rows = (row.float() @ kind) / kind.sum(0)
        waiting = self._waiting / self._steps
        parts = [self._rewards / self._steps, torch.stack([self._age, row.float().mean(), self._steps, waiting])]
        values = torch.cat(parts).tolist()
        table = torch.cat([self._outcomes, self._covered[:, None], rows[:, None]], 1).tolist()
        rewards, (seconds, level, steps, waits) = values[: len(self.terms)], values[len(self.terms) :]
        sums = [sum(column) for column in zip(*table, strict=True)]
        outcomes = dict(zip(OUTCOMES, sums, strict=False))
        diverged = outcomes["diverged"]
        self.diverged += int(diverged)
        if diverged > max(_FEW, divergence_limit * self.worlds * steps):
            raise TrainerError(
                "the simulation diverges too often",
                expected=f"at most {divergence_limit:.1%} of world steps",
                found=f"{int(diverged)} of {int(self.worlds * steps)}",
                hint="a smaller physics timestep, or softer randomisation of gains and masses",
            )
        log = {f"reward/{name}": value for name, value in zip(self.terms, rewards, strict=True)}
        log |= {"terrain/level": level, "physics/diverged": diverged, **counters}
        log |= _ends(sums)
        ended = sum(sums[1 : len(OUTCOMES)])
        log |= {"episode/seconds": _ratio(seconds, ended), "episode/waiting": waits}
        for name, own in zip(self.families, table, strict=False):
            log |= {f"family/{name}/{key}": value for key, value in _ends(own).items() if key != "episode/covered"}
            count = sum(own[1 : len(OUTCOMES)])
            log[f"family/{name}/covered"] = _ratio(own[len(OUTCOMES)], count)
            log[f"family/{name}/row"] = own[len(OUTCOMES) + 1]
            log[f"family/{name}/episodes"] = count
        for tensor in (self._rewards, self._outcomes, self._covered, self._age, self._waiting, self._steps):
            tensor.zero_()
        return log


def _ends(sums: Sequence[float]) -> dict[str, float]:
    """Outcomes of episodes and the covered share, from sums by outcome and of the share covered."""
    outcomes = dict(zip(OUTCOMES, sums, strict=False))
    # Worlds that diverged say nothing about the policy.
    ended = sum(n for name, n in outcomes.items() if name not in ("running", "diverged"))
    names = [n for n in outcomes if n not in ("running", "diverged", "success")]
    return {
        **{f"end/{n}": _ratio(outcomes[n], ended) for n in names},
        "success": _ratio(outcomes["success"], ended),
        "episode/covered": _ratio(sums[len(OUTCOMES)], ended + outcomes["diverged"] if ended else 0),
    }


def _ratio(value: float, count: float) -> float:
    return value / count if count else math.nan
