"""Mass, shape and load of bodies."""

from dataclasses import replace

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import EVER, NEAR, SPECK, Pulse, add_point_mass
from realsim.gap.effects.base import (
    EXACT,
    Distinction,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    When,
    Where,
    Words,
    always,
    heavy_bodies,
    relative,
)
from realsim.gap.effects.sizes import size_of_force, size_of_inertia, size_of_mass

REACH = 0.2
"""A tool may hang so far from the body that carries it, m, however small that body is."""
SHARE = 0.3
"""Of the robot's mass: what a light flange may carry at least."""


def _parameters_payload(context: Context, place: Place) -> tuple[Parameter, ...]:
    body = context.case.model.body(place[0])
    mass, total = float(body.mass[0]), context.moved_mass(place[0])
    reach = max(1.3 * context.reach(place[0]), REACH)
    most = max(3 * total, 3 * mass, SHARE * context.total_mass)
    step = max(0.15 * mass, 0.05 * total)
    where = [
        Parameter(
            axis,
            "m",
            (float(c) - reach, float(c) + reach),
            0.05,
            default=float(c),
            shape=True,
            like=("com_offset", axis),
        )
        for axis, c in zip("xyz", body.ipos, strict=True)
    ]
    size = size_of_mass(context, place)
    return (Parameter("mass", "kg", (-0.7 * mass, most), step, nuisance=0.012 * mass, plausible=size), *where)


def _apply_payload(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A point mass at (x, y, z) in the body's frame; inertia about the new centre of mass (parallel axes)."""
    added = values["mass"]
    if added == 0:
        return
    where = np.array([values[a] for a in "xyz"])
    for name in place:
        body = edit.spec.body(name)
        edit.set_inertia(body, *add_point_mass(*edit.inertia_of(body), added, where))


def _suggests_payload(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The same mass on the links before and behind: near the joint between them, it does the same on either. And what
    it does to the link's own centre of mass: where one joint moves it, the two differ by what the mass weighs."""
    import mujoco

    model, data = context.case.model, mujoco.MjData(context.case.model)
    mujoco.mj_kinematics(model, data)
    here = model.body(place[0])
    at = [values.get(a, c) for a, c in zip("xyz", here.ipos, strict=True)]
    world = data.xpos[here.id] + data.xmat[here.id].reshape(3, 3) @ at
    shift = values["mass"] * (np.array(at) - here.ipos) / (float(here.mass[0]) + values["mass"])
    far, axes = int(np.argmax(np.abs(shift))), dict(zip("xyz", shift.tolist(), strict=True))
    own = [Suggestion("com_offset", place, axes), Suggestion("com_offset", place, {"xyz"[far]: axes["xyz"[far]]})]
    found = own if shift.any() else []
    for name in context.bodies:
        there = model.body(name)
        if there.id == int(here.parentid[0]) or here.id == int(there.parentid[0]):
            local = data.xmat[there.id].reshape(3, 3).T @ (world - data.xpos[there.id])
            moved = {"mass": values["mass"], **dict(zip("xyz", local.tolist(), strict=True))}
            found.append(Suggestion("payload", (name,), moved))
    return found


PAYLOAD = Effect(
    name="payload",
    where=Where("body", lambda context: [(name,) for name in context.bodies]),
    parameters=_parameters_payload,
    apply=_apply_payload,
    words=Words(
        settings=("the body's mass, or its randomisation", "randomize_rigid_body_mass", "the body's mass in the MJCF"),
        title="payload",
        description="A mass fixed to a body at a point (x, y, z in the body's frame).",
        signature="More sag in every pose that carries it, in the joints between it and the base; slower acceleration; "
        "more weight on the feet.",
        excitation=("gravity in several poses",),
        told_by=(Distinction("a constant force", "accelerations"),),
        changed_by="something that was mounted or removed",
        sort="thing",
        comparatives=("lighter", ""),
    ),
    excited_by=always("gravity and acceleration act on it"),
    variants=(("mass",), ("mass", "x", "y", "z")),  # the link's own, or something that sits elsewhere on it
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests_payload),
)


EVERYDAY = 0.02
"""Share of a small body's reach by which its centre of mass is usually off: a drone of 46 mm is not off by 1.5. Not
tuned."""


def _parameters_com_offset(context: Context, place: Place) -> tuple[Parameter, ...]:
    reach = context.reach(place[0])
    everyday = min(0.0015, EVERYDAY * reach)
    return tuple(Parameter(axis, "m", (-reach, reach), 0.02, nuisance=everyday) for axis in "xyz")


def _apply_com_offset(edit: Edit, place: Place, values: dict[str, float]) -> None:
    shift = np.array([values[a] for a in "xyz"])
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com + shift, inertia)


COM_OFFSET = Effect(
    name="com_offset",
    where=heavy_bodies(0.015),
    parameters=_parameters_com_offset,
    apply=_apply_com_offset,
    words=Words(
        settings=(
            "the body's com, or its randomisation",
            "randomize_rigid_body_com",
            "the body's inertial pos in the MJCF",
        ),
        title="centre of mass",
        description="The centre of mass of a body is shifted in the body's frame; mass and inertia stay.",
        signature="A torque that turns with the pose; on a floating base, weight moves from some feet to others.",
        excitation=("several poses under gravity",),
        changed_by="something that was moved",
        sort="direction",
    ),
    excited_by=always("gravity acts on it"),
    variants=(("x",), ("y",), ("z",), ("x", "y", "z")),
    law=Law(form=EXACT),
)


MOST, LEAST = 6.0, 0.3
"""Share by which it may be more, and by which it may be whatever the body's shape is: published ones of a Crazyflie
differ by 0.4."""


