"""Types passed between stages: frozen dataclasses; every field states its shape, unit and frame.

`FrameSet -> Pointmaps (up to scale) -> MetricScene -> AlignedScene -> TerrainMesh -> SceneFiles`.

Points up to scale and points in metres are different types: what is not metric cannot be aligned, meshed or exported.
Images are read when they are requested, so a thousand frames cost no more memory than ten.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import outside_hull, pixel_rays
from realsim.core.ordered import in_order

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]
MjModel: TypeAlias = Any
MjData: TypeAlias = Any
MjSpec: TypeAlias = Any
"""MuJoCo's, which has no types for a checker."""
HALF_WAY = 0.5
"""Metres to either side of the line from start to goal: half of what a humanoid takes up, and a stride's sway."""


# ---------------------------------------------------------------- capture


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera; the centre of the first pixel is (0, 0), lengths in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def K(self) -> F64:
        """The 3x3 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def rays(self) -> F32:
        """(H, W, 3) directions with z = 1 through the pixel centres, camera frame."""
        return pixel_rays(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def pixels(self, points: F64, near: float = 0.0) -> tuple[NDArray[np.int64], NDArray[np.int64], Bool]:
        """Row and column (M,) of the pixel nearest to where each point (M, 3), camera frame, projects, 0 outside the
        image, and which are in it and more than `near` metres in front of the camera."""
        z = np.where(points[:, 2] > near, points[:, 2], 1)
        column, row = np.rint(points[:, 0] / z * self.fx + self.cx), np.rint(points[:, 1] / z * self.fy + self.cy)
        inside = (points[:, 2] > near) & (column >= 0) & (row >= 0) & (column < self.width) & (row < self.height)
        return np.where(inside, row, 0).astype(np.int64), np.where(inside, column, 0).astype(np.int64), inside

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same camera sampled on another grid. The image borders, not the pixel centres, stay in place."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(
            width, height, self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        )


@dataclass(frozen=True)
class Frame:
    """One view. `depth()` and `color()` read from disk each time they are called."""

    name: str
    """Stable name, unique in its capture (usually the file stem)."""
    intrinsics: Intrinsics
    """Camera of the depth image."""
    read_depth: Callable[[], F32]
    """() -> (H, W) float32 depth along z in metres, 0 where invalid."""
    read_color: Callable[[], U8] | None = None
    """() -> (h, w, 3) uint8 RGB, or None for a capture without colour. May be of another size than the depth."""
    color_intrinsics: Intrinsics | None = None
    """Camera of the colour image (same viewing direction); `intrinsics` if None."""
    read_confidence: Callable[[], F32] | None = None
    """() -> (H, W) float32 in 0..1, the sensor's own confidence, or None."""
    T_world_camera: F64 | None = None
    """(4, 4) camera to capture world, OpenCV camera axes, or None where unknown."""
    timestamp: float | None = None
    """Seconds, or None."""
    files: tuple[Path, ...] = ()
    """Files that this frame is read from; their content identifies it."""
    color_shift: tuple[float, float] = (0.0, 0.0)
    """Metres that the colour camera stands right of and below the depth camera."""

    def depth(self) -> F32:
        """(H, W) float32 metres, 0 where invalid."""
        return self.read_depth()

    def color(self) -> U8 | None:
        """(h, w, 3) uint8 RGB at its own size, or None."""
        return None if self.read_color is None else self.read_color()

    def with_pose(self, T_world_camera: F64 | None) -> Frame:
        """The same frame at another pose."""
        return replace(self, T_world_camera=T_world_camera)


@dataclass(frozen=True)
class Dropped:
    """A frame that is not used, and why."""

    name: str
    reason: str
    lost: bool = True
    """False where nothing is wrong with the frame: enough others show the same."""


