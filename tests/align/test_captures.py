"""The rendered captures with their true poses: the figures that the alignment alone is answerable for."""

import json

import numpy as np
import pytest

from realsim.align import align
from realsim.align.config import AlignConfig
from realsim.core.geometry import invert_T
from realsim.core.types import Frame, Intrinsics, MetricScene, PointView, ScaleEstimate


@pytest.mark.parametrize(
    ("name", "unit", "pattern"), [("stake_a", 1000, "depth/*.png"), ("mixed_a", 1000, "*.depth.png")]
)
def test_delivered_frame(shared, name, unit, pattern):
    """Every third frame, depth corrected by the true gain."""
    import cv2

    folder = shared(f"captures/{name}")
    truth = json.loads((folder / "gt/gt.json").read_text())
    camera = Intrinsics(*(truth["intrinsics"][k] for k in ("width", "height", "fx", "fy", "cx", "cy")))
    poses = json.loads((folder / "gt/gt_poses.json").read_text())
    poses = poses["frames"] if isinstance(poses, dict) else poses
    files = sorted((folder / "capture").glob(pattern))[::3]
    gain = 1 / truth["depth_sensor"]["depth_scale_bias"] / unit
    T = [np.array(next(p[k] for k in p if k.startswith("T_")), float).reshape(4, 4) for p in poses][::3]

    def depth(i):
        raw = cv2.imread(str(files[i]), cv2.IMREAD_UNCHANGED)
        return np.where((raw > 0) & (raw < 65535), raw, 0).astype(np.float32) * np.float32(gain)

    def load(i):
        z = depth(i)
        z[(z < 0.15) | (z > 6)] = 0
        return PointView(camera.rays() * z[..., None], (z > 0).astype(np.float32), z > 0)

    frames = tuple(Frame(f.name, camera, lambda i=i: depth(i)) for i, f in enumerate(files))
    scale = ScaleEstimate(1.0, (1.0, 1.0), (1.0,) * len(files), 0.0, "truth")
    aligned = align(MetricScene(frames, np.stack(T), load, scale, "truth", True), AlignConfig())

    E = aligned.T_sim_world @ invert_T(np.array(truth["T_sim_from_world"]))
    assert np.degrees(np.arccos(min(1.0, E[2, 2]))) < 0.1
    assert abs(np.degrees(np.arctan2(E[1, 0], E[0, 0]))) < 0.2
    assert np.linalg.norm(E[:3, 3]) < 0.005
    assert aligned.ground_z == pytest.approx(truth["floor_z_sim"], abs=0.004)
    box = np.array(truth["terrain_bbox_sim"])
    assert (aligned.bounds[0] < box[0]).all()
    assert (aligned.bounds[1] > box[1]).all()
    assert (aligned.bounds[1, :2] < box[1, :2] + 1.0).all()
