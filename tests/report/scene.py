"""A small reconstruction made by hand: two platforms on a floor, three views, a compiled scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from realsim.core.types import (
    AlignedScene,
    Dropped,
    Frame,
    FrameSet,
    Gravity,
    Intrinsics,
    MeshQuality,
    MetricScene,
    Platform,
    Pointmaps,
    PointView,
    Reconstruction,
    ScaleEstimate,
    Scan,
    SceneFiles,
    StageTime,
    TerrainMesh,
    ViewResidual,
)
from realsim.synth.camera import look_at
from realsim.synth.solids import box

XML = """<mujoco><worldbody>
<geom name="a" type="box" pos="0 0 -0.175" size="0.45 0.4 0.175"/>
<geom name="b" type="box" pos="3 0 -0.175" size="0.45 0.4 0.175"/>
<geom name="floor" type="plane" pos="0 0 -0.35" size="5 5 1"/>
</worldbody></mujoco>"""


def reconstruction(folder: Path, *, warnings: tuple[str, ...] = (), scan: bool = False) -> Reconstruction:
    """The scene is written to `folder`."""
    (folder / "scene.xml").write_text(XML)
    camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    color = np.full((48, 64, 3), (90, 140, 60), np.uint8)
    frames = tuple(
        Frame(f"{i:06d}", camera, lambda: np.ones((48, 64), np.float32), lambda: color, files=()) for i in range(5)
    )
    poses = np.stack([look_at(np.array([-1.0 + i, -1.0, 1.2]), np.array([1.0 + i, 0.0, -0.3])) for i in range(5)])

    def load(i: int) -> PointView:
        mask = np.ones((48, 64), bool)
        return PointView(camera.rays(), mask.astype(np.float32), mask, color)

    source = FrameSet(
        frames, folder / "some_capture", "plain", assumptions=("depth is in millimetres",), warnings=warnings
    )
    scale = ScaleEstimate(1.001, (0.999, 1.003), (1.0, 1.001, 1.003, 1.0, 1.002), 0.001, "median")
    dropped = (Dropped("000009", "blurred <b>"),)
    metric = MetricScene(frames, poses, load, scale, "rgbd", True, depth_gain=0.995, dropped=dropped)
    mesh, platforms = _mesh(), (_platform(0.0, "start"), _platform(3.0, "goal"))
    bounds = np.array([[-1.0, -1.0, -0.4], [4.0, 1.0, 0.3]])
    gravity = Gravity(np.array([0, 0, 1.0]), 0.35, 0.05, 0.002, 5000, "planes")
    aligned = AlignedScene(np.eye(4), gravity, -0.35, platforms, bounds, metric=metric, cropped=("walls",))
    points: Pointmaps | None = Pointmaps(frames, poses, load, "rgbd", True, depth_gain=0.995)
    contact = {"representation": "boxes", "geoms": {"box": 2}}
    checks = {"drops": [{"platform": "start", "object": "box", "error_m": 0.0005}]}
    paths = [folder / name for name in ("scene.xml", "mesh.ply", "mesh.glb")]
    files = SceneFiles(folder, *paths, contact=contact, checks=checks)
    stages = (StageTime("capture", 0.5, 210.0), StageTime("mesh", 2.5, 640.0, reused=True))
    result = Reconstruction(source, points, aligned, mesh, files, stages, 0, {"scale": {"warn_spread": 0.05}})
    if not scan:
        return result
    cloud = Scan(folder / "room.ply", "ply", mesh.vertices, mesh.triangles)
    bare = replace(aligned, metric=None, scan=cloud)
    return replace(result, source=cloud, points=None, aligned=bare, mesh=replace(mesh, residuals=()))


def _platform(x: float, role: str) -> Platform:
    outline = np.array([[-0.45, -0.4], [0.45, -0.4], [0.45, 0.4], [-0.45, 0.4]]) + np.array([x, 0])
    return Platform(np.array([x, 0.0, 0.0]), np.array([0.9, 0.8, 0.35]), 0.0, 0.72, outline, role)


def _mesh() -> TerrainMesh:
    solids = [box(n, (0.9, 0.8, 0.35), "wood").moved(np.eye(3), (x, 0, -0.35)) for n, x in (("a", 0.0), ("b", 3.0))]
    V = np.vstack([s.vertices for s in solids])
    F = np.vstack([s.triangles + 8 * i for i, s in enumerate(solids)]).astype(np.int32)
    residual = ViewResidual("000000", np.full((12, 16), 0.001, np.float32), 0.001)
    quality = MeshQuality(len(V), len(F), True, True, 0, 0, 2, 0.504)
    invented = np.zeros(len(F), bool)
    invented[[0, 6]] = True
    return TerrainMesh(V, F, None, invented, quality, "poisson", 0.01, 0.002, (residual,))
