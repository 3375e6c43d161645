"""The baseline that sees colour only: structure from motion by COLMAP, up to scale, points only where it has any.

Sensor depth is not used here at all. The scale stage compares it with the triangulated points afterwards; a view's
mask therefore holds a few hundred pixels, not a surface. Needs the extra `colmap`.
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from realsim.core.errors import CaptureError, PoseError, extra
from realsim.core.geometry import invert_T
from realsim.core.types import F64, Dropped, Frame, FrameSet, Intrinsics, PointView, Solution
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig

ALL_PAIRS = 40
"""Up to this many frames every pair is matched; beyond, neighbours in the sequence."""
OVERLAP = 10
"""Number of neighbours."""


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses and points up to scale. Given poses are not used; the camera's intrinsics are kept fixed.

    `arrays` of the result: `point_xyz` (M, 3) float32 points in their view's camera, `point_view` (M,) 0..N-1.

    Raises:
        MissingExtraError: pycolmap is not installed.
        CaptureError: frames without colour.
        PoseError: COLMAP finds no model of two frames or more.
    """
    extra("pycolmap", "colmap", "the backend colmap")
    if not frames.has_color:
        raise CaptureError("the backend colmap needs colour", file=frames.source, hint="use --backend rgbd")
    with TemporaryDirectory(prefix="realsim-colmap-") as folder:
        models = _reconstruct(frames, Path(folder), config.seed)
    if not models:
        raise PoseError(
            "COLMAP found no model",
            file=frames.source,
            expected="textured pictures with parallax between them",
            found=f"{len(frames)} frames that it cannot connect",
            hint="use --backend rgbd, which needs less texture",
        )
    return _solution(frames, max(models, key=lambda m: (m.num_reg_images(), m.num_points3D())))


def load_views(used: tuple[Frame, ...], solution: Solution) -> tuple[tuple[Frame, ...], Callable[[int], PointView]]:
    """Views whose masks hold the pixels of triangulated points."""
    xyz, owner = solution.arrays["point_xyz"], solution.arrays["point_view"]
    return used, lambda i: _view(used[i], xyz[owner == i])


def _reconstruct(frames: FrameSet, folder: Path, seed: int) -> list[Any]:
    """COLMAP's three steps, on one thread: with several its results differ from run to run."""
    import cv2
    import pycolmap

    images, database, out = folder / "images", folder / "database.db", folder / "models"
    images.mkdir()
    out.mkdir()
    pycolmap.set_random_seed(seed)
    extraction = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    matching = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=False)
    for k, frame in enumerate(frames.frames):
        color = frame.color()
        assert color is not None
        cv2.imwrite(str(images / _name(k)), cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
    by_camera: dict[Intrinsics, list[str]] = {}
    for k, frame in enumerate(frames.frames):
        by_camera.setdefault(frame.color_intrinsics or frame.intrinsics, []).append(_name(k))
    for camera, names in by_camera.items():
        # COLMAP puts the centre of the first pixel at (0.5, 0.5).
        text = ",".join(f"{x:.9g}" for x in (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5))
        reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE", camera_params=text)
        pycolmap.extract_features(database, images, names, pycolmap.CameraMode.SINGLE, reader, extraction)
    if len(frames) <= ALL_PAIRS:
        pycolmap.match_exhaustive(database, matching)
    else:
        pairing = pycolmap.SequentialPairingOptions(overlap=OVERLAP)
        pycolmap.match_sequential(database, matching, pairing)
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=1, random_seed=seed, min_model_size=2, extract_colors=False, ba_refine_focal_length=False
    )
    options.mapper.init_min_tri_angle = 4.0  # hand-held neighbours are closer together than COLMAP's tourists
    return list(pycolmap.incremental_mapping(database, images, out, options).values())


def _name(k: int) -> str:
    return f"{k:06d}.png"


def _solution(frames: FrameSet, model: Any) -> Solution:
    images = sorted((m for m in model.images.values() if m.has_pose), key=lambda m: m.name)
    used = tuple(int(m.name[:6]) for m in images)
    T_camera_world: F64 = np.tile(np.eye(4), (len(images), 1, 1))
    xyz, owner = [], []
    for k, image in enumerate(images):
        T_camera_world[k, :3] = image.cam_from_world().matrix()
        points = np.array([model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()]).reshape(-1, 3)
        xyz.append(points @ T_camera_world[k, :3, :3].T + T_camera_world[k, :3, 3])
        owner.append(np.full(len(points), k))
    lost = [f.name for k, f in enumerate(frames.frames) if k not in used]
    return Solution(
        used=used,
        T_world_camera=T_camera_world[0] @ invert_T(T_camera_world),
        world_is_capture=False,
        dropped=tuple(Dropped(name, "COLMAP could not register it") for name in lost),
        statistics={
            "poses": "estimated",
            "points": model.num_points3D(),
            "reprojection_px": model.compute_mean_reprojection_error(),
        },
        arrays={"point_xyz": np.concatenate(xyz).astype(np.float32), "point_view": np.concatenate(owner)},
    )


def _view(frame: Frame, xyz: np.ndarray) -> PointView:
    """Points (M, 3) put on the frame's depth grid, the nearest one where several meet."""
    camera = frame.intrinsics
    order = np.argsort(-xyz[:, 2], kind="stable")
    xyz = xyz[order]
    r, c, inside = camera.pixels(xyz)
    points = np.zeros((camera.height, camera.width, 3), np.float32)
    points[r[inside], c[inside]] = xyz[inside]
    mask = points[..., 2] > 0
    return PointView(points, mask.astype(np.float32), mask)


BACKEND = Backend(solve, load_views)
