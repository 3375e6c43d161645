"""What a collision representation hands on: geoms of the world and the files that they refer to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

IDENTITY = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Geom:
    """One static collision geom of the world body, simulation frame, metres; sizes as MuJoCo counts them."""

    name: str
    type: Literal["box", "plane", "hfield", "mesh", "sdf"]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = IDENTITY
    """w x y z."""
    size: tuple[float, float, float] | None = None
    """Half sizes of a box; half sizes and grid spacing of a plane; None where the asset has the size."""
    asset: str | None = None
    """Name of the `Asset` of a hfield or mesh."""
    visible: bool = False
    """Drawn as floor; otherwise the visual mesh stands for it and it hides in group 3."""


@dataclass(frozen=True)
class Asset:
    """A height field in a file, or the corners of a convex part, that geoms refer to."""

    name: str
    kind: Literal["hfield", "mesh"]
    file: str | None = None
    """Path relative to the scene's folder; None for a part that stands in the MJCF itself."""
    data: bytes = b""
    """Content of the file."""
    attributes: Mapping[str, str] = field(default_factory=dict)
    """More attributes of the MJCF element."""
    points: NDArray[np.float64] | None = None
    """(M, 3) corners of a convex part, simulation frame; MuJoCo takes their hull."""

    @staticmethod
    def of_points(name: str, points: NDArray[np.float64]) -> Asset:
        """A convex part given by its corners (M, 3), written into the MJCF to a hundredth of a millimetre."""
        text = " ".join(f"{v + 0.0:.5f}" for v in np.round(points, 5).ravel())
        return Asset(name, "mesh", attributes={"vertex": text}, points=points)


@dataclass(frozen=True)
class ContactModel:
    """A representation of one terrain."""

    representation: str
    geoms: tuple[Geom, ...]
    assets: tuple[Asset, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    """JSON-able, for the report."""
    warnings: tuple[str, ...] = ()


def floor_plane(z: float) -> Geom:
    """An infinite floor at height z."""
    return Geom("floor", "plane", pos=(0.0, 0.0, z), size=(0.0, 0.0, 0.5), visible=True)


def floor_around(bounds: NDArray[np.float64], z: float, reach: float = 20.0, depth: float = 0.5) -> tuple[Geom, ...]:
    """Four boxes with their tops at height z around a rectangle, `reach` metres wide.

    For representations that hold the floor themselves: a plane would be infinite, so that feet on the scanned floor
    would touch the floor twice and a floor scanned a millimetre too low would be hidden.

    Args:
        bounds: (2, 2) lower and upper x y of the rectangle that is left free.
    """
    (x0, y0), (x1, y1) = bounds
    cx, cy, hx, hy = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    half, h, pz = reach / 2, depth / 2, z - depth / 2
    return tuple(
        Geom(f"floor_{name}", "box", (float(x), float(y), pz), size=(float(sx), float(sy), h), visible=True)
        for name, x, y, sx, sy in (
            ("west", x0 - half, cy, half, hy + reach),
            ("east", x1 + half, cy, half, hy + reach),
            ("south", cx, y0 - half, hx, half),
            ("north", cx, y1 + half, hx, half),
        )
    )
