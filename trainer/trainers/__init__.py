"""Learners behind one hook (`base.Trainer`). One file a learner; entry points in the group `realsim.trainers`.

A package of your own adds one with, in its pyproject.toml,

    [project.entry-points."realsim.trainers"]
    mine = "my_package.trainer:train"
"""

from trainer.trainers.base import Scene, TrainConfig, Trainer, TrainResult

__all__ = ["BUILT_IN", "Scene", "TrainConfig", "TrainResult", "Trainer", "find"]

BUILT_IN = {
    "ppo": "trainer.trainers.ppo:train",
    "rsl_rl": "trainer.trainers.rsl_rl:train",
}
"""Known without being installed as entry points (a checkout on the path is enough)."""


def find(name: str) -> Trainer:
    """The trainer of that name.

    Raises:
        UnknownNameError: no such trainer; the message lists those that are.
        MissingExtraError: it needs a package that is not installed.
    """
    from realsim.core.registry import Registry

    return Registry("trainer", BUILT_IN, group="realsim.trainers")[name]
