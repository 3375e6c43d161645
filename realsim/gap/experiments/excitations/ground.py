"""Excitations of robots that stand on the ground."""

from dataclasses import replace

import numpy as np

from realsim.gap.case.model.context import kind_of
from realsim.gap.experiments.excitations.motions import sines
from realsim.gap.experiments.plan import Experiment, Rig

PUSH_HZ = 1.0
AWAY = 0.06
"""m by which the robot stands elsewhere."""


def push_and_slide(rig: Rig, size: float) -> Experiment | None:
    """Joints of one kind push all at once, to and fro: feet begin to slide where friction is less than believed."""
    context = rig.context
    if not context.touches:
        return None
    kinds = list(dict.fromkeys(kind_of(j) for j in context.driven))
    runs = []
    for i, kind in enumerate(kinds[:2]):
        shape = np.zeros((len(rig.time), len(rig.home)))
        wave = np.tanh(4 * np.sin(2 * np.pi * PUSH_HZ * rig.time))
        for joint, actuator in context.actuator.items():
            if kind_of(joint) == kind:
                shape[:, rig.case.actuator_names.index(actuator)] = wave
        runs.append(rig.planned(f"push_and_slide_{i + 1}", shape, size))
    return Experiment("push_and_slide", "pushing sideways until the feet slide", size, tuple(runs))


def step_elsewhere(rig: Rig, size: float) -> Experiment | None:
    """The same motion on other ground: what belongs to the ground changes, what belongs to the robot goes along."""
    if not rig.context.touches or not (rig.case.has("base_pos") or rig.case.runs[0].init_qpos is not None):
        return None
    shape = sines(rig, 5)
    places = ((AWAY, 0.0), (0.0, AWAY))
    runs = tuple(
        replace(rig.planned(f"step_elsewhere_{i + 1}", shape, size), shift=place) for i, place in enumerate(places)
    )
    say = tuple(
        f"{run.name}: begin with the robot {100 * run.shift[0]:g} cm further in x and {100 * run.shift[1]:g} cm in y "
        "(world axes of the log) than in the log's first run."
        for run in runs
    )
    return Experiment("step_elsewhere", "the same motion on another place", size, runs, say)
