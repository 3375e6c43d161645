"""One point cloud of the whole scene, small enough to think about: a weighted mean a voxel.

Views are read once, one in memory at a time; the cloud's size depends on the scene, not on the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from realsim.align.winding import inside_out, is_closed, main_direction
from realsim.core.errors import AlignError
from realsim.core.meshes import across, sampled, sum_by_key
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F32, F64, Bool, MetricScene, Scan

VOXEL = 0.02
"""Metres. Means inside a voxel keep positions far more exact than this."""
MERGE_EVERY = 8
"""Frames between two reductions of what has been gathered."""
OCCUPANCY = 3.0
"""Points a voxel that a scan must have on its surfaces; of a sparser one voxels are larger..."""
COARSEST = 0.08
"""...up to this many metres."""
CHUNK = 2_000_000
"""Points of a scan that are reduced at once."""
SCAN_DENSITY = 2e4
"""Points a square metre that are sampled from a mesh, enough for 2 cm voxels..."""
MAX_SAMPLES = 2_000_000
"""...up to this many."""


@dataclass(frozen=True)
class Cloud:
    """Fused points of a scene, the source's own world, metres."""

    points: F64
    """(M, 3) weighted means."""
    normals: F64
    """(M, 3) unit, toward the side that was seen (see `oriented`)."""
    weights: F64
    """(M,) sum of inverse variances relative to a pixel at 1 m; 1 for scans."""
    frames: NDArray[np.int32]
    """(M,) number of frames that saw it; 1 for scans."""
    oriented: bool
    """Whether the normals' signs are known."""
    cameras: F64
    """(N, 4, 4) poses; of a scan, its sensor's position if known (N = 1) or nothing (N = 0)."""
    held: bool
    """Whether the cameras have rotations; scans have none."""
    voxel: float = VOXEL
    turned: bool = False
    """Whether the source's triangles were wound inside out (the normals here are not)."""
    closed: bool = False
    """Whether it is the whole surface of solids: what faces down then lies under something, and is no ground."""

    def __len__(self) -> int:
        return len(self.points)

    def take(self, keep: Bool | NDArray[np.intp]) -> Cloud:
        """The cloud of some of its points."""
        kept = {name: getattr(self, name)[keep] for name in ("points", "normals", "weights", "frames")}
        return replace(self, **kept)


def from_views(scene: MetricScene, voxel: float = VOXEL) -> Cloud:
    """Fuse all views of a metric scene; every second pixel of a row and a column takes part.

    A pixel weighs confidence / z^4: stereo and structured light measure disparity, so the deviation of depth grows
    with z^2. Pixels on a depth edge (flying pixels) are left out.

    Raises:
        AlignError: no view has a usable point.
    """
    anchor = scene.T_world_camera[0, :3, 3]

    def voxels(i: int) -> tuple[NDArray[np.int64], F64]:
        view = scene.load(i)
        z = view.points[..., 2]
        keep = (view.mask & ~depth_edges(z, view.mask))[::2, ::2]
        p = view.points[::2, ::2][keep].astype(np.float64)
        w = view.confidence[::2, ::2][keep] / np.maximum(p[:, 2], 0.1) ** 4
        T = scene.T_world_camera[i]
        world = p @ T[:3, :3].T + T[:3, 3]
        rows = np.empty((len(p), 8))
        rows[:, 0] = w
        rows[:, 1:4] = w[:, None] * world
        rows[:, 4:7] = w[:, None] * T[:3, 3]
        rows[:, 7] = 0
        keys, rows = sum_by_key(_keys(world - anchor, voxel), rows)
        rows[:, 7] = 1  # this frame saw the voxel, however many of its pixels fell into it
        return keys, rows

    gathered: list[tuple[NDArray[np.int64], F64]] = []
    for part in track(in_order(voxels, len(scene)), "fuse", total=len(scene)):
        gathered.append(part)
        if len(gathered) > MERGE_EVERY:
            gathered = [_merged(gathered)]
    _, rows = _merged(gathered)
    rows = rows[rows[:, 0] > 0]
    if len(rows) < 100:
        raise AlignError(
            "no points to align",
            expected="views with valid points",
            found=f"{len(rows)} occupied voxels in {len(scene)} views",
        )
    points, seen_from = rows[:, 1:4] / rows[:, :1], rows[:, 4:7] / rows[:, :1]
    normals = _normals(points, voxel)
    normals *= np.where(np.einsum("ij,ij->i", normals, seen_from - points) < 0, -1.0, 1.0)[:, None]
    return Cloud(points, normals, rows[:, 0], rows[:, 7].astype(np.int32), True, scene.T_world_camera, True, voxel)


