"""Sizes that a robot like the model could have, by the model's own figures: beyond them a cause imitates another one.

Each function gives the largest plausible coordinate of a parameter at a place, and what that is in words.
"""

import numpy as np

from realsim.gap import figures
from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import Place

Size = tuple[float, str]


def size_of_rotor(context: Context, place: Place) -> Size:
    most = figures.ROTOR * max(context.inertia[j] for j in place)
    return most, f"{figures.ROTOR:g} times the inertia that the joint moves"


def size_of_force(context: Context, place: Place) -> Size:
    mass = context.total_mass if context.case.floating else max(map(context.moved_mass, place))
    return figures.WEIGHTS * 9.81 * mass, f"{figures.WEIGHTS:g} times the weight that it acts on"


def size_of_mass(context: Context, place: Place) -> Size:
    moved = max(map(context.moved_mass, place))
    most = max(figures.MASSES * moved, figures.CARRIED * context.total_mass)
    return most, f"{figures.MASSES:g} times what the body weighs with all that it carries"


def size_of_dry_friction(context: Context, place: Place) -> Size:
    most = figures.DRAG * max(context.torque_range[j] for j in place)
    return most, f"{figures.DRAG:.0%} of the largest torque of the drive"


def size_of_damping(context: Context, place: Place) -> Size:
    most = figures.DRAG * max(context.torque_range[j] / context.speed[j] for j in place)
    return most, f"{figures.DRAG:.0%} of the largest torque of the drive at the joint's highest speed"


def size_of_delay(context: Context, place: Place) -> Size:
    steps = [float(np.median(np.diff(run.time))) for run in context.case.runs]
    step = float(np.median(steps or [0.0]))  # where a patch is applied, there are no runs
    most = max(figures.PERIODS * step, figures.LATE)
    return most, f"{figures.PERIODS:g} periods of the log and {figures.LATE:g} s"


def size_of_inertia(context: Context, place: Place) -> Size:
    return figures.RATIO - 1, f"{figures.RATIO:g} times the model's"