@dataclass(frozen=True, repr=False)
class FrameSet:
    """A capture as read: the frames, and everything that was assumed on the way."""

    frames: tuple[Frame, ...]
    source: Path
    layout: str
    """Name of the capture layout that recognised it."""
    poses_metric: bool = True
    """Whether given poses are in metres (COLMAP poses are not). Meaningless without poses."""
    up_world: F64 | None = None
    """(3,) unit direction against gravity in the capture world where the source knows it (ARKit), else None."""
    assumptions: tuple[str, ...] = ()
    """Every convention that was assumed, one sentence each."""
    warnings: tuple[str, ...] = ()
    dropped: tuple[Dropped, ...] = ()
    sensor_sigma: float = 0.006
    """Relative standard error of the depth sensor's own scale, before anything was seen."""

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        poses = "with" if self.has_poses else "without"
        return f"FrameSet({str(self.source)!r}, {self.layout}, {len(self)} frames {poses} poses)"

    @property
    def has_poses(self) -> bool:
        """Whether every frame has a pose."""
        return bool(self.frames) and all(f.T_world_camera is not None for f in self.frames)

    @property
    def has_color(self) -> bool:
        return bool(self.frames) and all(f.read_color is not None for f in self.frames)


@dataclass(frozen=True)
class Scan:
    """A finished surface from elsewhere (LiDAR cloud, phone mesh, hand-made mesh), in metres; enters at `align`."""

    source: Path
    layout: str
    points: F64
    """(M, 3) metres, the source's own world."""
    triangles: NDArray[np.int32] | None = None
    """(K, 3) indices into points for a mesh, None for a cloud."""
    normals: F64 | None = None
    """(M, 3) unit, pointing out of the surface toward the sensor, or None."""
    colors: U8 | None = None
    """(M, 3) RGB or None."""
    sensor_position: F64 | None = None
    """(3,) where the scanner stood, or None."""
    up_world: F64 | None = None
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


# ---------------------------------------------------------------- points


@dataclass(frozen=True)
class PointView:
    """Points of one view on its pixel grid."""

    points: F32
    """(H, W, 3) camera frame."""
    confidence: F32
    """(H, W) 0..1."""
    mask: Bool
    """(H, W) which pixels hold a point."""
    color: U8 | None = None
    """(H, W, 3) RGB on the same grid, or None."""


@dataclass(frozen=True)
class Pointmaps:
    """Pointmaps and poses with one unknown scale for all views. Nothing downstream of `scale` accepts this type."""

    frames: tuple[Frame, ...]
    """The N frames used, in order; their own `T_world_camera` is what was given, not what was found."""
    T_world_camera: F64
    """(N, 4, 4) as found, up to scale."""
    load: Callable[[int], PointView]
    """i -> points of view i, camera frame, up to scale. May read or compute at each call; not to be written into."""
    backend: str
    world_is_capture: bool
    """True if the world of the poses is that of the given poses, False if it was chosen by the backend."""
    metric_claim: float | None = None
    """The model's own claim of metres per unit, or None. Recorded, never trusted."""
    depth_gain: float = 1.0
    """Factor that turns sensor depth into true depth, as recovered from multi-view consistency (1: not corrected)."""
    depth_gain_sigma: float | None = None
    """Standard error of `depth_gain`, or None where it was not estimated."""
    pose_sigma_m: float | None = None
    """Typical residual between views after registration, metres (or units), or None."""
    dropped: tuple[Dropped, ...] = ()
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    """JSON-able figures of the backend for the report; `left_out`: sentences on what of the frames is not used."""

    def __len__(self) -> int:
        return len(self.frames)


@dataclass(frozen=True)
class Solution:
    """Solution of a backend as plain arrays: small enough to cache, and sufficient to make `Pointmaps` again."""

    used: tuple[int, ...]
    """Indices into `FrameSet.frames` of the N frames used, in order."""
    T_world_camera: F64
    """(N, 4, 4) up to scale."""
    world_is_capture: bool
    depth_gain: float = 1.0
    depth_gain_sigma: float | None = None
    pose_sigma_m: float | None = None
    metric_claim: float | None = None
    dropped: tuple[Dropped, ...] = ()
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    """JSON-able."""
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Whatever else the backend needs to load a view (predicted depth, confidence)."""


@dataclass(frozen=True)
class ScaleEstimate:
    """Metres per unit of the pointmaps."""

    value: float
    ci90: tuple[float, float]
    """90 percent interval: the frames' bootstrap, widened by what is not known of the sensor's own scale."""
    per_frame: tuple[float, ...]
    """One ratio a frame used, in the order of the frames; NaN where a frame had too few pixels."""
    per_frame_spread: float
    """Robust relative spread of the ratios (1.4826 MAD / median)."""
    method: str
    warnings: tuple[str, ...] = ()
    sensor_sigma: float = 0.0
    """Relative standard error of the depth sensor's own scale (after correction), as it entered the interval."""


