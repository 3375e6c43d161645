"""What can be set about the scene on disk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class SceneConfig:
    contact: Annotated[str, tyro.conf.arg(metavar="{auto,boxes,hybrid,sheets,convex,hfield,sdf,hull}")] = "auto"
    """Collision representation; `auto` takes the cheapest that meets --contact-tolerance."""
    contact_tolerance: tuple[float, float] = (0.005, 0.015)
    """Metres that contact may be off the mesh: median and 95th percentile."""
    contact_probes: int = 2000
    """Balls that are lowered to measure it."""
    hfield_resolution: float = 0.02
    """Metres a cell of the collision height field."""
    convex_threshold: float = 0.01
    """Metres of concavity that a part of the convex decomposition may have."""
    convex_columns: int = 6000
    """Columns of 1 cm that a convex decomposition may take on; its time grows faster than their number."""
    robot: Annotated[str | None, tyro.conf.arg(metavar="{g1,quadruped,menagerie:NAME}")] = None
    """Robot to put on the start platform."""
    drop_tolerance: float = 0.030
    """Metres by which an object dropped on a platform may rest beside that platform's height."""

    def __post_init__(self) -> None:
        if not 0.002 <= self.hfield_resolution <= 0.5:
            raise ValueError("hfield_resolution must lie between 0.002 and 0.5 metres")
        if not 0 < self.contact_tolerance[0] <= self.contact_tolerance[1]:
            raise ValueError("need 0 < median <= 95th percentile in contact_tolerance")
        if not 100 <= self.contact_probes <= 100_000:
            raise ValueError("contact_probes must lie between 100 and 100000")
        if not 0.001 <= self.convex_threshold <= 0.2:
            raise ValueError("convex_threshold must lie between 0.001 and 0.2 metres")
        if self.drop_tolerance <= 0:
            raise ValueError("drop_tolerance must be positive")
