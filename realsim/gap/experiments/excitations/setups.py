"""Excitations for which the robot is set up otherwise: drives off, other gains, a mass added."""

import numpy as np

from realsim.gap.case.setups import Setup
from realsim.gap.experiments.excitations.motions import sines, triangles
from realsim.gap.experiments.plan import Experiment, Rig

HELD, DROPPED = 1.2, 1.5
"""Seconds for which a posture is held, and for which the drives are off after it."""
SOFTER, STIFFER = 0.5, 2.0
"""Ratios on kp and kd."""
MASS = 0.25
"""Of what the outermost body's parent joint carries: the mass to add, at size 1."""


def torque_off(rig: Rig, size: float) -> Experiment | None:
    """Raise the arm, switch the drives off: what moves it then is gravity, friction and inertia, and no servo."""
    if rig.case.floating:
        return None
    t = rig.time
    cycle = HELD + DROPPED
    off = (np.mod(t, cycle) >= HELD) & (t < cycle * np.floor(t[-1] / cycle))
    enabled = np.repeat(~off[:, None], len(rig.home), axis=1)
    sides = np.where(np.arange(len(rig.home)) % 2, -1.0, 1.0)
    # Up within the first half of the hold; at home once the drives are off, so that they take over softly.
    up = np.sin(0.5 * np.pi * np.clip(np.mod(t, cycle) / (0.5 * HELD), 0, 1)) ** 2 * ~off
    up = up * np.where(np.floor(t / cycle) % 2, -1.0, 1.0)
    runs = []
    for i, sign in enumerate((1.0, -1.0)):
        shape = sign * up[:, None] * sides
        runs.append(rig.planned(f"torque_off_{i + 1}", shape, size, enabled=enabled))
    say = (
        "Switch the drives off while `enabled` is 0 in the command file, and on while it is 1. Nobody within reach.",
        "Log `enabled` with the run.",
    )
    return Experiment("torque_off", "a drop with the drives off", size, tuple(runs), say)


def two_gains(rig: Rig, size: float) -> Experiment | None:
    """The same motion with other firmware gains: what goes with a gain changes, what is in the mechanism does not."""
    case = rig.case
    model = case.model
    servos = [
        (name, -float(model.actuator(name).biasprm[1]), -float(model.actuator(name).biasprm[2]))
        for name in case.actuator_names
    ]
    if case.command_kind != "position" or not all(kp > 0 for _, kp, _ in servos):
        return None
    runs, say = [], []
    for i, (on_kp, on_kd) in enumerate(((SOFTER, SOFTER), (1.0, STIFFER))):
        gains: list[tuple[str, str, float]] = []
        for name, kp, kd in servos:
            if on_kp != 1:
                gains.append((name, "kp", on_kp * kp))
            if kd > 0:
                gains.append((name, "kd", on_kd * kd))
        if not gains:
            return None
        name = f"two_gains_{i + 1}"
        runs.append(rig.planned(name, sines(rig, 3), size, Setup(gains=tuple(gains))))
        listed = ", ".join(f"{n} {which} {value:.4g}" for n, which, value in gains)
        say.append(f"{name}: set the gains {listed} (the model's units); multiply the firmware's own in proportion.")
    return Experiment("two_gains", "the same motion with two sets of servo gains", size, tuple(runs), tuple(say))


def known_mass(rig: Rig, size: float) -> Experiment | None:
    """A mass that is known, at the end of the last link: gravity and inertia grow by what is known."""
    context, model = rig.context, rig.case.model
    if rig.case.floating or not context.bodies:
        return None
    body = max(context.bodies, key=lambda b: int(model.body(b).id))
    way = context.direction(body)
    at = np.asarray(model.body(body).ipos) if way is None else way * context.reach(body)
    mass = float(np.round(size * MASS * max(context.moved_mass(b) for b in context.bodies), 3))
    if mass < 0.01:
        return None
    place = (float(round(at[0], 3)), float(round(at[1], 3)), float(round(at[2], 3)))
    setup = Setup(payload=((body, mass, place),))
    runs = (
        rig.planned("known_mass_1", triangles(rig, 1.5 / rig.seconds), size, setup),
        rig.planned("known_mass_2", sines(rig, 4), size, setup),
    )
    where = ", ".join(f"{v:g}" for v in place)
    say = (f"Fix {mass:g} kg to {body}, its centre at ({where}) m in the body's frame; weigh it to 1 %.",)
    return Experiment("known_mass", "a known mass added", size, runs, say)