@dataclass(frozen=True)
class MetricScene:
    """Pointmaps and poses in metres, world as in the capture (or as chosen by the backend)."""

    frames: tuple[Frame, ...]
    T_world_camera: F64
    """(N, 4, 4) metres."""
    load: Callable[[int], PointView]
    """i -> points of view i, camera frame, metres."""
    scale: ScaleEstimate
    backend: str
    world_is_capture: bool
    up_world: F64 | None = None
    """(3,) a hint from the source, or None; None too where the world was chosen by the backend."""
    depth_gain: float = 1.0
    dropped: tuple[Dropped, ...] = ()
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frames)

    def views(self) -> Iterator[tuple[int, PointView]]:
        """All views in order, a few in memory at a time."""
        yield from enumerate(in_order(self.load, len(self.frames)))


# ---------------------------------------------------------------- align


@dataclass(frozen=True)
class Platform:
    """A connected, level top face, in the simulation frame."""

    centroid: F64
    """(3,) metres, area centroid of the top face."""
    size: F64
    """(3,) metres: extent along the face's long side, across it, and height above the ground."""
    yaw: float
    """Radians, direction of the long side about z."""
    area: float
    """m^2 of the top face."""
    outline: F64
    """(M, 2) convex outline of the top face, x y metres."""
    role: str = "platform"
    """`start`, `goal` or `platform`."""
    inferred: bool = False
    """Whether its top was not seen, or only in part: a tread of which only the front edge was."""


def platform_names(platforms: Iterable[Platform]) -> list[str]:
    """`start`, `goal`, and `platform_0`, `platform_1`, ... for the others, in their order."""
    names, others = [], 0
    for platform in platforms:
        names.append(platform.role if platform.role in ("start", "goal") else f"platform_{others}")
        others += platform.role not in ("start", "goal")
    return names


@dataclass(frozen=True)
class Gravity:
    """The ground plane and how well it is known."""

    normal_world: F64
    """(3,) unit, against gravity, capture world."""
    offset_world: float
    """n·x + offset = 0 on the ground, metres, capture world."""
    tilt_sigma_deg: float
    inlier_rms_m: float
    inliers: int
    method: str


@dataclass(frozen=True)
class AlignedScene:
    """A scene in the simulation frame: origin at the centroid of the start platform's top, z up, x toward the goal.

    Exactly one of `metric` (views) and `scan` is set.
    """

    T_sim_world: F64
    """(4, 4) rigid, capture world in metres to simulation frame."""
    gravity: Gravity
    ground_z: float
    """z of the ground in the simulation frame."""
    platforms: tuple[Platform, ...]
    """All that were found, simulation frame; start and goal carry their role."""
    bounds: F64
    """(2, 3) lower and upper corner of what is kept, simulation frame."""
    metric: MetricScene | None = None
    scan: Scan | None = None
    """Points still in the source's own world: apply T_sim_world."""
    cropped: tuple[str, ...] = ()
    """Surface that was cut away, in words."""
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def platform(self, role: str) -> Platform | None:
        """The platform of that role, or None."""
        return next((p for p in self.platforms if p.role == role), None)

    def on_way(self, xy: F64) -> Bool | None:
        """(M,) which points (M, 2) lie where the robot goes: within HALF_WAY of the hull of start (the origin, if it is
        on the ground) and goal. None without a goal: then nobody knows where it goes."""
        start, goal = self.platform("start"), self.platform("goal")
        if goal is None:
            return None
        return (
            outside_hull(np.concatenate([goal.outline, [[0.0, 0.0]] if start is None else start.outline]), xy)
            < HALF_WAY
        )

    def T_sim_camera(self, i: int) -> F64:
        """(4, 4) pose of view i in the simulation frame."""
        if self.metric is None:
            raise ValueError("a scan has no cameras")
        return self.T_sim_world @ self.metric.T_world_camera[i]


# ---------------------------------------------------------------- mesh


@dataclass(frozen=True)
class MeshQuality:
    """Checks of a triangle mesh."""

    vertices: int
    triangles: int
    watertight: bool
    manifold: bool
    self_intersections: int
    degenerate: int
    components: int
    volume_m3: float | None
    """Of a watertight mesh, else None."""


