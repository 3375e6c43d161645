"""A rendered Kinect: colour that is not registered to depth is found out, and refined poses never lose to the given."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim import capture, feedforward
from realsim.capture.config import CaptureConfig
from realsim.core.types import FrameSet
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd.extrinsic_calibration import Registration
from realsim.feedforward.rgbd.features import Evidence
from realsim.feedforward.rgbd.heldout import compare, hold_out
from realsim.synth import SynthConfig, write_capture
from realsim.synth.truth import read_truth


@pytest.fixture(scope="module")
def kinect(tmp_path_factory: pytest.TempPathFactory) -> tuple[FrameSet, Path]:
    folder = tmp_path_factory.mktemp("kinect") / "made"
    config = SynthConfig("mixed", 24, True, sensor="kinect", width=320, pose_error=0.01, depth_scale=1.0)
    made = write_capture(folder, config)
    found = capture.read(made.capture, CaptureConfig(keep_blurred=True))
    assert isinstance(found, FrameSet)
    return found, made.truth


@pytest.mark.slow
def test_the_colour_camera_is_found(kinect: tuple[FrameSet, Path]) -> None:
    frames, folder = kinect
    solution = feedforward.solve(frames, PointsConfig())
    truth = read_truth(folder)[0]["cameras"]
    zoom = float(np.prod([1 + row[0] for row in solution.arrays["registration"]]))
    assert zoom == pytest.approx(truth["depth"]["fx"] / truth["color"]["fx"], abs=0.015)
    assert any("not registered" in w for w in solution.warnings)
    assert abs(solution.depth_gain - 1) < 0.02  # poses that drift by a centimetre have a scale of their own
    shift = sum(row[3:] for row in solution.arrays["registration"])
    np.testing.assert_allclose(shift, np.array(truth["T_depth_color"])[:2, 3], atol=0.012)
    tried = solution.statistics["held_out"][-1]
    assert tried["after_m"] <= tried["before_m"]
    camera = feedforward.pointmaps(frames, solution, PointsConfig()).frames[0].color_intrinsics
    assert camera is not None
    assert camera.fx == pytest.approx(truth["color"]["fx"], rel=0.015)


def test_a_correction_moves_rays_as_it_says(kinect: tuple[FrameSet, Path]) -> None:
    frame = kinect[0].frames[0]
    k = frame.intrinsics
    r = Registration(1.1, (0.01, -0.02), (0.025, 0.0))
    c = r.applied(frame).color_intrinsics
    assert c is not None
    u = 100.0
    assert (u - c.cx) / c.fx == pytest.approx(1.1 * (u - k.cx) / k.fx + 0.01)
    assert r.applied(frame).color_shift == (0.025, 0.0)
    np.testing.assert_allclose(Registration.of(r.row).row, r.row)


def test_poses_that_are_turned_lose_on_held_out_pairs(kinect: tuple[FrameSet, Path]) -> None:
    frames = [replace(f, read_color=None) for f in kinect[0].frames]
    views = Evidence.of(frames).views
    truth = read_truth(kinect[1])[0]
    T = np.asarray(truth["T_sim_camera"])
    worse = T.copy()
    worse[:, :3, 3] *= 1.06
    pairs = [(i, i + s) for s in (1, 2, 3) for i in range(len(T) - s)]
    _, held = hold_out(pairs)
    assert held
    assert not any(j - i == 1 for i, j in held)
    assert compare(views, held, (T, 1.0), (worse, 1.0)).grew
    assert not compare(views, held, (worse, 1.0), (T, 1.0)).grew
