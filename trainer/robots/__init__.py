"""Robots that can be trained. One small file a robot, one line here."""

from __future__ import annotations

from realsim.registry import Registry
from trainer.robots.base import DepthMount, TrainedRobot

__all__ = ["ROBOTS", "DepthMount", "TrainedRobot"]

ROBOTS = Registry("robot", {"g1": "trainer.robots.g1:g1", "quadruped": "trainer.robots.quadruped:quadruped"})
"""name -> `() -> TrainedRobot`."""
