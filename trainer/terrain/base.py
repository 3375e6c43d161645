"""Interface of terrains: exact primitives for contact, one mesh for rays, two platforms."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64


@dataclass(frozen=True)
class Box:
    """An oriented box: the cheapest thing that a capsule can collide with, on the CPU and on the GPU."""

    size: F64
    """(3,) full edge lengths, metres."""
    T: F64
    """(4, 4) pose of its centre in the terrain's frame."""


@dataclass(frozen=True)
class Platform:
    """A level place to stand: the start or the goal."""

    centre: F64
    """(3,) centroid of the top face, metres."""
    size: F64
    """(2,) extent along its own x and y, metres."""
    yaw: float = 0.0
    """Radians about z from the terrain's x to its own."""

    def contains(self, xy: F64, margin: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether (N, 2) points lie over the platform, at least `margin` metres inside its border."""
        return np.all(np.abs((xy - self.centre[:2]) @ self._axes) <= self.size / 2 - margin, axis=-1)

    def corners(self) -> F64:
        """(4, 2) x and y of its corners, metres."""
        unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        return self.centre[:2] + (unit * self.size) @ self._axes.T

    @property
    def _axes(self) -> F64:
        """(2, 2) its own x and y as columns."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Terrain:
    """A course in the simulation frame: origin on the start platform's top, z up, x toward the goal; metres."""

    name: str
    boxes: tuple[Box, ...]
    """Contact primitives, platforms included, ground excluded. Empty when `contact` carries the geometry."""
    vertices: F64
    """(V, 3) of the closed triangle mesh that rays hit: obstacles and platforms, ground excluded."""
    triangles: NDArray[np.int32]
    """(K, 3) counter-clockwise seen from outside."""
    start: Platform
    goal: Platform
    floor_z: float
    """Height of the ground plane; it collides always."""
    ground_fails: bool = True
    """Whether touching the ground ends an episode (false on flat practice ground)."""
    contact: Any = None
    """Contact geometry of a reconstructed scene: `mujoco.MjSpec`, its world geoms taken instead of `boxes`."""
    drawn: Path | None = None
    """visual.obj of a reconstructed scene (with visual.png beside it): drawn instead of the contact geometry."""
    family: str = ""
    difficulty: float = 0.0
    """0 easiest to 1 hardest, for generated terrain."""
    facts: dict[str, float] = field(default_factory=dict)
    """What was drawn (gap, width, height, ...), SI units."""
