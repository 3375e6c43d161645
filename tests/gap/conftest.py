"""Cases that the tests make themselves, each once a session."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from realsim.gap import Case, load_case
from realsim.gap.config import ExciteConfig
from realsim.gap.experiments import proposal
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth as TrueRobot
from tests.truths.written import write_case

from .searching import flights, logged
from .truth import ARM, Truth, make_case


@pytest.fixture(scope="session", autouse=True)
def the_next_experiment_is_a_short_one() -> Iterator[None]:
    """Every ambiguous diagnosis looks for one, for as long as all else takes; `experiments` tests it as it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proposal, "MOST_FREEDOM", 0)
        patch.setattr(proposal, "ExciteConfig", partial(ExciteConfig, seconds=2.0))
        yield


@pytest.fixture(scope="session")
def made(once: Callable[[object, Callable[[Path], object]], Path]) -> Callable[..., Path]:
    """`made(Truth(...))` is the folder of that case, four short runs of the two-link arm."""

    def make(truth: Truth, xml: str = ARM, **options: object) -> Path:
        options = {"runs": 4, "seed": 3, "span": (3.2, 4.0), **options}
        return once((xml, truth, options), lambda folder: make_case(folder, xml, truth, **options))  # type: ignore[arg-type]

    return make


@pytest.fixture(scope="session")
def quadruped(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A floating base on four blocks: the log is made by its own simulator."""
    folder = tmp_path_factory.mktemp("quadruped")
    robot = ROBOTS["quadruped"](np.random.default_rng(2))
    time = np.arange(0, 2.0, 0.01)
    sway = 0.15 * np.sin(2 * np.pi * np.outer(time, [0.9])) * np.tile([1.0, 0.8, 0.3], 4)
    command = robot.home + np.clip(time / 0.3, 0, 1)[:, None] * sway
    trace = Plant(robot, TrueRobot(len(robot.joints))).drive(time, command)  # it knows how the robot comes to rest
    rest = {"init_qpos": trace.qpos0, "init_qvel": np.zeros(len(trace.qpos0) - 1)}
    rest |= {"base_pos": np.tile(trace.qpos0[:3], (len(time), 1))}
    imu = {"imu_gyro": np.zeros((len(time), 3)), "imu_acc": np.zeros((len(time), 3))}
    run = {"time": time, "command": command, "joint_pos": command, **rest, **imu}
    return load_case(write_case(folder, robot.xml, {"one": run}, command_hold="zoh", imu_site=robot.imu_site))


@pytest.fixture(scope="session")
def settled(quadruped: Case) -> Case:
    """The same with a log that begins in the pose which the simulator itself comes to rest in."""
    return logged(quadruped, [])


@pytest.fixture(scope="session")
def hovering(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two flights of a drone as its model has it."""
    return flights(tmp_path_factory.mktemp("drone") / "case", runs=2, seconds=2.0)
