"""Which platform is the start and which the goal: by rule, or as the person says."""

from __future__ import annotations

import numpy as np

from realsim.align.platforms import Face
from realsim.errors import AlignError
from realsim.types import F64


def choose(faces: list[Face], camera: F64 | None) -> tuple[int, int] | None:
    """Indices of start and goal by the rule, None with fewer than two faces.

    The pair that is largest and furthest apart: sqrt(area1 * area2) times the distance of the centroids, areas as
    seen. The one nearer the first camera is the start; without a camera, the one nearer the source's origin.

    Args:
        camera: (2,) the first camera (or sensor, or origin) in the plan of the levelled frame.
    """
    if len(faces) < 2:
        return None
    pairs = [(i, j) for i in range(len(faces)) for j in range(i + 1, len(faces))]
    i, j = max(pairs, key=lambda p: pair_score(faces[p[0]], faces[p[1]]))
    near = np.zeros(2) if camera is None else camera
    first = np.linalg.norm(faces[i].centroid - near) <= np.linalg.norm(faces[j].centroid - near)
    return (i, j) if first else (j, i)


def pair_score(a: Face, b: Face) -> float:
    """Metres^3, see `choose`."""
    return float(np.sqrt(a.seen * b.seen) * np.linalg.norm(a.centroid - b.centroid))


def containing(faces: list[Face], xy: F64, what: str, listed: str, slack: float = 0.10) -> int:
    """The face that a point lies on, or within `slack` metres of.

    Raises:
        AlignError: none; the message lists what there is.
    """
    distances = [distance_outside(face.outline, xy) for face in faces]
    if not distances or min(distances) > slack:
        raise AlignError(
            f"no platform where the {what} was asked for",
            expected=f"one of {listed}" if listed else "a capture with platforms",
            found=f"{what} at {xy[0]:.2f} {xy[1]:.2f}",
            hint="take X Y from the report of a run without --start and --goal, or give a pixel",
        )
    return int(np.argmin(distances))


def distance_outside(outline: F64, xy: F64) -> float:
    """Metres by which a point lies outside a convex counter-clockwise outline (0 inside)."""
    a, b = outline, np.roll(outline, -1, 0)
    edge = b - a
    t = np.clip(((xy - a) * edge).sum(1) / np.maximum((edge**2).sum(1), 1e-12), 0, 1)
    inside = np.all(edge[:, 0] * (xy - a)[:, 1] - edge[:, 1] * (xy - a)[:, 0] >= 0)
    return 0.0 if inside else float(np.linalg.norm(a + t[:, None] * edge - xy, axis=1).min())
