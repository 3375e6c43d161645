"""A generated course in a room, for `realsim.synth` to render: what a depth camera would see of it."""

import numpy as np

from realsim.synth.solids import Solid, hexahedron
from realsim.synth.terrain import Terrain as Room
from realsim.synth.terrain import in_a_room
from trainer.errors import TrainerError
from trainer.terrain.base import Box, Terrain

MATERIALS = ("wood", "osb", "cardboard", "painted", "foam")
_CORNERS = np.array([[x, y, z] for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) / 2
"""(8, 3) of a unit box: bottom, then top, counter-clockwise seen from above."""


def in_room(terrain: Terrain, seed: int = 0) -> Room:
    """The course with a floor, walls and clutter around it; materials and clutter are drawn from `seed`.

    Pass it to `realsim.synth.write_capture(..., terrain=...)`. Both are in the simulation frame of `terrain`.

    Raises:
        TrainerError: a reconstructed scene, which was a capture already.
    """
    if terrain.contact is not None or len(terrain.boxes) < 2:
        raise TrainerError("only generated courses can be rendered", found=terrain.name)
    rng = np.random.default_rng([seed, 11])
    # Generated courses begin with their platforms (`course.place`); boxes stand on z = 0 here.
    start, goal, *obstacles = (
        _solid(box, name, terrain.floor_z, str(rng.choice(MATERIALS)))
        for name, box in zip(_names(len(terrain.boxes)), terrain.boxes, strict=True)
    )
    return in_a_room(terrain.name, start, obstacles, goal, rng)


def _names(count: int) -> list[str]:
    return ["start_platform", "goal_platform", *(f"obstacle_{i}" for i in range(count - 2))]


def _solid(box: Box, name: str, floor_z: float, material: str) -> Solid:
    role = {"start_platform": "start", "goal_platform": "goal"}.get(name, "obstacle")
    corners = (_CORNERS * box.size) @ box.T[:3, :3].T + box.T[:3, 3] - [0, 0, floor_z]
    return hexahedron(name, corners, material, role)
