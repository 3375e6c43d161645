"""Tasks: one definition of observation, reward, termination, reset and randomisation over any engine."""

from typing import TYPE_CHECKING

from realsim.core.registry import lazily

if TYPE_CHECKING:
    from trainer.tasks.base import Observation, ObservationLayout, Step, VecEnv

__all__ = ["Observation", "ObservationLayout", "Step", "VecEnv"]

# They need torch, which `--help` would wait for.
__getattr__ = lazily(__name__, dict.fromkeys(__all__, "trainer.tasks.base"))
