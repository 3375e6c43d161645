"""The library of excitations: a function each, one line here.

An excitation takes a `Rig` and a size in 0..1 and returns an `Experiment`, or None where the robot cannot do it.
All last about the same time, so that they can be compared.
"""

from realsim.core.registry import Registry

EXCITATIONS = Registry(
    "excitation",
    {
        "slow_triangles": "realsim.gap.experiments.excitations.motions:slow_triangles",
        "chirp": "realsim.gap.experiments.excitations.motions:chirp",
        "multisine": "realsim.gap.experiments.excitations.motions:multisine",
        "torque_off": "realsim.gap.experiments.excitations.setups:torque_off",
        "two_gains": "realsim.gap.experiments.excitations.setups:two_gains",
        "two_postures": "realsim.gap.experiments.excitations.motions:two_postures",
        "known_mass": "realsim.gap.experiments.excitations.setups:known_mass",
        "push_and_slide": "realsim.gap.experiments.excitations.ground:push_and_slide",
        "step_elsewhere": "realsim.gap.experiments.excitations.ground:step_elsewhere",
    },
)
