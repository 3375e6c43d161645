"""Options of the scene on disk."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from realsim.core.limits import check_limits


@dataclass(frozen=True)
class SceneConfig:
    contact: Annotated[str, tyro.conf.arg(metavar="{auto,boxes,hybrid,sheets,convex,hfield,sdf,hull}")] = "auto"
    """Collision representation; `auto` takes the cheapest that meets --contact-tolerance."""
    contact_tolerance: Annotated[tuple[float, float], tyro.conf.arg(metavar="MEDIAN P95")] = (0.005, 0.015)
    """Largest error of contact in metres: median and 95th percentile."""
    contact_probes: int = 2000
    """Number of balls lowered to measure it."""
    hfield_resolution: float = 0.02
    """Cell size of the collision height field, metres."""
    convex_threshold: float = 0.01
    """Largest concavity of a part of the convex decomposition, metres; of a scan at least the tolerance's P95."""
    convex_columns: int = 6000
    """Largest number of 1 cm columns in a convex decomposition; its time grows faster than their number."""
    robot: Annotated[str | None, tyro.conf.arg(metavar="{g1,go2,quadruped,menagerie:NAME}")] = None
    """Robot to put on the start platform."""

    def __post_init__(self) -> None:
        check_limits(
            self,
            least={"hfield_resolution": 0.002, "contact_probes": 100, "convex_threshold": 0.001},
            most={"hfield_resolution": 0.5, "contact_probes": 100_000, "convex_threshold": 0.2},
        )
        median, p95 = self.contact_tolerance
        if not 0 < median <= p95:
            raise ValueError(f"need 0 < median <= 95th percentile in contact_tolerance, found {median:g} and {p95:g}")
