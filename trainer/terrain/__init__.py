"""Terrains: generated families, the curriculum grid, the named tests, reconstructed scenes.

A family is a function `(difficulty, rng) -> Course` and one line here.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from trainer.errors import TrainerError
from trainer.terrain.base import Box, Platform, Terrain

__all__ = ["ALL", "CURRICULUM", "FAMILIES", "TESTS", "Box", "Platform", "Terrain", "flat", "generate", "grid", "named"]

FAMILIES = Registry(
    "terrain family",
    {
        "wedges": "trainer.terrain.families:wedges",
        "stakes": "trainer.terrain.families:stakes",
        "boxes": "trainer.terrain.families:boxes",
        "trapezoids": "trainer.terrain.families:trapezoids",
        "beams": "trainer.terrain.families:beams",
        "mixed": "trainer.terrain.families:mixed",
        "boston": "trainer.terrain.families:boston",
        "bends": "trainer.terrain.families:bends",
    },
)
CURRICULUM = ("wedges", "stakes", "boxes", "trapezoids", "beams")
"""Families of the pre-training grid, four columns each (the paper, section V-A)."""
ALL = (*CURRICULUM, "mixed", "bends", "boston")
"""What a base is trained on: also courses of several kinds, and such as do not lead straight to the goal."""
ROWS, COLUMNS_A_FAMILY = 10, 4

TESTS: dict[str, tuple[str, float, int]] = {
    "boxes": ("boxes", 0.6, 11),
    "wedges": ("wedges", 0.8, 12),
    "narrow1": ("beams", 0.7, 13),
    "narrow2": ("beams", 0.6, 14),
    "narrow3": ("beams", 0.9, 15),
    "trapezoid1": ("trapezoids", 0.9, 16),
    "trapezoid2": ("trapezoids", 0.6, 17),
    "boston": ("boston", 0.9, 18),
    "stake1": ("stakes", 0.8, 19),
    "stake2": ("stakes", 0.9, 20),
    "stake3": ("stakes", 0.7, 21),
    "mixed1": ("mixed", 0.8, 22),
    "mixed2": ("mixed", 0.7, 23),
}
"""The thirteen test terrains: name -> (family, difficulty, seed).

The paper names them; their dimensions stand in figures that are not available, so these are ours.
"""


def generate(family: str, difficulty: float, seed: int) -> Terrain:
    """A terrain of the family; the same arguments give the same terrain.

    Args:
        difficulty: 0 easiest to 1 hardest.

    Raises:
        UnknownNameError: no such family; the message lists those that are.
        TrainerError: the difficulty lies outside 0 to 1.
    """
    from trainer.terrain.course import place

    if not 0.0 <= difficulty <= 1.0:
        raise TrainerError(f"difficulty {difficulty:g} is not between 0 and 1", hint="0 is easiest, 1 hardest")
    build = FAMILIES[family]
    course = build(difficulty, np.random.default_rng([seed, list(FAMILIES).index(family)]))
    return place(f"{family}_{difficulty:.2f}_{seed}", course, family, difficulty)


def grid(
    seed: int = 0, families: Sequence[str] = CURRICULUM, columns_a_family: int = COLUMNS_A_FAMILY
) -> list[Terrain]:
    """The curriculum, row-major: terrain `row * columns + column`, difficulty row / 9.

    The defaults are the paper's 20 columns x 10 rows.
    """
    columns = [family for family in families for _ in range(columns_a_family)]
    return [
        generate(family, row / (ROWS - 1), seed * 1000 + row * len(columns) + column)
        for row in range(ROWS)
        for column, family in enumerate(columns)
    ]


def named(name: str) -> Terrain:
    """One of the thirteen test terrains.

    Raises:
        UnknownNameError: no such terrain; the message lists those that are.
    """
    if name not in TESTS:
        raise UnknownNameError("test terrain", name, TESTS)
    return replace(generate(*TESTS[name]), name=name)


def flat(length: float = 4.0) -> Terrain:
    """Level practice ground: no obstacles, touching the ground is no failure, the goal `length` metres ahead."""
    size = np.array([0.9, 0.8])
    return Terrain(
        name="flat",
        boxes=(),
        vertices=np.zeros((0, 3)),
        triangles=np.zeros((0, 3), np.int32),
        start=Platform(np.zeros(3), size),
        goal=Platform(np.array([length, 0.0, 0.0]), size),
        floor_z=0.0,
        ground_fails=False,
        family="flat",
    )