@dataclass(frozen=True)
class ViewResidual:
    """Distance of a view's depth from the mesh, for the report."""

    name: str
    image: F32
    """(h, w) metres, measured minus mesh along the ray, NaN where either is missing; a thumbnail of the view's grid."""
    median_abs_m: float


@dataclass(frozen=True)
class TerrainMesh:
    """The surface in the simulation frame, metres, triangles counter-clockwise seen from outside."""

    vertices: F64
    """(V, 3)."""
    triangles: NDArray[np.int32]
    """(K, 3)."""
    colors: U8 | None
    """(V, 3) RGB or None."""
    invented: Bool
    """(K,) triangles that no camera saw (filled holes, skirt, bottom)."""
    quality: MeshQuality
    method: str
    resolution: float
    """Metres: the voxel or octree cell that was used."""
    noise_m: float | None = None
    """Estimated noise of the points about the surface, metres."""
    residuals: tuple[ViewResidual, ...] = ()
    """A few views, evenly spread; empty for scans."""
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    inferred: Bool | None = None
    """(K,) those of the invented triangles that are tops of inferred platforms; None if there are none."""

    @property
    def seen(self) -> NDArray[np.int32]:
        """(S, 3) the triangles that were measured."""
        return self.triangles[~self.invented]

    @property
    def carrying(self) -> NDArray[np.int32]:
        """(S, 3) the triangles that things touch: those that were measured, and tops of inferred platforms."""
        return self.seen if self.inferred is None else self.triangles[~self.invented | self.inferred]


# ---------------------------------------------------------------- scene on disk


@dataclass(frozen=True)
class SceneFiles:
    """An exported scene that has been compiled, stepped and checked."""

    folder: Path
    scene_xml: Path
    mesh_ply: Path
    mesh_glb: Path
    contact: Mapping[str, Any] = field(default_factory=dict)
    """Content of `contact` in report.json."""
    checks: Mapping[str, Any] = field(default_factory=dict)
    """Results of the physics checks: dropped objects and steps."""
    contact_map: F64 | None = None
    """(N, 3) x y of balls lowered on the terrain, simulation frame, and signed error at first touch (positive:
    phantom surface), metres; for the report's heat map."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class StageTime:
    """Time and memory of a stage."""

    name: str
    seconds: float
    peak_mb: float
    """Peak resident memory of the process up to the end of the stage."""
    reused: bool = False
    """True if the result was taken from an earlier run with the same inputs."""


@dataclass(frozen=True)
class Mode:
    """The same capture up to the mesh by one source of points, for comparison. Lengths in metres."""

    backend: str
    error: str | None = None
    """Why it cannot, or None; then the figures below are there."""
    scale: float = float("nan")
    """Metres per unit of its points (each source has units of its own)."""
    scale_ci90: tuple[float, float] = (float("nan"), float("nan"))
    """Relative to `scale`."""
    used: int = 0
    dropped: int = 0
    pose_sigma_m: float | None = None
    depth_to_mesh_m: float | None = None
    """Median over views of the median distance of the measured depth from the mesh."""
    seen_m2: float = float("nan")
    """Area of the surface that was measured or completed, without what closes it."""
    start_to_goal_m: float | None = None
    apart_m: float | None = None
    """Median distance of its surface from the delivered one, both in their simulation frames; None for that one."""
    seconds: float = float("nan")


@dataclass(frozen=True)
class Reconstruction:
    """Everything one run found; what the report is made from."""

    source: FrameSet | Scan
    points: Pointmaps | None
    """None for scans."""
    aligned: AlignedScene
    mesh: TerrainMesh
    scene: SceneFiles
    stages: tuple[StageTime, ...]
    seed: int
    config: Mapping[str, Any] = field(default_factory=dict)
    """The configuration that was used, JSON-able."""
    modes: tuple[Mode, ...] = ()
    """The delivered source of points and the others, where a comparison was requested; the delivered one first."""
    changes: Mapping[str, Any] | None = None
    """What is otherwise than in an earlier scene (`realsim.changes.since`), where one was given."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """All stages' warnings in order, each once."""
        parts = [self.source.warnings, self.points.warnings if self.points else ()]
        if self.aligned.metric is not None:
            parts += [self.aligned.metric.scale.warnings, self.aligned.metric.warnings]
        parts += [self.aligned.warnings, self.mesh.warnings, self.scene.warnings]
        return tuple(dict.fromkeys(w for part in parts for w in part))