def _parameters_link_inertia(context: Context, place: Place) -> tuple[Parameter, ...]:
    """Up to all of its mass lying as far out as the body reaches, where the three sum to twice m r^2."""
    body = context.case.model.body(place[0])
    shell = 2 * float(body.mass[0]) * context.reach(place[0]) ** 2 / max(float(body.inertia.sum()), 1e-12)
    ratio = relative((-0.85, float(np.clip(shell - 1, LEAST, MOST))), 0.6, 0.03)
    return tuple(replace(p, plausible=size_of_inertia(context, place)) for p in ratio(context, place))


def _apply_link_inertia(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com, inertia * (1 + values["ratio"]))


LINK_INERTIA = Effect(
    name="link_inertia",
    where=heavy_bodies(0.015),
    parameters=_parameters_link_inertia,
    apply=_apply_link_inertia,
    words=Words(
        title="link inertia",
        description="The inertia tensor of a body is scaled; mass and centre of mass stay.",
        signature="Error in proportion to angular acceleration of that link, whatever joint turns it; none at rest.",
        excitation=("fast angular acceleration about several axes",),
        changed_by="a part that was exchanged",
    ),
    excited_by=always("angular acceleration shows it"),
    law=Law(form=EXACT),
    rivals=Rivals(commoner="armature"),  # a drawing tells a link's inertia, but not a rotor's
)


def _places_link_geometry(context: Context) -> list[Place]:
    return [(name,) for name in context.bodies if context.direction(name) is not None]


def _parameters_link_geometry(context: Context, place: Place) -> tuple[Parameter, ...]:
    reach = context.reach(place[0])
    return (Parameter("length", "m", (-0.4 * reach, 0.6 * reach), 0.1 * reach, nuisance=0.001),)


def _apply_link_geometry(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Everything at the far end (next bodies, feet) moves along the link; the link's own mass stays."""
    for name in place:
        direction = edit.context.direction(name)
        if direction is None:
            continue
        shift = values["length"] * direction
        body = edit.spec.body(name)
        children = [child for child in body.bodies if not child.name.endswith(SPECK)]
        for child in children:
            child.pos = np.asarray(child.pos) + shift
        if not children:
            for geom in body.geoms:
                if not np.isfinite(np.asarray(geom.fromto)).all():
                    geom.pos = np.asarray(geom.pos) + shift


LINK_GEOMETRY = Effect(
    name="link_geometry",
    where=Where("body", _places_link_geometry),
    parameters=_parameters_link_geometry,
    apply=_apply_link_geometry,
    words=Words(
        title="link geometry",
        description="A link's length differs along the direction to its far end.",
        signature="Feet and tool are elsewhere than the joint angles say; gravity torque of what it carries changes.",
        excitation=("feet on the ground with base pose, or a loaded link",),
        sort="direction",
    ),
    excited_by=always("gravity on what the link carries, or its feet on the ground"),
    law=Law(form=EXACT),
)


FOREVER = 1e6
PASSING = {
    "start": When("from {}", least=0.0),
    "end": When("to {}", most=1e3),
    "since": When(),
    "lasts": When("for {}", onset="since"),
}


def _parameters_external_force(context: Context, place: Place) -> tuple[Parameter, ...]:
    # On a robot that walks, forces that are small beside its own weight imitate what contacts do.
    least = (0.5 if context.case.floating else 0.05) * context.total_mass
    weight = 9.81 * max(context.moved_mass(place[0]), least)
    ends, size = (-6 * weight, 6 * weight), size_of_force(context, place)
    force = [Parameter(f"f{a}", "N", ends, 0.15 * weight, plausible=size) for a in "xyz"]
    return (
        *force,
        Parameter("start", "s", (-1.0, 60.0), 0.1, default=-1.0),
        Parameter("end", "s", (0.0, FOREVER), 0.1, default=FOREVER),
        Parameter("since", "s", (-NEAR, NEAR), 0.05, default=-NEAR),
        Parameter("lasts", "s", (0.0, FOREVER), 0.1, default=FOREVER),
    )


def _apply_external_force(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A force in world axes at the body's centre of mass, from `start` to `end` seconds of each run.

    One that `lasts` a while begins at each run's own onset instead, which may be off by `since`.
    """
    for name in place:
        actuator = edit.add_force(name, [values[f"f{a}"] for a in "xyz"])
        if values["lasts"] < EVER:
            pulse = Pulse(actuator, values["since"], values["since"] + values["lasts"], by_onset=True)
        else:
            pulse = Pulse(actuator, values["start"], values["end"])
        edit.signals.pulses.append(pulse)


EXTERNAL_FORCE = Effect(
    name="external_force",
    where=heavy_bodies(0.05),
    parameters=_parameters_external_force,
    apply=_apply_external_force,
    words=Words(
        title="external force",
        description="A force in world axes at a body's centre of mass (a cable, a tether, a hand): always, from one "
        "time to another of each run, or, as a push has it, at a time of its own in each run.",
        signature="An error with no command behind it, in one direction of the world whatever the pose; of a push, "
        "one that begins suddenly and dies away.",
        excitation=("several poses", "replicates of a force that passes"),
        told_by=(
            Distinction("a payload, if it is constant", "several poses"),
            Distinction("the command, if it passes", "replicates"),
        ),
        sort="direction",
    ),
    excited_by=always("any force shows"),
    variants=(("fx",), ("fy",), ("fz",), ("fx", "fy", "fz")),
    law=Law(passing=PASSING),
    rivals=Rivals(commoner="payload"),  # a mass that was left out is commoner than a hand or a tether
)
