"""The parkour task of the paper: from a start platform over obstacles to a goal, without touching the ground."""

from trainer.tasks.parkour.build import check, make
from trainer.tasks.parkour.config import ParkourConfig
from trainer.tasks.parkour.env import Ends, ParkourEnv

__all__ = ["Ends", "ParkourConfig", "ParkourEnv", "check", "make"]
