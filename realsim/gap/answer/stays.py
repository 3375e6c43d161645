"""What the causes leave, in words: asked of the patched simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.answer.patch import apply_patch, make_patch
from realsim.gap.inference.causes.fitted import Fit
from realsim.gap.inference.causes.leftover import rests
from realsim.gap.inference.evidence.inverse import torque_residual
from realsim.gap.inference.evidence.rest import looks_like
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Simulator


def what_stays(simulator: Simulator, comparison: Comparison, fit: Fit, runs: Sequence[int]) -> list[dict[str, Any]]:
    """{joint, what, explains} of the joints with the largest rest; see `looks_like`.

    What only wrappers hold (delays, readings) is in the simulated positions and not in the torque that is asked for.
    """
    try:
        predicted = simulator.simulate(fit.settings(), runs=runs)
    except GapError:
        return []
    return _looked_at(
        simulator, comparison, fit, runs, [comparison.residual(r, y) for r, y in zip(runs, predicted, strict=True)]
    )


def laws_left(screen: Screen, fit: Fit) -> list[dict[str, Any]]:
    """The same of what stays in the fitted runs beside everyday deviations, too."""
    return _looked_at(screen.simulator, screen.comparison, fit, screen.runs, rests(screen, fit))


def _looked_at(
    simulator: Simulator, comparison: Comparison, fit: Fit, runs: Sequence[int], residuals: Sequence[F64]
) -> list[dict[str, Any]]:
    case = simulator.case
    try:
        spec = case.spec.copy()
        apply_patch(spec, make_patch(simulator, fit))
        with Simulator(replace(case, spec=spec, model=spec.compile()), simulator.config) as patched:
            tracks = [patched.nominal_tracks[r] for r in runs]
            return looks_like(comparison, runs, residuals, tracks, torque_residual(patched))
    except (
        GapError,
        ValueError,
    ):  # the patched model does not run on every run of the log: nothing is reported of its rest
        return []
