"""Whether a cause has a size that a robot like the model could have: beyond it, a cause imitates another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from realsim.gap import figures
from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import Parameter
from realsim.gap.inference.causes.fitted import Cause


def implausible(context: Context, causes: Sequence[Cause]) -> list[str]:
    """One sentence for each value that is larger than the model's own figures make plausible."""
    found = []
    for cause in causes:
        for p, value in zip(cause.candidate.parameters, cause.values, strict=True):
            most, of_what = _most(context, cause, p)
            if abs(value) > most:
                name = f"{cause.candidate.effect} {', '.join(cause.candidate.place)}".strip()
                size = f"{p.name} {p.report(value):.3g} {p.unit}"
                found.append(f"{name}: {size} is more than {of_what}, so it imitates something")
    return found


def _most(context: Context, cause: Cause, p: Parameter) -> tuple[float, str]:
    """(largest plausible size of a parameter's coordinate, what that is in words); infinite where nothing says so."""
    if p.logarithmic:
        return float(np.log(figures.RATIO)), f"{figures.RATIO:g} times more or less than in the model"
    bound = _BOUNDS.get((cause.candidate.effect, p.name))
    return bound(context, cause) if bound else (np.inf, "")


def _rotor(context: Context, cause: Cause) -> tuple[float, str]:
    most = figures.ROTOR * max(context.inertia[j] for j in cause.candidate.place)
    return most, f"{figures.ROTOR:g} times the inertia that the joint moves"


def _force(context: Context, cause: Cause) -> tuple[float, str]:
    mass = context.total_mass if context.case.floating else max(map(context.moved_mass, cause.candidate.place))
    return figures.WEIGHTS * 9.81 * mass, f"{figures.WEIGHTS:g} times the weight that it acts on"


def _mass(context: Context, cause: Cause) -> tuple[float, str]:
    moved = max(map(context.moved_mass, cause.candidate.place))
    most = max(figures.MASSES * moved, figures.CARRIED * context.total_mass)
    return most, f"{figures.MASSES:g} times what the body weighs with all that it carries"


def _dry(context: Context, cause: Cause) -> tuple[float, str]:
    most = figures.DRAG * max(context.torque_range[j] for j in cause.candidate.place)
    return most, f"{figures.DRAG:.0%} of the largest torque of the drive"


def _viscous(context: Context, cause: Cause) -> tuple[float, str]:
    most = figures.DRAG * max(context.torque_range[j] / context.speed[j] for j in cause.candidate.place)
    return most, f"{figures.DRAG:.0%} of the largest torque of the drive at the joint's highest speed"


def _delay(context: Context, cause: Cause) -> tuple[float, str]:
    step = float(np.median([np.median(np.diff(run.time)) for run in context.case.runs]))
    most = max(figures.PERIODS * step, figures.LATE)
    return most, f"{figures.PERIODS:g} periods of the log and {figures.LATE:g} s"


def _inertia(context: Context, cause: Cause) -> tuple[float, str]:
    return figures.RATIO - 1, f"{figures.RATIO:g} times the model's"


_BOUNDS: dict[tuple[str, str], Callable[[Context, Cause], tuple[float, str]]] = {
    ("armature", "armature"): _rotor,
    ("payload", "mass"): _mass,
    ("coulomb_friction", "friction"): _dry,
    ("stribeck_friction", "static_friction"): _dry,
    ("viscous_friction", "damping"): _viscous,
    ("command_delay", "delay"): _delay,
    ("observation_delay", "delay"): _delay,
    ("link_inertia", "ratio"): _inertia,
    **{("external_force", f"f{axis}"): _force for axis in "xyz"},
}
"""(effect, parameter) -> (context, cause) -> (largest plausible coordinate, in words)."""
