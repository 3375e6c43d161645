"""Convex outlines between two planes, and the boxes among them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from realsim.core.geometry import R_to_quat, quat_to_R
from realsim.core.types import F64
from realsim.export.contact.base import Asset, ContactModel, Geom
from realsim.export.contact.outline import distance, sides
from realsim.export.contact.polytope import Polytope

FLAT = 1e-4  # metres: corners are written to a hundredth of a millimetre, and MuJoCo finds no hull of a plane


@dataclass(frozen=True)
class Prism:
    """A convex outline between two planes."""

    outline: F64
    """(M, 2) x y, counter-clockwise, metres."""
    top: F64
    """(M,) z at the corners."""
    bottom: F64
    """(M,) z at the corners."""

    @property
    def corners(self) -> F64:
        """(2M, 3) all corners."""
        return np.concatenate([np.column_stack([self.outline, z]) for z in (self.top, self.bottom)])

    @cached_property
    def solid(self) -> Polytope:
        """What it fills."""
        return Polytope(self.corners)

    @property
    def flat(self) -> bool:
        """Whether all corners lie in one plane: nothing to collide with."""
        corners = self.corners - self.corners.mean(0)
        return bool(np.linalg.svd(corners, compute_uv=False)[-1] < FLAT)


def as_contact(
    name: str, prisms: list[Prism], floor: tuple[Geom, ...], statistics: Mapping[str, Any], solids: Iterable[F64] = ()
) -> ContactModel:
    """Geoms of solids [(M, 3) corners] and of prisms: a box where that is within 5 mm of one, else a convex mesh."""
    made = [Polytope.of_points("", corners).part(f"solid_{k}") for k, corners in enumerate(solids)]
    made += [as_geom(f"part_{k}", prism) for k, prism in enumerate(prisms)]
    geoms, assets = (*floor, *(geom for geom, _ in made)), tuple(asset for _, asset in made if asset is not None)
    return ContactModel(name, geoms, assets, dict(statistics) | {"parts": len(made)})


def as_geom(name: str, prism: Prism, R: F64 | None = None, origin: F64 | None = None) -> tuple[Geom, Asset | None]:
    """The box of a prism, or the convex mesh of its corners with its asset.

    Args:
        R, origin: (3, 3) and (3,) where the prism is given in a frame of its own: rotation and place of that frame.
    """
    box = _as_box(name, prism)
    if box is None:
        return Geom(name, "mesh", asset=name), Asset.of_points(name, placed(prism, R, origin))
    R, origin = np.eye(3) if R is None else R, np.zeros(3) if origin is None else origin
    x, y, z = (float(v) for v in R @ box.pos + origin)
    a, b, c, d = (float(v) for v in R_to_quat(R @ quat_to_R(box.quat)))
    return Polytope.of_box(replace(box, pos=(x, y, z), quat=(a, b, c, d))).part(name)


def placed(prism: Prism, R: F64 | None = None, origin: F64 | None = None) -> F64:
    """(2M, 3) corners of a prism of the frame with that rotation and place, in the world."""
    corners = prism.corners if R is None else prism.corners @ R.T
    return corners if origin is None else corners + origin


def _as_box(name: str, prism: Prism, tolerance: float = 0.005) -> Geom | None:
    """The box of a prism whose outline is a rectangle and whose top is level, both within `tolerance` metres."""
    centre, axes, half = _mean_rectangle(prism.outline, tolerance)
    if half.min() <= 0:
        return None
    rectangle = centre + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ axes
    if max(distance(rectangle, prism.outline).max(), distance(prism.outline, rectangle).max()) > tolerance:
        return None
    A = np.column_stack([prism.outline - centre, np.ones(len(prism.outline))])
    a, b, top = np.linalg.lstsq(A, prism.top, rcond=None)[0]
    _, _, bottom = np.linalg.lstsq(A, prism.bottom, rcond=None)[0]
    height = top - bottom
    if float(np.hypot(a, b)) * height > tolerance:
        return None  # its sides would lean out
    if np.ptp(prism.bottom) > 2 * tolerance and np.ptp(prism.top - prism.bottom) > tolerance:
        return None
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    u = np.array([*axes[0], a * axes[0, 0] + b * axes[0, 1]])
    u /= np.linalg.norm(u)
    rotation = np.stack([u, np.cross(normal, u), normal], 1)
    middle = np.array([*centre, top]) - normal * height / 2
    quat = R_to_quat(rotation)
    return Geom(
        name,
        "box",
        (float(middle[0]), float(middle[1]), float(middle[2])),
        (float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])),
        (float(half[0]), float(half[1]), float(height / 2)),
    )


def _rectangle(outline: F64) -> tuple[F64, F64, F64]:
    """Smallest rectangle around a convex outline: (centre (2,), axes (2, 2) as rows, half sizes (2,))."""
    best: tuple[float, F64, F64, F64] | None = None
    for side in sides(outline):
        length = float(np.linalg.norm(side))
        if length < 1e-9:
            continue
        u = side / length
        axes = np.array([u, [-u[1], u[0]]])
        along = outline @ axes.T
        low, high = along.min(0), along.max(0)
        size = float((high - low).prod())
        if best is None or size < best[0] - 1e-12:
            best = size, (low + high) / 2 @ axes, axes, (high - low) / 2
    assert best is not None
    return best[1], best[2], best[3]


def _mean_rectangle(outline: F64, tolerance: float) -> tuple[F64, F64, F64]:
    """The same with every side moved in to the mean of the corners that are near it: half way between the corners of
    a quadrilateral that is no rectangle."""
    centre, axes, half = _rectangle(outline)
    along = (outline - centre) @ axes.T
    high = np.array([along[along[:, k] > half[k] - 2 * tolerance, k].mean() for k in (0, 1)])
    low = np.array([along[along[:, k] < 2 * tolerance - half[k], k].mean() for k in (0, 1)])
    return centre + (low + high) / 2 @ axes, axes, (high - low) / 2
