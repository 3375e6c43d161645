"""Tasks: one definition of observation, reward, termination, reset and randomisation over any engine."""

from trainer.tasks.base import Observation, ObservationLayout, Step, VecEnv

__all__ = ["Observation", "ObservationLayout", "Step", "VecEnv"]
