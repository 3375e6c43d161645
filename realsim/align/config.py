"""Options of the simulation frame."""

from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class AlignConfig:
    start: tuple[float, float] | None = None
    """X Y on the start platform, metres, in the simulation frame of a run without this option (see its report)."""
    goal: tuple[float, float] | None = None
    """X Y of a point on the goal platform, same frame."""
    start_pixel: tuple[str, int, int] | None = None
    """FRAME U V: a pixel of a frame (by name) that shows the start platform's top."""
    goal_pixel: tuple[str, int, int] | None = None
    """FRAME U V of the goal platform's top."""
    segmenter: Annotated[str, tyro.conf.arg(metavar="{geometric}")] = "geometric"
    """Method that labels points as ground, platform, obstacle or other."""
    margin: float = 0.5
    """Metres of ground kept around the terrain."""
    keep: Literal["terrain", "all"] = "terrain"
    """`terrain` cuts away everything out of reach of start and goal; `all` keeps all seen surface, including walls
    and ceiling."""
    seed: Annotated[int, tyro.conf.Suppress] = 0

    def __post_init__(self) -> None:
        if not self.margin >= 0:
            raise ValueError(f"need margin >= 0, found {self.margin:g}")
        for name, point in (("start", self.start), ("goal", self.goal)):
            if point is not None and not all(map(isfinite, point)):
                raise ValueError(f"{name} must be two numbers in metres, found {point[0]:g} {point[1]:g}")
