"""States that the parts of a replay begin in, as free parameters of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.model.edit import Edit
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.anchors import SMALL
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.state import Anchor, Start


def free_starts(simulator: Simulator, comparison: Comparison) -> None:
    """Let a comparison fit the states that the log gave, which noise is in, of every part of a run."""
    parted = any(start.anchors for start in simulator.starts)
    runs = [i for i, start in enumerate(simulator.starts) if parted and start.moving]
    for i, columns in zip(runs, _slopes(simulator, runs), strict=True):
        parts = np.searchsorted([a.time for a in simulator.starts[i].anchors], comparison.times[i], side="right")
        comparison.free_starts(i, columns, parts)


def _slopes(simulator: Simulator, runs: Sequence[int]) -> list[F64]:
    """(T, C, K) a run: change of what is read by one unit of each position and speed that its parts begin with."""
    if not runs:
        return []
    model, starts = simulator.case.model, [simulator.starts[i] for i in runs]
    edit, base = Edit(simulator.context), simulator.simulate(runs=runs)
    columns: list[list[F64]] = [[] for _ in runs]
    for dof in range(2 * model.nv):
        moved = [_aside(model, start, dof) for start in starts]
        raw = simulator.roll_out(edit, list(runs), starts=moved)
        for k, (i, r) in enumerate(zip(runs, raw, strict=True)):
            columns[k].append((simulator.read(simulator.case.runs[i], r, edit) - base[k]) / SMALL)
    return [np.stack(c, axis=2) for c in columns]


def _aside(model: Any, start: Start, dof: int) -> Start:
    """All parts begun a little aside in one position, or from nv on one speed."""
    import mujoco

    step = np.zeros(2 * model.nv)
    step[dof] = SMALL

    def moved(qpos: F64, qvel: F64) -> tuple[F64, F64]:
        there = qpos.copy()
        mujoco.mj_integratePos(model, there, step[: model.nv], 1.0)
        return there, qvel + step[model.nv :]

    anchors = tuple(Anchor(a.time, *moved(a.qpos, a.qvel)) for a in start.anchors)
    if start.qpos is None or start.qvel is None:
        return replace(start, anchors=anchors)
    qpos, qvel = moved(start.qpos, start.qvel)
    return replace(start, qpos=qpos, qvel=qvel, anchors=anchors)
