"""Platforms: from labelled points to top faces with outline, centroid, size and height."""

from dataclasses import dataclass

import numpy as np

from realsim.align.cloud import Cloud
from realsim.align.faces import LEVEL_DEG, connected, large, plane_of, seen_area
from realsim.align.flights import treads
from realsim.align.segment import Label, Labels
from realsim.align.split import split
from realsim.core.geometry import transform
from realsim.core.types import F64, Platform

FOOT = 0.12
"""Metres about a point within which its slope is taken: half a foot's length. Set on a real chair, whose hollow seat is
turned by 3.9 degrees against its own plane. Start and goal of the rendered test `boston` are turned by 0.3. A ring of
tilted tops, which must not pass, was checked as made points alone."""
JOIN = 0.05
"""Metres: platform points closer than this, and on one plane, belong to one face."""


@dataclass(frozen=True)
class Face:
    """A top face in the levelled frame: z up, ground at z = 0."""

    slope: F64
    """(2,) dz/dx, dz/dy of its plane."""
    height: float
    """z of its plane at `centroid`."""
    outline: F64
    """(K, 2) convex outline, counter-clockwise."""
    centroid: F64
    """(2,) of the outline's area."""
    area: float
    """m^2 inside the outline."""
    seen: float
    """m^2 with points on it."""
    looks: float
    """Sum of the points' weights: how much the capture looked at it."""
    inferred: bool = False
    """Whether its top was not seen, or only in part: its outline follows from a flight of stairs."""


def find_faces(cloud: Cloud, labels: Labels) -> list[Face]:
    """The connected faces among the points labelled PLATFORM that are large enough, and the treads of a flight of
    stairs, the largest first. Levelled."""
    index = np.flatnonzero(labels == Label.PLATFORM)
    regions = [index[part] for part in connected(cloud.points[index], max(JOIN, 2 * cloud.voxel))]
    parts = [region[part] for region in regions for part in split(cloud.points[region], cloud.voxel)]
    parts = [p for p in parts if large(cloud.points[p, :2], cloud.voxel) and _level(cloud.points[p])]
    taken = np.unique(np.concatenate(parts)) if parts else np.zeros(0, np.intp)
    faces = [_face(cloud.take(p)) for p in parts]
    faces += [_face(cloud.take(t.points), t.outline) for t in treads(cloud) if not np.isin(t.points, taken).any()]
    return sorted(faces, key=lambda f: -f.area)


def _level(points: F64) -> bool:
    """Whether a face slopes under a foot as it does as a whole: a ring of tilted tops is level only as a whole."""
    from scipy.spatial import cKDTree

    whole, _ = plane_of(points)
    tree = cKDTree(points[:, :2])
    under = tree.query_ball_point(points[:: max(1, len(points) // 50), :2], FOOT)
    turned = [np.hypot(*(plane_of(points[near])[0] - whole)) for near in under if len(near) > 10]
    return bool(np.degrees(np.arctan(np.median(turned))) < LEVEL_DEG)


def to_platform(face: Face, T_sim_level: F64, role: str = "platform") -> Platform:
    """A face as a `Platform` in the simulation frame (a rotation about z and a translation away)."""
    outline = transform(T_sim_level, np.column_stack([face.outline, np.zeros(len(face.outline))]))[:, :2]
    centroid = transform(T_sim_level, np.array([*face.centroid, face.height]))
    along, across, yaw = oriented_extent(outline)
    return Platform(centroid, np.array([along, across, face.height]), yaw, face.area, outline, role, face.inferred)


def oriented_extent(outline: F64) -> tuple[float, float, float]:
    """Long side, short side (metres) and direction of the long side (radians in (-pi/2, pi/2]) of the least box."""
    best = (np.inf, 0.0, 0.0, 0.0)
    for edge in np.roll(outline, -1, 0) - outline:
        if np.hypot(*edge) < 1e-6:
            continue
        yaw = float(np.arctan2(edge[1], edge[0]))
        along = float(np.ptp(outline @ [np.cos(yaw), np.sin(yaw)]))
        across = float(np.ptp(outline @ [-np.sin(yaw), np.cos(yaw)]))
        if along * across < best[0] - 1e-9:
            best = (along * across, along, across, yaw)
    _, along, across, yaw = best
    if across > along:
        along, across, yaw = across, along, yaw + np.pi / 2
    yaw = (yaw + np.pi / 2) % np.pi - np.pi / 2
    return float(along), float(across), float(yaw)


def polygon_area_centroid(outline: F64) -> tuple[float, F64]:
    """Area and centroid (2,) of a simple polygon (K, 2) (shoelace formula)."""
    p, q = outline - outline[0], np.roll(outline, -1, 0) - outline[0]
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = 0.5 * float(cross.sum())
    return abs(area), outline[0] + ((p + q) * cross[:, None]).sum(0) / (6 * area)


def _face(points: Cloud, inferred: F64 | None = None) -> Face:
    """The face of its points, with the outline (K, 2) that was inferred for it, if any."""
    import cv2

    xyz = points.points
    seen = seen_area(xyz[:, :2], points.voxel)
    looks = float(points.weights.sum())
    if inferred is not None:
        outline = _counter_clockwise(inferred)
        area, centroid = polygon_area_centroid(outline)
        return Face(np.zeros(2), float(np.median(xyz[:, 2])), outline, centroid, area, seen, looks, True)
    A = np.column_stack([xyz[:, :2], np.ones(len(xyz))])
    slope_x, slope_y, height = np.linalg.lstsq(A, xyz[:, 2], rcond=None)[0]
    hull = cv2.convexHull(xyz[:, :2].astype(np.float32))[:, 0].astype(np.float64)
    box = cv2.boxPoints(cv2.minAreaRect(xyz[:, :2].astype(np.float32))).astype(np.float64)
    rectangle = polygon_area_centroid(hull)[0] > 0.9 * polygon_area_centroid(box)[0]
    outline = _counter_clockwise(box if rectangle else hull)
    area, centroid = polygon_area_centroid(outline)
    slope = np.array([slope_x, slope_y])
    return Face(slope, float(slope @ centroid + height), outline, centroid, area, seen, looks)


def _counter_clockwise(outline: F64) -> F64:
    edge = np.roll(outline, -1, 0) - outline
    turn = (outline[:, 0] * edge[:, 1] - outline[:, 1] * edge[:, 0]).sum()
    return outline if turn > 0 else outline[::-1]
