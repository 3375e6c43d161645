"""Interface of effects: parameters, places, whether a log excites it, and how it changes a simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from realsim.gap.case.model.channels import channels
from realsim.gap.case.model.deviations import with_deviations
from realsim.gap.case.model.edit import Edit as Edit

if TYPE_CHECKING:
    from realsim.gap.case.model.context import Context

FARTHEST = 100.0
"""Ratio by which a gain may be off."""

Place = tuple[str, ...]
"""Names of joints or bodies; () for effects that act everywhere."""

EXACT = 0.015
"""`Effect.form` of a law that holds to the last digit, but for how simulator and robot sample it."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, in a coordinate where 0 is the nominal simulator.

    Fits run in this coordinate because effects are close to linear in it (a delay, 1/stiffness, a fraction of the
    peak torque); `report` turns it into the contract's unit.
    """

    name: str
    """Name in the contract's output."""
    unit: str
    bounds: tuple[float, float]
    """Of the coordinate."""
    step: float
    """A size worth calling a gap; sensitivities are secants over it."""
    nuisance: float = 0.0
    """Standard deviation of the unnamed deviations that every robot has; 0 if there are none of this kind."""
    report: Callable[[float], float] = float
    """Coordinate -> value in `unit` as the contract wants it."""
    default: float = 0.0
    """Value of the coordinate when the parameter is not fitted."""
    shape: bool = False
    """Whether zero, if that is where it begins, means nothing either: where on a body, not how much."""
    whole: bool = False
    """Only whole values can be simulated."""
    fine: bool = False
    """Its slope is taken at the model's own time step, however large the robot, and only the slope: more would cost."""
    usual: float = 0.0
    """Value beside zero that is as everyday; either may be the centre of the deviations."""
    none_left: bool = False
    """Whether at the lower bound nothing of its kind is left (no friction at all): a finding like any other."""
    like: tuple[str, str] | None = None
    """(effect, parameter) whose slope this one shares to first order, so that none is simulated for it."""

    @property
    def logarithmic(self) -> bool:
        """Whether the coordinate is a ratio's logarithm."""
        return self.report is math.exp

    @property
    def strength(self) -> bool:
        """Whether at zero nothing is left of the effect; the others say when, where or how."""
        return self.default == 0.0 and not self.shape


@dataclass(frozen=True)
class Excitation:
    """Whether a log can show the effect at a place, and why."""

    yes: bool
    reason: str


@dataclass(frozen=True)
class Suggestion:
    """What else may explain what an effect was found to do."""

    effect: str
    place: Place
    values: dict[str, float]
    """Coordinates by parameter name, from which a fit begins; of the same effect and place: another valley."""


@dataclass(frozen=True)
class Effect:
    """A way in which a robot can differ from its simulator."""

    name: str
    title: str
    scope: str
    """`joint`, `body`, `terrain` (static bodies that the robot touches) or `global`."""
    description: str
    signature: str
    """Its appearance in a log."""
    excitation: str
    """Content of a log that shows it."""
    places: Callable[[Context], list[Place]]
    parameters: Callable[[Context, Place], tuple[Parameter, ...]]
    excited_by: Callable[[Context, Place], Excitation]
    apply: Callable[[Edit, Place, dict[str, float]], None]
    """(edit, place, coordinates by parameter name) -> None; edits in place."""
    patchable: bool = True
    """Whether MJCF alone can express it (else the patch carries a wrapper)."""
    variants: tuple[tuple[str, ...], ...] = ((),)
    """Sets of parameters that are fitted together; the rest keep their defaults. () means all of them."""
    form: float = 0.04
    """Share of its own correction that the effect's simplified law may miss: less where the law is exact."""
    joint_figure: bool = False
    """Whether joints that share a value share one figure in its unit (of the highest torque or speed among them), and
    not one share of what each of them does."""
    stiff: bool = False
    """Whether its law needs the model's own time step."""
    abrupt: bool = False
    """Whether its slope foretells nothing: a foot slips or lands, a drive saturates, or not."""
    footing: tuple[str, ...] = ()
    """Parameters that move a robot's feet against the ground: which of them then touch it, no slope foretells."""
    stepwise: bool = False
    """Whether it acts on every step anew, so that its runs are stepped one by one."""
    plain: str | None = None
    """Another effect that this law holds as a special case, and so always fits as well as."""
    usual: str | None = None
    """A more usual effect that may do the same."""
    suggests: Callable[[Context, Place, dict[str, float]], Sequence[Suggestion]] = lambda *_: ()
    """From values that were found at a place: what else may explain the same."""
    passing: tuple[str, ...] = ()
    """Parameters that say when it acts; without them it acts always."""
    absolute: bool = False
    """Whether it is worded as a thing of its size (a torque limit of 3 N m) and not as more or less of something."""
    directed: bool = False
    """Whether its sign is a direction: then it is missing either way, and never too large in the model."""
    of_torque: bool = False
    """Whether its ratio is a share of the drive's torque."""
    comparatives: tuple[str, str] = ("", "")
    """What the robot is than the model where the first parameter is negative and where it is positive."""
    changed_by: str = ""
    """What a change of it between two logs of one robot usually is. Not tested: what the logs name is the effect."""
    taken_for: tuple[str, ...] = ()
    """Effects among those suggested that are held against it by left-out runs whenever it is named: on a model that is
    not exact, a little of what it does beside them outweighs the evidence of noise alone."""

    def __post_init__(self) -> None:
        """Whoever asks for parameters gets the user's sizes of everyday deviations, where the context has any."""
        own, name = self.parameters, self.name

        def parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
            return with_deviations(name, own(context, place), place, context.deviations)

        object.__setattr__(self, "parameters", parameters)


def gain(step: float, nuisance: float) -> Parameter:
    """A ratio whose coordinate is its logarithm: firmware's units make gains wrong by powers of ten, either way."""
    ends = (-math.log(FARTHEST), math.log(FARTHEST))
    return Parameter("ratio", "ratio", ends, step, nuisance=nuisance, report=math.exp)


def joint_signals_only(context: Context) -> bool:
    """Whether nothing but the joints' own signals is compared: then late commands and late readings are one thing.

    A robot that begins at rest knows no clock, so shifting its commands shifts every reading.
    """
    return all(channel.signal.startswith("joint_") for channel in channels(context.case))


def servo_damping(context: Context, place: Place) -> float:
    """N m s/rad with which the servos brake their joints, the mean over a place."""
    case = context.case
    found = [-(case.gear(j) ** 2) * float(case.model.actuator(context.actuator[j]).biasprm[2]) for j in place]
    return sum(found) / len(found)


def each_joint(context: Context) -> list[Place]:
    """One place a driven joint."""
    return [(name,) for name in context.driven]


def everywhere(context: Context) -> list[Place]:
    """The single place of a global effect."""
    return [()]


def nowhere(context: Context) -> list[Place]:
    """No place at all."""
    return []


def always(context: Context, place: Place) -> Excitation:
    return Excitation(True, "any motion shows it")
