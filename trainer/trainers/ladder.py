"""Help on a terrain that the base hardly crosses: the same course with wider tops, from which it narrows."""

from dataclasses import replace

from trainer.tasks.parkour import ParkourConfig
from trainer.terrain.widen import LADDER, ladder
from trainer.trainers.base import Scene

HELP_BELOW = 0.8
"""Base success below which training begins on wider tops. Set on beams, stakes and mixed courses of difficulty 1 and on
`stake2` (training/g1/README.md)."""
ALONG = 0.3
"""Share of episodes that begin along such a course, as in the base's own training."""
KEEP_LAST = 0.8
"""Share of the worlds that cross the true course which stay on it."""
WAITING = -2.0
"""Weight of waiting while told to go. With the paper's -0.5 a robot that steps off the start and stands until the
time is over earns 62, discounted as PPO does 7.6, and one that falls half way 12 and 7.2; with this weight 34 and 5.8.
Standing at the start earns 12 and 5.3, with this weight 6 and 2.7 (tests/trainer/test_attempt.py)."""


def helped(scene: Scene, task: ParkourConfig) -> tuple[Scene, ParkourConfig]:
    """The scene as a curriculum whose last row is its terrains, and the task in which an attempt pays more than to
    stand; what the task sets itself stays."""
    if scene.rows > 1:
        return scene, task
    weights = {"dont_wait": WAITING} | task.reward.weights
    reset = replace(task.reset, along=task.reset.along or ALONG, keep_last=task.reset.keep_last or KEEP_LAST)
    task = replace(task, reset=reset, reward=replace(task.reward, weights=weights))
    if any(t.contact is not None for t in scene.terrains) and not task.randomisation.terrain_variants:
        # Every rung of a reconstruction is geometry of its own: in five sizes each it would not fit into a model.
        task = replace(task, randomisation=replace(task.randomisation, terrain_variants=1))
    return replace(scene, terrains=ladder(scene.terrains), rows=len(LADDER), judged=scene.terrains), task
