"""What values say of names: a table whose names lie is in doubt, and one whose names are right is not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from realsim.gap.recordings import load_target, propose, read
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.proposal import Proposal
from realsim.gap.recordings.recording import Field, Recording, Stream

from .robots import ARM, Log, save

HEADER = "time,shoulder_cmd,elbow_cmd,shoulder_pos,elbow_pos,shoulder_vel,elbow_vel"
DEG = 180 / np.pi
JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Target:
    return load_target(save(tmp_path_factory.mktemp("arm"), ARM))


def proposed(path: Path, target: Target, log: Log, lie: Callable[[dict[str, np.ndarray]], None]) -> Proposal:
    columns = dict(zip(HEADER.split(","), (log.time, *log.command.T, *log.pos.T, *log.vel.T), strict=True))
    lie(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=HEADER, comments="", fmt="%.9g")
    return propose(read(path), target)


def exchange(columns: dict[str, np.ndarray], *pairs: tuple[str, str]) -> None:
    for a, b in pairs:
        columns[a], columns[b] = columns[b], columns[a]


def test_names_that_are_right_are_in_no_doubt(arm: Log, target: Target, tmp_path: Path) -> None:
    found = proposed(tmp_path / "run.csv", target, arm, lambda columns: None)
    assert not [role for role, a in found.assignments.items() if a.doubtful], found.render()
    assert "the joints follow it" in found.render()


LIES: dict[str, tuple[str, Callable[[dict[str, np.ndarray]], None]]] = {
    "before its command": ("command", lambda c: exchange(c, *((f"{j}_cmd", f"{j}_pos") for j in JOINTS))),
    "names say otherwise": ("command", lambda c: exchange(c, ("shoulder_cmd", "elbow_cmd"))),
    "does not follow": ("command", lambda c: c.update(elbow_cmd=2 - c["elbow_cmd"])),
    "times as far": ("command", lambda c: c.update(elbow_cmd=c["elbow_cmd"] / DEG)),
    "from its command": ("command", lambda c: c.update(elbow_cmd=c["elbow_cmd"] + 1)),
    "its command rests": ("command", lambda c: c.update(elbow_cmd=0 * c["time"])),
    "times the positions' slope": ("joint_vel", lambda c: c.update(elbow_vel=-c["elbow_vel"])),
    "nothing to do with": ("joint_vel", lambda c: c.update(elbow_vel=c["elbow_vel"] + 6 * np.sin(2.3 * c["time"]))),
}  # fmt: skip


@pytest.mark.parametrize("said", LIES)
def test_names_that_lie_are_in_doubt(said: str, arm: Log, target: Target, tmp_path: Path) -> None:
    role, lie = LIES[said]
    found = proposed(tmp_path / "run.csv", target, arm, lie).assignments[role]
    assert found.doubtful
    assert any(said in line for line in found.evidence), found.evidence


def test_a_joint_that_moves_without_its_command_is_named(arm: Log, target: Target) -> None:
    fields = {"q": Field(arm.pos, target.joints), "q_cmd": Field(arm.command[:, :1], target.joints[:1])}
    run = Recording(Path("run.csv"), "run", "csv", (Stream("", "table", {"time": arm.time}, fields),))
    found = propose([run], target).assignments["command"]
    assert found.doubtful
    assert any("elbow_joint: moves, and its command is not taken" in line for line in found.evidence), found.evidence


SLIDE = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body><joint name="J1" range="-3 3"/>
<geom size="0.1" mass="1"/><body><joint name="J2" range="-3 3"/><geom size="0.1" mass="1"/><body>
<joint name="J3" type="slide" range="-0.1 0.3"/><geom size="0.1" mass="1"/></body></body></body></worldbody>
<actuator><position name="J1" joint="J1"/><position name="J2" joint="J2"/><position name="J3" joint="J3"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("names", ["J{}.{}.{}", "J{} {} [{}]"])
def test_a_column_has_a_unit_of_its_own(names: str, tmp_path: Path) -> None:
    """A slide in mm beside hinges in deg."""
    (tmp_path / "robot.xml").write_text(SLIDE)
    t = 0.01 * np.arange(600)
    motion = np.stack([0.5 * np.sin(t), 0.4 * np.sin(1.7 * t), 0.1 + 0.08 * np.sin(2.3 * t)], axis=1)
    late = np.stack([np.interp(t - 0.03, t, m) for m in motion.T], axis=1)
    size = np.array([DEG, DEG, 1e3])
    header = [names.format(k, s, u) for s in ("soll", "ist") for k, u in ((1, "deg"), (2, "deg"), (3, "mm"))]
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, size * motion, size * late]), delimiter=",",
               header=",".join(["t", *header]), comments="", fmt="%.9g")  # fmt: skip
    found = propose(read(tmp_path / "run.csv"), load_target(tmp_path / "robot.xml"))
    assert found.joints == ("J1", "J2", "J3"), found.render()
    assert found.assignments["joint_pos"].unit == "deg, mm"
    arrays = run_arrays(found, found.recordings[0]).arrays
    np.testing.assert_allclose(arrays["joint_pos"], late[: len(arrays["time"])], atol=1e-6)
    np.testing.assert_allclose(arrays["command"], motion[: len(arrays["time"])], atol=1e-6)
    assert not [role for role, a in found.assignments.items() if a.doubtful], found.render()
