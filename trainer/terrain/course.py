"""From obstacles on the ground to a `Terrain`: platforms at both ends, the simulation frame, the mesh."""

from dataclasses import dataclass, field

import numpy as np

from realsim.core.geometry import make_T
from trainer.terrain.base import Box, Platform, Terrain
from trainer.terrain.shapes import block, mesh, moved, rz

PLATFORM = (0.9, 0.8, 0.35)
"""Length, width and height of the start and goal platforms, metres (the paper, section V-A)."""


@dataclass(frozen=True)
class Course:
    """Obstacles standing on the ground z = 0 between x = 0 (the start platform's edge) and x = `length`."""

    boxes: list[Box]
    length: float
    facts: dict[str, float] = field(default_factory=dict)
    """What was drawn, SI units."""
    goal_y: float = 0.0
    """How far the goal platform lies to the left, metres."""


def place(name: str, course: Course, family: str = "", difficulty: float = 0.0) -> Terrain:
    """The course between two platforms, in the simulation frame (origin on the start platform's top, x to the goal)."""
    length, width, height = PLATFORM
    ends = [(-length / 2, 0.0), (course.length + length / 2, course.goal_y)]
    boxes = [*(block(x, y, PLATFORM) for x, y in ends), *course.boxes]
    step = np.subtract(ends[1], ends[0])
    yaw = -float(np.arctan2(step[1], step[0]))
    turn = rz(yaw)
    T = make_T(turn, -turn @ [*ends[0], height])
    boxes = [moved(b, T) for b in boxes]
    vertices, triangles = mesh(boxes)
    size = np.array([length, width])
    return Terrain(
        name=name,
        boxes=tuple(boxes),
        vertices=vertices,
        triangles=triangles,
        start=Platform(np.zeros(3), size, yaw),
        goal=Platform(np.array([float(np.hypot(*step)), 0.0, 0.0]), size, yaw),
        floor_z=-height,
        family=family,
        difficulty=difficulty,
        facts=dict(course.facts),
    )
