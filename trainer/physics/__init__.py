"""Engines behind one interface. One file an engine, one line in `ENGINES`."""

from trainer.physics.base import ENGINES, Physics, PhysicsConfig, State, WorldParams

__all__ = ["ENGINES", "Physics", "PhysicsConfig", "State", "WorldParams"]
