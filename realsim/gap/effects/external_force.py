"""Something pulls or pushes that the model does not know."""

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import EVER, NEAR, Pulse
from realsim.gap.effects.base import (
    Distinction,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    When,
    Words,
    always,
    heavy_bodies,
)
from realsim.gap.effects.sizes import size_of_force

FOREVER = 1e6
PASSING = {
    "start": When("from {}", least=0.0),
    "end": When("to {}", most=1e3),
    "since": When(),
    "lasts": When("for {}", onset="since"),
}


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
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


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
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


EFFECT = Effect(
    name="external_force",
    where=heavy_bodies(0.05),
    parameters=_parameters,
    apply=_apply,
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
