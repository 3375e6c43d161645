"""Robots that can be trained. One small file a robot, one line here."""

from __future__ import annotations

from pathlib import Path

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from trainer.robots.base import DepthMount, TrainedRobot

__all__ = ["ROBOTS", "DepthMount", "TrainedRobot", "named"]

ROBOTS = Registry("robot", {"g1": "trainer.robots.g1:g1", "quadruped": "trainer.robots.quadruped:quadruped"})
"""name -> `() -> TrainedRobot`."""


def named(name: str, file: Path | None = None) -> TrainedRobot:
    """The robot of that name.

    Raises:
        UnknownNameError: no such robot; the message lists those that are, and names the file that asked for it.
    """
    if name not in ROBOTS:
        raise UnknownNameError("robot", name, ROBOTS, file=file)
    return ROBOTS[name]()
