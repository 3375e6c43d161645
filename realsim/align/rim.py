"""Where a top face ends, to the millimetre: a second look at the pixels around its edges.

The extent of a point cloud is a poor measure of a face: sparse flying pixels enlarge it and uneven sampling shifts its
mean. Two things are unbiased. Where the side below an edge is seen, its points gather at the edge's own distance
whatever the depth noise. Where it is not (the edge hides what is behind), each pixel's ray crosses the face's plane at
some place and its depth says whether there was a face to stop it: the edge is where half of the rays pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from realsim.align.cloud import depth_edges
from realsim.align.platforms import Face, polygon_area_centroid
from realsim.core.geometry import invert_T, transform
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F64, Intrinsics, MetricScene, PointView

REACH, BIN = 0.10, 0.001
"""Metres about the first guess of an edge within which it is sought, and the resolution of the votes."""
SECTIONS = 8
"""An edge is located in this many sections, and a line is fitted to them."""
LEAST_EDGE = 0.12
"""Metres: shorter edges of an outline stay as they are."""
SIDE = (-0.12, -0.025)
"""Metres below the face: the part of a side that is used, below the bevel."""
PIXELS = 60_000
"""A larger part of an image is thinned to between a quarter of this and this many pixels."""
BINS = round(2 * REACH / BIN)
CENTRES = (np.arange(BINS) + 0.5) * BIN - REACH


@dataclass
class Votes:
    """Evidence of pixels about the edges of one face: histograms over the distance outward from the first guess."""

    stopped: F64
    """(E, SECTIONS, BINS) weights of rays that the face stopped."""
    passed: F64
    """Of rays that went past it."""
    sides: F64
    """Of points on the side below the edge."""

    @classmethod
    def empty(cls, edges: int) -> Votes:
        return cls(*(np.zeros((edges, SECTIONS, BINS)) for _ in range(3)))

    def add(self, other: Votes) -> None:
        """Take in another view's."""
        self.stopped[...] += other.stopped
        self.passed[...] += other.passed
        self.sides[...] += other.sides


def refined(faces: list[Face], scene: MetricScene, T_level_world: F64) -> list[Face]:
    """Faces (levelled frame) with their outlines moved to where the views see the edges. Views are read once."""
    if not faces:
        return faces

    def seen(i: int) -> list[Votes | None]:
        view, T = scene.load(i), T_level_world @ scene.T_world_camera[i]
        windows = [_window(face, T, scene.frames[i].intrinsics, view.mask.shape) for face in faces]
        return [None if w is None else _votes(face, T, view, w) for face, w in zip(faces, windows, strict=True)]

    votes = [Votes.empty(len(face.outline)) for face in faces]
    for more in track(in_order(seen, len(scene)), "edges of platforms", total=len(scene)):
        for counted, new in zip(votes, more, strict=True):
            if new is not None:
                counted.add(new)
    return [
        moved(face, [located(counted, e) for e in range(len(face.outline))])
        for face, counted in zip(faces, votes, strict=True)
    ]


