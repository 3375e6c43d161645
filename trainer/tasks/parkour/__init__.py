"""The parkour task of the paper: from a start platform over obstacles to a goal, without touching the ground."""

from typing import TYPE_CHECKING

from realsim.core.registry import lazily
from trainer.tasks.parkour.config import ParkourConfig

if TYPE_CHECKING:
    from trainer.tasks.parkour.build import check, make
    from trainer.tasks.parkour.env import Ends, ParkourEnv

__all__ = ["Ends", "ParkourConfig", "ParkourEnv", "check", "make"]

# What can be set is known without torch, which `--help` would wait for.
__getattr__ = lazily(
    __name__,
    {
        **dict.fromkeys(("check", "make"), "trainer.tasks.parkour.build"),
        **dict.fromkeys(("Ends", "ParkourEnv"), "trainer.tasks.parkour.env"),
    },
)
