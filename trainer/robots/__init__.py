"""Robots that can be trained. One small file a robot; entry points in the group `realsim.robots`.

A package of your own adds one with, in its pyproject.toml,

    [project.entry-points."realsim.robots"]
    mydog = "my_package.dog:mydog"

where `mydog()` returns a `TrainedRobot`, as `trainer.robots.file.load(path)` does. A file of `realsim robot new` can be
given in the place of a name too.
"""

from importlib.metadata import entry_points
from pathlib import Path

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from trainer.robots.base import DepthMount, TrainedRobot

__all__ = ["ROBOTS", "DepthMount", "TrainedRobot", "named"]

BUILT_IN = {
    "g1": "trainer.robots.g1:g1",
    "go2": "trainer.robots.go2:go2",
    "quadruped": "trainer.robots.quadruped:quadruped",
}
ROBOTS = Registry("robot", {**BUILT_IN, **{p.name: p.value for p in entry_points(group="realsim.robots")}})
"""name -> `() -> TrainedRobot`."""


def named(name: str, file: Path | None = None) -> TrainedRobot:
    """The robot of that name, or of a file of `realsim robot new`.

    Raises:
        UnknownNameError: no such robot; the message lists those that are, and names the file that requested it.
        TrainerError: the file is none of a robot, or does not fit its model.
    """
    if name.endswith(".toml"):
        from trainer.robots.file import load

        return load(Path(name))
    if name not in ROBOTS:
        hint = f"realsim robot new {name} makes a robot of it" if Path(name).suffix in (".xml", ".urdf") else None
        raise UnknownNameError("robot", name, ROBOTS, file=file, hint=hint)
    return ROBOTS[name]()
