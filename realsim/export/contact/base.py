"""Result of a collision representation: geoms of the world and the files that they refer to."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError

SEAM = 0.05
"""Metres by which boxes of a floor reach into each other: what falls fast sinks centimetres into a soft contact, and
where two boxes only met, each would push it into the other."""
IDENTITY = (1.0, 0.0, 0.0, 0.0)


class UnsuitedError(ExportError):
    """A representation cannot be made of this shape in reasonable time."""


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


def floor_around(holes: NDArray[np.float64], z: float, reach: float = 20.0, depth: float = 0.5) -> tuple[Geom, ...]:
    """Boxes with their tops at height z around rectangular holes, `reach` metres beyond them; four for one hole.

    For representations that hold the floor themselves there: a plane would be infinite, so that feet on the scanned
    floor would touch the floor twice and a floor scanned a millimetre too low would be hidden.

    Args:
        holes: (H, 2, 2) lower and upper x y of the rectangles that are left free.
    """
    (x0, y0), (x1, y1) = holes[:, 0].min(0) - reach, holes[:, 1].max(0) + reach
    boxes: list[list[float]] = []
    levels = np.unique([y0, *holes[:, :, 1].ravel(), y1])
    for low, high in itertools.pairwise(levels):
        beside = sorted(h[:, 0].tolist() for h in holes if h[0, 1] < high and h[1, 1] > low)
        left = x0
        for begin, end in [*beside, [x1, x1]]:
            same = [b for b in boxes if b[0] == left and b[2] == begin and b[3] == low]
            if same:
                same[0][3] = high
            elif begin > left:
                boxes.append([left, low, begin, high])
            left = max(left, end)
    half, pz = depth / 2, z - depth / 2
    out = []
    for k, box in enumerate(boxes):
        a, b, c, d = _grown(box, holes)
        centre, size = ((a + c) / 2, (b + d) / 2, pz), ((c - a) / 2, (d - b) / 2, half)
        out.append(Geom(f"floor_{k}", "box", centre, size=size, visible=True))
    return tuple(out)


def _grown(box: list[float], holes: NDArray[np.float64]) -> list[float]:
    """A rectangle (x y x y) with every side moved out by SEAM where that leaves the holes free."""
    for side, step in enumerate((-SEAM, -SEAM, SEAM, SEAM)):
        wider = [v + step * (k == side) for k, v in enumerate(box)]
        apart = (holes[:, 0] >= wider[2:]).any(1) | (holes[:, 1] <= wider[:2]).any(1)
        box = wider if apart.all() else box
    return [float(v) for v in box]