def from_scan(scan: Scan, seed: int, voxel: float | None = None) -> Cloud:
    """The same of a scan: a mesh is sampled evenly over its area, a cloud is thinned to a mean a voxel.

    The voxel follows the scan's density if it is not given: surfaces must not fall apart into single points.

    Raises:
        AlignError: fewer than 100 occupied voxels.
    """
    points, normals, turned, closed = scan.points, scan.normals, False, False
    if scan.triangles is not None and len(scan.triangles):
        points, normals = sample_scan(scan.points, scan.triangles, seed)
        turned = inside_out(points, normals, scan.up_world)
        normals = -normals if turned else normals
        closed = is_closed(normals)
        if scan.up_world is not None:
            # The underside of a closed mesh is level too, and as large as its ground; nothing stands on it.
            upper = normals @ scan.up_world > -0.5
            points, normals = points[upper], normals[upper]
    finite = np.isfinite(points).all(1)
    points, normals = points[finite], None if normals is None else normals[finite]
    voxel = voxel or _voxel_for(points)
    anchor = points.mean(0) if len(points) else np.zeros(3)
    # The two faces of a thin slab may share a voxel: of solids, what faces opposite ways is kept apart.
    side = main_direction(normals) if closed and normals is not None and len(normals) else None
    gathered: list[tuple[NDArray[np.int64], F64]] = [(np.zeros(0, np.int64), np.zeros((0, 7)))]
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        rows = np.ones((len(points[part]), 7))
        rows[:, 1:4] = points[part]
        rows[:, 4:7] = 0 if normals is None else normals[part]
        keys = _keys(points[part] - anchor, voxel)
        if side is not None and normals is not None:
            keys = np.where(normals[part] @ side < 0, ~keys, keys)
        gathered = [_merged([*gathered, sum_by_key(keys, rows)])]
    keys, rows = gathered[0]
    if len(rows) < 100:
        raise AlignError(
            "too few points to align",
            file=scan.source,
            expected=f"a surface of at least 100 cells of {100 * voxel:g} cm",
            found=f"{len(rows)}: is the scan in metres?",
        )
    points, given = rows[:, 1:4] / rows[:, :1], rows[:, 4:7]
    found = np.empty_like(points)
    for one in (keys < 0, keys >= 0):
        if one.any():
            found[one] = _normals(points[one], voxel)
    cameras = np.zeros((0, 4, 4))
    if scan.sensor_position is not None:
        cameras = np.eye(4)[None].copy()
        cameras[0, :3, 3] = scan.sensor_position
        found *= np.where(np.einsum("ij,ij->i", found, scan.sensor_position - points) < 0, -1.0, 1.0)[:, None]
    elif normals is not None:
        found *= np.where(np.einsum("ij,ij->i", found, given) < 0, -1.0, 1.0)[:, None]
    oriented = scan.sensor_position is not None or normals is not None
    ones = np.ones(len(points))
    return Cloud(points, found, ones, ones.astype(np.int32), oriented, cameras, False, voxel, turned, closed)


def depth_edges(z: F32, mask: Bool) -> Bool:
    """(H, W) pixels beside a jump in depth, where a sensor mixes near and far.

    Inverse depth is linear over the image of a plane, however grazing, and its noise is the same near and far for a
    disparity sensor. So a second difference of 1/z that is far above its own typical size is an edge.
    """
    inverse = np.where(mask, 1 / np.maximum(z, np.float32(0.05)), np.float32(np.nan))
    bend = np.zeros_like(inverse)
    with np.errstate(invalid="ignore"):
        bend[:, 1:-1] = np.abs(inverse[:, :-2] + inverse[:, 2:] - 2 * inverse[:, 1:-1])
        bend[1:-1] = np.fmax(bend[1:-1], np.abs(inverse[:-2] + inverse[2:] - 2 * inverse[1:-1]))
        sample = bend[::4, ::4]
        sample = sample[sample > 0]
        typical = float(np.median(sample)) if len(sample) else 0.0
        return bend > max(8 * typical, 0.01)


def _keys(offsets: F64, voxel: float) -> NDArray[np.int64]:
    """One integer a voxel, 21 bits an axis: 20 km at 2 cm."""
    cells = np.floor(offsets / voxel).astype(np.int64) + (1 << 20)
    cells = np.clip(cells, 0, (1 << 21) - 1)
    return (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]


def _merged(parts: list[tuple[NDArray[np.int64], F64]]) -> tuple[NDArray[np.int64], F64]:
    return sum_by_key(np.concatenate([k for k, _ in parts]), np.concatenate([r for _, r in parts]))


def _voxel_for(points: F64) -> float:
    """Metres: `VOXEL`, or what holds `OCCUPANCY` points of a surface as dense as this cloud's median."""
    from scipy.spatial import cKDTree

    if len(points) < 100:
        return VOXEL
    some = points[np.linspace(0, len(points) - 1, min(len(points), 2000)).astype(int)]
    sixth = cKDTree(points).query(some, k=7)[0][:, 6]
    # Six neighbours on the disc that reaches to the sixth.
    each = float(np.median(np.pi * sixth**2 / 6))
    return float(np.clip(np.sqrt(OCCUPANCY * each), VOXEL, COARSEST))


def _normals(points: F64, voxel: float) -> F64:
    """(M, 3) unit normals of the surface through each point's neighbours, of arbitrary sign."""
    from realsim.core.open3d import o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=3.0 * voxel, max_nn=24))
    return np.asarray(cloud.normals).copy()


def sample_scan(vertices: F64, triangles: NDArray[np.int32], seed: int) -> tuple[F64, F64]:
    """Points spread evenly over a mesh, and the normals of their triangles."""
    normals = across(vertices, triangles)
    length = np.linalg.norm(normals, axis=1)
    count = int(np.clip(length.sum() / 2 * SCAN_DENSITY, 1000, MAX_SAMPLES))
    points, chosen = sampled(vertices, triangles, count, np.random.default_rng(seed))
    return points, normals[chosen] / np.maximum(length[chosen, None], 1e-15)
