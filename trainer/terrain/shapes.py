"""Oriented boxes placed on the ground z = 0, from which every generated obstacle is made."""

import numpy as np

from realsim.core.geometry import exp_so3, make_T, transform
from trainer.terrain.base import F64, Box

_SUNK = 0.30
"""Metres by which a leaning block reaches below the ground, so that no tilt opens a gap under it."""

# Corners of the unit cube, x fastest, and its faces counter-clockwise seen from outside.
CORNERS = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


def rz(angle: float) -> F64:
    """(3, 3) rotation about z by `angle` radians."""
    return exp_so3([0.0, 0.0, angle])


def block(x: float, y: float, size: tuple[float, float, float], yaw: float = 0.0) -> Box:
    """An upright box of `size` (length, width, height) standing on the ground at (x, y)."""
    return Box(np.asarray(size, float), make_T(rz(yaw), np.array([x, y, size[2] / 2])))


def leaning(x: float, y: float, size: tuple[float, float, float], tilt: float, toward: float) -> Box:
    """A block whose top face is tilted by `tilt` radians, descending along the heading `toward`; its top's middle is
    at height `size[2]` over (x, y), and its foot is sunk into the ground."""
    deep = size[2] + _SUNK
    R = rz(toward) @ exp_so3([0.0, tilt, 0.0])
    top_middle = np.array([x, y, size[2]])
    return Box(np.array([size[0], size[1], deep]), make_T(R, top_middle - R @ [0, 0, deep / 2]))


def frustum(x: float, y: float, top: tuple[float, float], height: float, flank: float, yaw: float = 0.0) -> list[Box]:
    """A trapezoid: a level top of `top` (length, width), flanks before and behind it that descend by `flank` radians.

    The core is one block; each flank is a block tilted about the top's edge, its upper face the slope, its rest
    inside the core or below the ground.
    """
    boxes = [block(x, y, (top[0], top[1], height), yaw)]
    along = height / np.sin(flank) + 0.05  # a little past the ground, so that the foot of the slope is buried
    thick = height / np.cos(flank)  # down to the ground: no hollow under the slope, the rest lies inside the ridge
    for side in (1.0, -1.0):
        heading = yaw + (0.0 if side > 0 else np.pi)
        R = rz(heading) @ exp_so3([0.0, flank, 0.0])
        edge = np.array([x, y, height]) + rz(heading) @ [top[0] / 2, 0, 0]
        centre = edge + R @ [along / 2, 0, -thick / 2]
        boxes.append(Box(np.array([along, top[1], thick]), make_T(R, centre)))
    return boxes


def corners(box: Box) -> F64:
    """(8, 3) corners in the order of `CORNERS`."""
    return transform(box.T, CORNERS * box.size)


def mesh(boxes: list[Box] | tuple[Box, ...]) -> tuple[F64, np.ndarray]:
    """(8 B, 3) vertices and (12 B, 3) triangles of the boxes, each closed by itself."""
    if not boxes:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    triangles = np.vstack([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
    vertices = np.vstack([corners(b) for b in boxes])
    return vertices, np.vstack([triangles + 8 * i for i in range(len(boxes))]).astype(np.int32)


def moved(box: Box, T: F64) -> Box:
    """The box under the rigid motion T (4, 4)."""
    return Box(box.size, T @ box.T)
