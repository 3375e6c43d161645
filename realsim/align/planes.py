"""Large planes of a cloud: RANSAC over normal-gated regions, then robust PCA."""

from dataclasses import dataclass

import numpy as np

from realsim.align.cloud import Cloud
from realsim.align.faces import seen_area
from realsim.core.geometry import fit_plane
from realsim.core.types import F64, Bool

GATE_COS = np.cos(np.radians(20.0))
"""A plane's inliers have normals within this angle of its own: a voxel's normal is good to about 10 degrees."""
TOLERANCE = 0.03
"""Metres from the plane while searching; the fit then narrows it to the noise."""
CELL = 0.10
"""Metres: extent is counted in occupied cells of this size, so dense and sparse regions count alike."""
SEARCHED = 20_000
"""Points on which hypotheses are scored."""
HYPOTHESES = 200


@dataclass(frozen=True)
class Plane:
    """n·x + offset = 0, seen from the side that n points to."""

    normal: F64
    """(3,) unit, the source's world."""
    offset: float
    inliers: Bool
    """(M,) which points of the cloud lie on it."""
    rms: float
    """Metres, weighted, of the inliers."""
    area: float
    """m^2 that the inliers cover."""

    def height(self, points: F64) -> F64:
        """(M,) signed distances of points (M, 3), metres."""
        return points @ self.normal + self.offset


def find_planes(cloud: Cloud, seed: int, least_area: float = 0.3, most: int = 8) -> list[Plane]:
    """The planes of a cloud, the most extended first.

    A hypothesis is three points whose normals agree (Fischler & Bolles 1981; gating by normals keeps a slab through
    clutter from passing for a plane). The inliers of each plane found are taken away before the next is sought.
    """
    rng = np.random.default_rng(seed)
    pool = np.arange(len(cloud))
    if len(pool) > SEARCHED:
        pool = np.sort(rng.choice(pool, SEARCHED, replace=False))
    planes: list[Plane] = []
    while len(planes) < most and len(pool) > 50:
        guess = _best_hypothesis(cloud, pool, rng)
        if guess is None:
            break
        plane = refine(cloud, *guess)
        support = plane.inliers[pool].sum()
        # The whole slab goes, whatever its normals: the noisy far end of a floor would be found again and again.
        near = np.abs(plane.height(cloud.points[pool])) < 2 * TOLERANCE
        if cloud.closed:  # except the other face of a thin slab
            near &= cloud.normals[pool] @ plane.normal > -0.5
        pool = pool[~near]
        if support < 30:
            if not near.any():
                break
            continue
        if plane.area < least_area:
            if planes or len(pool) < 100:
                break
            continue
        if not any(_same(plane, other, cloud) for other in planes):
            planes.append(plane)
    return sorted(planes, key=lambda p: -p.area)


def refine(cloud: Cloud, normal: F64, offset: float, tolerance: float = TOLERANCE, rounds: int = 8) -> Plane:
    """Weighted PCA on the inliers, repeated with a band that narrows to three times their robust deviation."""
    band = tolerance
    weights = plane_weights(cloud)
    cosine = cloud.normals @ normal
    gate = (cosine if cloud.oriented else np.abs(cosine)) > GATE_COS
    for _ in range(rounds):
        inliers = gate & (np.abs(cloud.points @ normal + offset) < band)
        if inliers.sum() < 10:
            break
        new, offset, _ = fit_plane(cloud.points[inliers], weights[inliers])
        normal, offset = (new, offset) if new @ normal > 0 else (-new, -offset)
        residual = cloud.points[gate] @ normal + offset
        residual = residual[np.abs(residual) < tolerance]
        if len(residual) > 10:
            band = float(np.clip(3 * 1.4826 * np.median(np.abs(residual)), 0.004, tolerance))
    height = cloud.points @ normal + offset
    inliers = gate & (np.abs(height) < band)
    w = weights[inliers]
    rms = float(np.sqrt((w * height[inliers] ** 2).sum() / w.sum())) if w.sum() > 0 else float("nan")
    return Plane(normal, float(offset), inliers, rms, seen_area(cloud.points[inliers] @ plane_axes(normal).T, CELL))


def plane_weights(cloud: Cloud) -> F64:
    """(M,) weights of voxels in a plane fit.

    Noise of a voxel falls with what it has seen, but not below what poses and the sensor's own pattern leave, which
    more pixels do not average away: the weight saturates, and a well-seen near corner does not decide the tilt alone.
    """
    typical = np.median(cloud.weights)
    return cloud.weights / (cloud.weights + typical)


def plane_axes(normal: F64) -> F64:
    """(2, 3) orthonormal directions in the plane."""
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u)])


def _same(a: Plane, b: Plane, cloud: Cloud) -> bool:
    """Whether two planes are one surface: nearly parallel, and the smaller's points lie near the other."""
    if a.normal @ b.normal < GATE_COS:
        return False
    return bool(np.median(np.abs(b.height(cloud.points[a.inliers]))) < 2 * TOLERANCE)


def _best_hypothesis(cloud: Cloud, pool: np.ndarray, rng: np.random.Generator) -> tuple[F64, float] | None:
    """The plane through three agreeing points that covers the most cells, scored by inlier count."""
    points, normals = cloud.points[pool], cloud.normals[pool]
    best, best_count = None, 0
    square = (points**2).sum(1)
    for seed_point in rng.integers(0, len(pool), HYPOTHESES):
        here, facing = points[seed_point], normals[seed_point]
        cosine = normals @ facing
        slab = np.abs(points @ facing - here @ facing)
        distance = np.sqrt(np.maximum(square - 2 * points @ here + here @ here, 0))
        agree = np.abs(cosine) > GATE_COS if not cloud.oriented else cosine > GATE_COS
        region = np.flatnonzero(agree & (slab < TOLERANCE + 0.2 * distance))
        if len(region) < 3:
            continue
        a, b = points[rng.choice(region, 2)]
        n = np.cross(a - points[seed_point], b - points[seed_point])
        length = np.linalg.norm(n)
        if length < 0.05**2:
            continue
        n /= length
        n = n if n @ normals[seed_point] > 0 else -n
        d = -float(n @ points[seed_point])
        facing = normals @ n
        count = int(
            np.count_nonzero(
                (np.abs(points @ n + d) < TOLERANCE) & ((facing if cloud.oriented else np.abs(facing)) > GATE_COS)
            )
        )
        if count > best_count:
            best, best_count = (n, d), count
    return best
