"""Robots: a table of figures becomes a `mujoco.MjSpec`. One small file a robot, one line here.

A robot is a function `() -> Robot`. `menagerie:NAME` reaches for MuJoCo Menagerie instead (extra `menagerie`).
"""

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from realsim.robots.base import Robot

__all__ = ["ROBOTS", "Robot", "load"]

ROBOTS = Registry(
    "robot",
    {
        "g1": "realsim.robots.g1:g1",
        "go2": "realsim.robots.go2:go2",
        "quadruped": "realsim.robots.quadruped:quadruped",
    },
)


def load(name: str) -> Robot:
    """The robot of that name: one of `ROBOTS`, or `menagerie:NAME`.

    Raises:
        UnknownNameError: no such robot; the message lists those that are.
        MissingExtraError, ExportError: Menagerie is not installed or cannot be reached.
    """
    if name.startswith("menagerie:"):
        from realsim.robots.menagerie import menagerie

        return menagerie(name.removeprefix("menagerie:"))
    if name not in ROBOTS:
        hint = f"menagerie:{name} takes a robot from MuJoCo Menagerie"
        raise UnknownNameError("robot", name, [*ROBOTS, "menagerie:NAME"], hint=hint)
    return ROBOTS[name]()
