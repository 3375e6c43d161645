"""Solids whose surface is known exactly: hexahedra given by their corners, and upright cylinders."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from realsim.core.geometry import exp_so3
from realsim.core.meshes import across
from realsim.core.types import F64

I32 = NDArray[np.int32]

# Corners 0..3 are the bottom, 4..7 the top above them, both counter-clockwise seen from above.
_QUADS = ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_SIDES = 48


@dataclass(frozen=True)
class Solid:
    """A closed triangle mesh with a material.

    `role` is start, goal, obstacle (measured), floor, or scenery (walls and clutter: rendered, not part of the truth).
    """

    name: str
    vertices: F64
    """(V, 3) metres."""
    triangles: I32
    """(K, 3) counter-clockwise seen from outside."""
    material: str
    role: str = "obstacle"
    R: F64 = field(default_factory=lambda: np.eye(3))
    """(3, 3) axes of the solid in the scene: texture lies along them."""
    texture_origin: F64 | None = None
    """(3,) where the texture begins, so that copies look alike; None: every solid has its own piece of the tile."""

    def normals(self) -> F64:
        """(K, 3) unit normals of the triangles."""
        n = across(self.vertices, self.triangles)
        return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15)

    def moved(self, R: F64, t: ArrayLike) -> Solid:
        """The solid rotated by `R` (3, 3) and then moved by `t` (3,)."""
        t = np.asarray(t, float)
        origin = None if self.texture_origin is None else R @ self.texture_origin + t
        return replace(self, vertices=self.vertices @ R.T + t, R=R @ self.R, texture_origin=origin)


def hexahedron(name: str, corners: ArrayLike, material: str, role: str = "obstacle") -> Solid:
    """A solid with eight corners (8, 3): bottom 0..3, top 4..7 above them, counter-clockwise seen from above."""
    quads = np.asarray(_QUADS)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return Solid(name, np.asarray(corners, float), triangles, material, role)


def box(name: str, size: ArrayLike, material: str, role: str = "obstacle") -> Solid:
    """A box of size (3,) standing on z = 0, centred at x = y = 0."""
    return prism(name, size, material, role=role)


def prism(
    name: str,
    size: ArrayLike,
    material: str,
    *,
    top: ArrayLike = (1.0, 1.0),
    slope: float = 0.0,
    role: str = "obstacle",
) -> Solid:
    """A box whose top face is shrunk by `top` (x, y) about its centre, and rises by `slope` metres from -y to +y.

    `top` (0.6, 1) makes a trapezoid, `slope` a wedge; the height in `size` (3,) is that of the top's middle.
    """
    sx, sy, sz = np.asarray(size, float) / [2, 2, 1]
    tx, ty = np.asarray(top, float)
    ring = np.array([[-sx, -sy], [sx, -sy], [sx, sy], [-sx, sy]])
    rise = np.array([-0.5, -0.5, 0.5, 0.5]) * slope
    bottom = np.column_stack([ring, np.zeros(4)])
    return hexahedron(name, np.vstack([bottom, np.column_stack([ring * [tx, ty], sz + rise])]), material, role)


def cylinder(name: str, diameter: float, height: float, material: str, role: str = "obstacle") -> Solid:
    """An upright prism of 48 sides standing on z = 0, centred at x = y = 0."""
    a = np.arange(_SIDES) * 2 * np.pi / _SIDES
    ring = diameter / 2 * np.column_stack([np.cos(a), np.sin(a)])
    V = np.vstack([np.column_stack([ring, np.full(_SIDES, z)]) for z in (0.0, height)] + [[[0, 0, 0], [0, 0, height]]])
    i, j = np.arange(_SIDES), (np.arange(_SIDES) + 1) % _SIDES
    bottom, top = np.full(_SIDES, 2 * _SIDES), np.full(_SIDES, 2 * _SIDES + 1)
    F = np.vstack(
        [
            np.column_stack([i, j, j + _SIDES]),
            np.column_stack([i, j + _SIDES, i + _SIDES]),
            np.column_stack([bottom, j, i]),
            np.column_stack([top, i + _SIDES, j + _SIDES]),
        ]
    )
    return Solid(name, V, F.astype(np.int32), material, role)


def rz(angle: float) -> F64:
    """Rotation about z by `angle` radians."""
    return exp_so3([0.0, 0.0, angle])
