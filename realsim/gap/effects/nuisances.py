"""Small deviations that every robot has and that are no gap: what they look like and how large they usually are.

Beside the effects' own `nuisance` sizes (a per cent of mass, a few per cent of friction), these belong to the sensors.
They have the form of effects so that the same code finds their sensitivities, but they are never a cause.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from realsim.gap import figures
from realsim.gap.case.model.edit import Edit
from realsim.gap.effects.base import Effect, Parameter, Place, Where, Words, fixed
from realsim.gap.effects.drives import thrusters

if TYPE_CHECKING:
    from realsim.gap.case.model.context import Context

    Parameters = Callable[[Context, Place], tuple[Parameter, ...]]

NEARLY = 0.3
"""Standard deviation about either on the others: a log comes from a robot or from a simulator of the same step."""


def _base_parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    shift = [Parameter(a, "m", (-0.05, 0.05), 0.01, nuisance=0.003) for a in "xyz"]
    turn = [Parameter(f"r{a}", "rad", (-0.1, 0.1), 0.01, nuisance=0.003) for a in "xyz"]
    return (*shift, *turn)


def _base_apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    edit.signals.base_bias = (values["x"], values["y"], values["z"])
    edit.signals.base_turn = (values["rx"], values["ry"], values["rz"])


def _torque_parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    """A current times a constant has an unknown gain; a measured torque is good to a few per cent."""
    size = 0.25 if context.case.torque_kind == "current_times_constant" else 0.02
    return (Parameter("gain", "ratio", (-0.9, 3.0), 0.1, nuisance=size),)


def _sets(field: str, name: str) -> Callable[[Edit, Place, dict[str, float]], None]:
    """Writes a parameter's value to a field of the simulator's signals; of joints, to that of each."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        if place:
            getattr(edit.signals, field).update(dict.fromkeys(place, values[name]))
        else:
            setattr(edit.signals, field, values[name])

    return apply


def _solver_apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """`creep`: logarithm of the ratio on impratio. `cone`: the other of MuJoCo's two friction cones."""
    import mujoco

    option = edit.spec.option
    option.impratio = float(option.impratio * np.exp(values["creep"]))
    if values["cone"] > 0.5:
        elliptic = int(option.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
        option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL if elliptic else mujoco.mjtCone.mjCONE_ELLIPTIC


def _sticking_apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """0: as in the model. 1: as stiff as the time step bears."""
    for joint in edit.context.driven:
        edit.stiffen_friction(joint, values["stick"])


def _step_parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    """The robot lives in continuous time: 1 is the limit of ever finer steps."""
    many = len(context.driven) >= figures.MANY_JOINTS
    size, usual = (1.0, 0.0) if many else (NEARLY, 1.0)
    return (Parameter("finer", "ratio", (0.0, 0.5), 0.5, nuisance=size, usual=usual, fine=True),)


def _step_apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """An implicit step of dt lends each servo a rotor inertia of about dt kd / 2; on all joints at once, that shows."""
    edit.spec.option.timestep *= 1.0 - values["finer"]


def _drag_places(context: Context) -> list[Place]:
    """Rotors: what pushes along an axis and turns about it."""
    model = context.case.model
    return [(name,) for name in thrusters(context) if model.actuator(name).gear[3:].any()]


def _drag_apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        actuator = edit.spec.actuator(name)
        actuator.gear = actuator.gear * np.repeat([1.0, 1.0 + values["drag"]], 3)


_PHASE = fixed(Parameter("phase", "ratio", (-2.0, 2.0), 0.5, nuisance=0.5))
"""A robot reads its sensors before it commands, or after."""


def _where(holds: Callable[[Context], bool]) -> Where:
    """The whole robot, if it has what the nuisance is about."""
    return Where("sensor", lambda context: [()] if holds(context) else [])


def _make(
    name: str,
    where: Where,
    parameters: Parameters,
    apply: Callable[[Edit, Place, dict[str, float]], None],
    description: str,
) -> Effect:
    return Effect(name, where, parameters, apply, Words(description=description), patchable=False)


_ALL = (
    _make(
        "base_bias",
        _where(lambda context: context.case.floating and context.case.has("base_pos")),
        _base_parameters,
        _base_apply,
        "Calibration of the motion capture.",
    ),
    _make(
        "torque_gain",
        Where("sensor", lambda context: [(j,) for j in context.driven] if context.case.has("joint_torque") else []),
        _torque_parameters,
        _sets("torque_gain", "gain"),
        "Gain of the torque estimate.",
    ),
    _make(
        "torque_phase",
        _where(lambda context: context.case.has("joint_torque")),
        _PHASE,
        _sets("torque_phase", "phase"),
        "When the torque is sampled, beside the command.",
    ),
    _make(
        "imu_delay",  # its own filter and bus make an IMU a little later than the encoders, or earlier
        _where(lambda context: bool(context.case.imu_site)),
        fixed(Parameter("delay", "s", (-0.02, 0.02), 0.002, nuisance=0.002)),
        _sets("imu_delay", "delay"),
        "When the IMU is sampled.",
    ),
    _make(
        "imu_phase",
        _where(lambda context: bool(context.case.imu_site)),
        _PHASE,
        _sets("imu_phase", "phase"),
        "When the acceleration is sampled, beside the command.",
    ),
    _make(
        "rotor_drag",  # of two Crazyflies in hover, the sum of it is off by 7 and 10 % of what all rotors have
        Where("sensor", _drag_places),
        fixed(Parameter("drag", "ratio", (-0.9, 2.0), 0.1, nuisance=0.2)),
        _drag_apply,
        "Torque of a rotor about its axis for its thrust: its drag, and how it is tilted.",
    ),
    _make(
        "friction_solver",  # MuJoCo's dry friction creeps at rest, by default with 20 ms; no gear's does
        _where(lambda context: any(context.friction(j) > 0 for j in context.driven)),
        fixed(Parameter("stick", "ratio", (0.0, 1.0), 1.0, nuisance=0.5)),
        _sticking_apply,
        "How the simulator solves dry friction in joints.",
    ),
    _make(
        "time_step",
        _where(lambda context: True),
        _step_parameters,
        _step_apply,
        "What the simulator's time step adds to the motion.",
    ),
    _make(
        "contact_solver",
        _where(lambda context: context.touches),
        # Soft contacts creep under a lasting side load, at a pace that is the solver's and not the ground's.
        fixed(
            Parameter("creep", "ratio", (-3.0, 4.0), -1.0, nuisance=1.0),
            Parameter("cone", "ratio", (0.0, 1.0), 1.0, nuisance=0.5, whole=True),
        ),
        _solver_apply,
        "How the simulator solves contacts.",
    ),
)
NUISANCES = {effect.name: effect for effect in _ALL}