def _window(face: Face, T: F64, camera: Intrinsics, shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """The part of the image that can show the face's rim; None if it is out of view, seen from below, or
    inferred."""
    if face.inferred or T[2, 3] < face.height + 0.1:
        return None
    grown = face.centroid + (face.outline - face.centroid) * (1 + 2 * REACH / np.sqrt(face.area))
    corners = transform(invert_T(T), np.column_stack([grown, np.full(len(grown), face.height)]))
    if (corners[:, 2] < 0.1).all():
        return None
    z = np.maximum(corners[:, 2], 0.1)
    scale = shape[1] / camera.width
    u = (corners[:, 0] / z * camera.fx + camera.cx) * scale
    v = (corners[:, 1] / z * camera.fy + camera.cy) * scale
    left, right = int(np.clip(u.min(), 0, shape[1])), int(np.clip(u.max() + 1, 0, shape[1]))
    top, bottom = int(np.clip(v.min(), 0, shape[0])), int(np.clip(v.max() + 1, 0, shape[0]))
    if right - left < 8 or bottom - top < 8:
        return None
    return slice(top, bottom), slice(left, right)


def _votes(face: Face, T: F64, view: PointView, window: tuple[slice, slice]) -> Votes | None:
    """Of one view's pixels for the rim of a face; None if it hardly saw the face."""
    pixels, mask = view.points[window], view.mask[window]
    edges = depth_edges(pixels[..., 2], mask)
    stride = 1 + int(np.sqrt(mask.size / PIXELS))
    mask = mask[::stride, ::stride]
    camera_points = pixels[::stride, ::stride][mask].astype(np.float64)
    flying = edges[::stride, ::stride][mask]
    points, eye = transform(T, camera_points), T[:3, 3]
    over = _over(face, points)
    eye_over = float(_over(face, eye[None])[0])
    descends = eye_over - over > 0.05
    points, over, flying, depth = points[descends], over[descends], flying[descends], camera_points[descends, 2]
    ray = points - eye
    crossing = eye[:2] + (eye_over / (eye_over - over))[:, None] * ray[:, :2]

    a, b = face.outline, np.roll(face.outline, -1, 0)
    lengths = np.linalg.norm(b - a, axis=1)
    along = (b - a) / lengths[:, None]
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    inner = np.all([(crossing - a[e]) @ outward[e] < -0.03 for e in range(len(a))], axis=0) & (np.abs(over) < 0.04)
    if inner.sum() < 100:
        return None
    votes = Votes.empty(len(a))
    # This view's own idea of the face: its height here takes out what pose and sensor pattern add.
    shift = float(np.median(over[inner]))
    over = over - shift
    band = float(np.clip(4 * 1.4826 * np.median(np.abs(over[inner])), 0.006, 0.03))

    for e in range(len(a)):
        if lengths[e] < LEAST_EDGE:
            continue
        facing = ray[:, :2] @ outward[e]
        edge = a[e], along[e], outward[e], float(lengths[e])
        stopped = (facing > 0) & (np.abs(over) <= band)
        passed = (facing > 0) & (over < -band) & ~flying
        side = (facing < 0) & (over > SIDE[0]) & (over < SIDE[1])
        votes.stopped[e] = _histogram(crossing[stopped], depth[stopped] ** -2.0, *edge)
        votes.passed[e] = _histogram(crossing[passed], depth[passed] ** -2.0, *edge)
        votes.sides[e] = _histogram(points[side, :2], depth[side] ** -4.0, *edge)
    return votes


def _histogram(xy: F64, weight: F64, start: F64, along: F64, outward: F64, length: float) -> F64:
    """(SECTIONS, BINS) sums of weights by place along an edge and distance outward from it."""
    offset = xy - start
    s, t = offset @ outward, offset @ along / length
    keep = (np.abs(s) < REACH) & (t > 0.08) & (t < 0.92)
    section = np.clip(((t[keep] - 0.08) / 0.84 * SECTIONS).astype(int), 0, SECTIONS - 1)
    cell = section * BINS + np.clip(((s[keep] + REACH) / BIN).astype(int), 0, BINS - 1)
    return np.bincount(cell, weight[keep], SECTIONS * BINS).reshape(SECTIONS, BINS).astype(np.float64)


def _over(face: Face, points: F64) -> F64:
    """(M,) metres above the face's plane."""
    return points[:, 2] - face.height - (points[:, :2] - face.centroid) @ face.slope


def located(votes: Votes, edge: int) -> F64:
    """(K, 3) rows of (place along the edge 0..1, metres outward of the first guess, weight) for its sections."""
    rows = []
    for k in range(SECTIONS):
        place = 0.08 + 0.84 * (k + 0.5) / SECTIONS
        for found in (_side_at(votes.sides[edge, k]), _crossing_at(votes.stopped[edge, k], votes.passed[edge, k])):
            if found is not None:
                rows.append((place, *found))
                break  # a seen side is the better witness
    return np.array(rows).reshape(-1, 3)


def _side_at(histogram: F64) -> tuple[float, float] | None:
    """Median of the points about the densest 2 cm; None where points do not gather."""
    total = histogram.sum()
    if total <= 0 or np.count_nonzero(histogram) < 5:
        return None
    dense = np.convolve(histogram, np.ones(21), "same")
    peak = int(np.argmax(dense))
    near = slice(max(peak - 15, 0), peak + 16)
    part = np.cumsum(histogram[near])
    if part[-1] < 0.5 * total:
        return None
    return float(np.interp(0.5 * part[-1], part, CENTRES[near] + BIN / 2)), 1.0


def _crossing_at(stopped: F64, passed: F64) -> tuple[float, float] | None:
    """The place with as many stopped rays outside as passed ones inside; None without both kinds."""
    if min(stopped.sum(), passed.sum()) <= 0:
        return None
    wrong = np.r_[0, np.cumsum(passed)] + (stopped.sum() - np.r_[0, np.cumsum(stopped)])
    least = wrong.min()
    if least > 0.25 * min(stopped.sum(), passed.sum()):
        return None
    borders = np.arange(BINS + 1) * BIN - REACH
    return float(borders[wrong <= least * 1.001 + 1e-12].mean()), 1.0


def moved(face: Face, found: list[F64]) -> Face:
    """The face with a line through what was found at each edge; an edge without enough sections stays."""
    a, b = face.outline, np.roll(face.outline, -1, 0)
    lines = []
    for e in range(len(a)):
        along = (b[e] - a[e]) / np.linalg.norm(b[e] - a[e])
        outward = np.array([along[1], -along[0]])
        start, end = _line(found[e])
        lines.append((a[e] + start * outward, b[e] + end * outward))
    corners = [_intersection(lines[e - 1], lines[e]) for e in range(len(lines))]
    if any(c is None for c in corners):
        return face
    outline = np.array(corners)
    if np.linalg.norm(outline - a, axis=1).max() > 2 * REACH:
        return face  # lines that are nearly parallel meet anywhere
    area, centroid = polygon_area_centroid(outline)
    height = face.height + float(face.slope @ (centroid - face.centroid))
    return replace(face, outline=outline, area=area, centroid=centroid, height=height)


def _line(rows: F64) -> tuple[float, float]:
    """Metres outward at both ends of an edge: least squares through its sections, outliers dropped."""
    if len(rows) < 3:
        return (0.0, 0.0) if not len(rows) else (float(np.median(rows[:, 1])),) * 2
    keep = np.abs(rows[:, 1] - np.median(rows[:, 1])) < 0.03
    if keep.sum() < 3:
        return 0.0, 0.0  # the sections contradict each other
    for _ in range(2):
        slope, base = np.polyfit(rows[keep, 0], rows[keep, 1], 1)
        residual = np.abs(rows[:, 1] - base - slope * rows[:, 0])
        keep = residual <= max(3 * 1.4826 * float(np.median(residual)), 0.003)
    return float(base), float(base + slope)


def _intersection(p: tuple[F64, F64], q: tuple[F64, F64]) -> F64 | None:
    """Where the lines through two pairs of points meet."""
    d, e = p[1] - p[0], q[1] - q[0]
    det = d[0] * -e[1] + e[0] * d[1]
    if abs(det) < 1e-3 * np.linalg.norm(d) * np.linalg.norm(e):
        return None
    t = np.linalg.solve(np.column_stack([d, -e]), q[0] - p[0])[0]
    return p[0] + t * d
