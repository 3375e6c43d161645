"""What an effect is: where it acts, its parameters, what it does to a simulator, and how it is worded."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

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
"""`Law.form` of a law that holds to the last digit, but for how simulator and robot sample it."""


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
    plausible: tuple[float, str] = (math.inf, "")
    """Largest size of the coordinate that a robot like the model could have, and what that is (`effects.sizes`)."""
    label: str = ""
    """Its name in reports, if that is another."""
    note: str = ""
    """What a report adds to its value."""

    @property
    def logarithmic(self) -> bool:
        """Whether the coordinate is a ratio's logarithm."""
        return self.report is math.exp

    @property
    def strength(self) -> bool:
        """Whether at zero nothing is left of the effect; the others say when, where or how."""
        return self.default == 0.0 and not self.shape


@dataclass(frozen=True)
class Where:
    """The places at which an effect can act."""

    scope: Literal["joint", "body", "actuator", "terrain", "global", "sensor"]
    """What a place names: joints, bodies, actuators, static bodies that the robot touches, or nothing. `sensor`: of
    nuisances."""
    find: Callable[[Context], list[Place]]


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
class Distinction:
    """What distinguishes an effect from a rival."""

    rival: str
    record: str
    """What to record."""
    signals: tuple[str, ...] = ()
    """A log with any of these signals has it; none for a motion."""


@dataclass(frozen=True)
class Words:
    """How an effect is explained to a person. An effect without a title is called by its name."""

    title: str = ""
    description: str = ""
    signature: str = ""
    """Its appearance in a log."""
    excitation: tuple[str, ...] = ("any motion",)
    """What to record so that it shows, each a clause."""
    told_by: tuple[Distinction, ...] = ()
    changed_by: str = ""
    """What a change of it between two logs of one robot usually is. Not tested: what the logs name is the effect."""
    sort: Literal["amount", "thing", "direction"] = "amount"
    """More or less of something; a thing of its size (a torque limit of 3 N m); or something whose sign is a direction,
    so that it is missing either way and never too large in the model."""
    comparatives: tuple[str, str] = ("", "")
    """What the robot is than the model where the first parameter is negative and where it is positive."""
    settings: tuple[str, str, str] | None = None
    """What to change in mjlab, Isaac Lab and Unitree's deployment; None: what the patch of model.xml does."""
    ratio_of: str = ""
    """What its ratio is a share of, if not of the model's value."""


@dataclass(frozen=True)
class When:
    """A parameter that says when an effect acts, in the words of a sentence: `from {}`. Empty: it is not mentioned."""

    text: str = ""
    least: float = -math.inf
    most: float = math.inf
    """Values beyond mean that it acts always."""
    onset: str = ""
    """For a time after each run's own onset: the parameter by which that onset may be off."""


@dataclass(frozen=True)
class Law:
    """What the search has to know about how an effect acts."""

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
    passing: Mapping[str, When] = field(default_factory=dict)
    """Parameters that say when it acts; without them it acts always."""


@dataclass(frozen=True)
class Rivals:
    """Effects that may do the same."""

    suggest: Callable[[Context, Place, dict[str, float]], Sequence[Suggestion]] = lambda *_: ()
    """From values that were found at a place: what else may explain the same."""
    special_case: str | None = None
    """An effect that this law holds as a special case, and so always fits as well as."""
    commoner: str | None = None
    """A more common effect that may do the same."""
    compared: tuple[str, ...] = ()
    """Effects among those suggested that are compared with it on left-out runs whenever it is named: on a model that is
    not exact, a little of what it does beside them outweighs the evidence of noise alone."""


def any_motion(context: Context, place: Place) -> Excitation:
    """Every log shows it."""
    return Excitation(True, "any motion shows it")


def always(reason: str) -> Callable[[Context, Place], Excitation]:
    """Every log shows it, for this reason."""
    return lambda context, place: Excitation(True, reason)


@dataclass(frozen=True)
class Effect:
    """A way in which a robot can differ from its simulator. The first four fields say all that is needed."""

    name: str
    where: Where
    parameters: Callable[[Context, Place], tuple[Parameter, ...]]
    apply: Callable[[Edit, Place, dict[str, float]], None]
    """(edit, place, coordinates by parameter name) -> None; edits in place."""
    words: Words = Words()
    excited_by: Callable[[Context, Place], Excitation] = any_motion
    variants: tuple[tuple[str, ...], ...] = ((),)
    """Sets of parameters that are fitted together; the rest keep their defaults. () means all of them."""
    patchable: bool = True
    """Whether MJCF alone can express it (else the patch carries a wrapper)."""
    law: Law = Law()
    rivals: Rivals = Rivals()

    def __post_init__(self) -> None:
        """Whoever asks for parameters gets the user's sizes of everyday deviations, where the context has any."""
        own, name = self.parameters, self.name

        def parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
            return with_deviations(name, own(context, place), place, context.deviations)

        object.__setattr__(self, "parameters", parameters)

    @property
    def scope(self) -> str:
        """See Where."""
        return self.where.scope

    @property
    def title(self) -> str:
        """What reports call it."""
        return self.words.title or self.name.replace("_", " ")

    def places(self, context: Context) -> list[Place]:
        """Where it can act on this robot."""
        return self.where.find(context)


JOINTS = Where("joint", lambda context: [(name,) for name in context.driven])
"""Each driven joint."""
LOGGED = Where("joint", lambda context: [(name,) for name in (*context.driven, *context.passive)])
"""Each joint that is logged, also one that others, or tendons, move."""
EVERYWHERE = Where("global", lambda context: [()])
GROUND = Where("global", lambda context: [()] if context.touches else [])
"""Everywhere, if the robot touches anything."""
SUPPORTS = Where("terrain", lambda context: [(name,) for name in context.terrain])
"""Each static body that the robot touches."""


def heavy_bodies(share: float) -> Where:
    """Each body of at least this share of the robot's mass."""
    return Where("body", lambda context: [(name,) for name in context.heavy(share)])


def fixed(*parameters: Parameter) -> Callable[[Context, Place], tuple[Parameter, ...]]:
    """Parameters that are the same for every robot and place."""
    return lambda context, place: parameters


def gain(step: float, nuisance: float) -> Callable[[Context, Place], tuple[Parameter, ...]]:
    """A ratio whose coordinate is its logarithm: firmware's units make gains wrong by powers of ten, either way."""
    ends = (-math.log(FARTHEST), math.log(FARTHEST))
    return fixed(Parameter("ratio", "ratio", ends, step, nuisance=nuisance, report=math.exp))


def relative(
    bounds: tuple[float, float], step: float, nuisance: float
) -> Callable[[Context, Place], tuple[Parameter, ...]]:
    """A ratio whose coordinate is what it is more than 1."""
    return fixed(Parameter("ratio", "ratio", bounds, step, nuisance=nuisance, report=lambda z: 1 + z))


def on_the_ground(context: Context, place: Place) -> Excitation:
    """Whatever the robot touches shows it."""
    return Excitation(context.touches, "the robot stands on it" if context.touches else "nothing touches")


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
