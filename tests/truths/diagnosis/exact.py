"""One cause on a robot without everyday deviations and with exact sensors: what a simulated law is held against."""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from tests.truths.diagnosis import causes
from tests.truths.diagnosis.cases import Sensors, site_of, write_log
from tests.truths.diagnosis.motions import KINDS, motion, sample_times
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth

EXACT = Sensors(rate=200.0, velocity=True, torque_kind="measured", torque_constant=1.0, mocap=True, noise=1e-7, bits=26)

SECONDS = 3.0


@cache
def _site(robot: str, seed: int) -> causes.Site:
    made = ROBOTS[robot](np.random.default_rng(seed))
    return site_of(made, mujoco.MjModel.from_xml_string(made.xml), seed)


def write_exact(
    folder: Path, robot: str, effect: str | None, strength: float = 0.7, seed: int = 0
) -> tuple[causes.Label | None, Truth]:
    """Write a log of one run in the contract's form; the label is returned, and the truth behind it.

    Args:
        effect: None for a robot without any.
        strength: of the cause, 0 (weak) to 1.
    """
    rng = np.random.default_rng(seed)
    made = ROBOTS[robot](rng)
    site = _site(robot, seed)
    truth = Truth(len(made.joints))
    label = causes.available(made)[effect](truth, site, np.random.default_rng(seed), strength) if effect else None
    times = sample_times(rng, EXACT.rate, SECONDS)
    command = motion(made, rng, times, KINDS[made.base][0])
    write_log(folder, made, EXACT, truth, [(times, command)], [Plant(made, truth).drive(times, command)], rng)
    return label, truth
