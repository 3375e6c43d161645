"""What the causes leave, and what it looks like: one regressor a joint, where it explains enough of it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.answer.patch import apply_patch, make_patch
from realsim.gap.inference.causes.fitted import Fit, rests
from realsim.gap.inference.evidence.inverse import TorqueResidual, torque_residual
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Simulator


def what_stays(simulator: Simulator, comparison: Comparison, fit: Fit, runs: Sequence[int]) -> list[dict[str, Any]]:
    """{joint, what, explains} of the joints with the largest rest; see `looks_like`.

    What only wrappers hold (delays, readings) is in the simulated positions and not in the torque that is requested.
    """
    try:
        predicted = simulator.simulate(fit.settings(), runs, onsets=fit.conditions.onsets)
    except GapError:
        return []
    residuals = [comparison.residual(r, y) for r, y in zip(runs, predicted, strict=True)]
    return _looked_at(simulator, comparison, fit, runs, residuals)


def laws_left(screen: Screen, fit: Fit) -> list[dict[str, Any]]:
    """The same of what stays in the fitted runs beside everyday deviations, too."""
    return _looked_at(screen.simulator, screen.comparison, fit, screen.runs, rests(screen, fit))


def _looked_at(
    simulator: Simulator, comparison: Comparison, fit: Fit, runs: Sequence[int], residuals: Sequence[F64]
) -> list[dict[str, Any]]:
    case = simulator.case
    try:
        spec = case.spec.copy()
        apply_patch(spec, make_patch(simulator, fit.settings()))
        with Simulator(replace(case, spec=spec, model=spec.compile()), simulator.config) as patched:
            tracks = [patched.nominal_tracks[r] for r in runs]
            return looks_like(comparison, runs, residuals, tracks, torque_residual(patched))
    except (GapError, ValueError):  # the patched model does not run on every run: nothing is reported of its rest
        return []


LEAST_EXPLAINED = 0.3
"""Share of a joint's rest that a regressor must explain to be reported; as for torque residuals. Not tuned."""
MOST = 4
"""Joints that are reported, at most."""
_OF_TORQUE = {
    "against the velocity, of constant size": "friction-like",
    "in proportion to the velocity": "damping-like",
    "in proportion to the acceleration": "inertia-like",
    "in proportion to the torque": "gain-like",
    "constant": "a constant torque",
}
"""A term of the torque residual -> what a person calls it."""


def looks_like(
    comparison: Comparison,
    runs: Sequence[int],
    residuals: Sequence[F64],
    tracks: Sequence[dict[str, F64]],
    torque: TorqueResidual | None,
) -> list[dict[str, Any]]:
    """{joint, what, explains}, the joints with the largest rest first; empty where nothing simple explains enough.

    Where torques were logged, the torque that the patched model lacks is asked; else the error of position servos,
    which is a torque error over the servo's stiffness while the motion is slow.

    Args:
        residuals: (B, C) a run, of the patched simulator.
        tracks: of the patched simulator, one a run.
        torque: of the patched model, where torques were logged.
    """
    size = _by_joint(comparison, runs, residuals)
    if torque is not None:
        said = {
            j: (_OF_TORQUE[t["what"]], float(t["explains"]))
            for j, t in zip(torque.joints, torque.terms, strict=True)
            if t["what"] in _OF_TORQUE
        }
    elif comparison.case.command_kind == "position":
        # Below twice the floor there is nothing to speak of.
        looks = {j: _of_position(comparison, runs, residuals, tracks, j) for j in size if size[j] >= 2.0}
        said = {j: look for j, look in looks.items() if look is not None}
    else:
        said = {}
    order = sorted(said, key=lambda j: -size.get(j, 0.0))[:MOST]
    return [{"joint": j, "what": said[j][0], "explains": round(said[j][1], 2)} for j in order]


def _by_joint(comparison: Comparison, runs: Sequence[int], residuals: Sequence[F64]) -> dict[str, float]:
    """Joint -> mean square of its position's error in units of the floor."""
    found = {}
    for c, channel in enumerate(comparison.channels):
        if channel.signal == "joint_pos":
            ratios = [r[:, c] ** 2 / comparison.floor(i)[:, c] for i, r in zip(runs, residuals, strict=True)]
            found[channel.label] = float(np.nanmean(np.concatenate(ratios)))
    return found


def _of_position(
    comparison: Comparison,
    runs: Sequence[int],
    residuals: Sequence[F64],
    tracks: Sequence[dict[str, F64]],
    joint: str,
) -> tuple[str, float] | None:
    """(what, share explained) of the rest of a joint's position."""
    labels = [(c.signal, c.label) for c in comparison.channels]
    column, j = labels.index(("joint_pos", joint)), comparison.case.joint_names.index(joint)
    y, features = [], []
    for run, r, track in zip(runs, residuals, tracks, strict=True):
        at = comparison.rows_at(run, track)
        speed, load = track["vel"][at, j], track["torque"][at, j]
        way = np.tanh(speed / (0.05 * np.nanmax(np.abs(track["vel"][:, j])) + 1e-9))
        features.append(np.column_stack([way, speed, np.abs(load) * way, load, np.ones(len(at))]))
        y.append(r[:, column])
    values, X = np.concatenate(y), np.concatenate(features)
    good = np.isfinite(values) & np.isfinite(X).all(axis=1)
    values, X = values[good], X[good]
    total = float(values @ values)
    names = ("friction-like", "delay- or damping-like", "load-dependent friction", "gain-like", "an offset")
    shares = [float(values @ x) ** 2 / max(float(x @ x) * total, 1e-30) for x in X.T]
    best = int(np.argmax(shares))
    return (names[best], shares[best]) if shares[best] > LEAST_EXPLAINED else None
