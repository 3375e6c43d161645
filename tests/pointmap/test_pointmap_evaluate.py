"""The evaluation: rows for every kind and input, and a truth of captures that their own sensor confirms."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from realsim.core.errors import CaptureError
from realsim.feedforward.onnx.preprocess import depth_to_grid, make_grid
from realsim.feedforward.onnx.spec import Port, Spec
from training.pointmap import evaluate
from training.pointmap.layouts import LAYOUTS
from training.pointmap.network import TINY, PointmapNet


def test_generated_scenes_of_every_kind_are_measured_with_and_without_depth() -> None:
    torch.set_num_threads(1)
    rows = list(evaluate.generated(PointmapNet(TINY), (32, 48), scenes=1, views=2))
    assert {(r["given"], r["scenes"]) for r in rows} == {(g, s) for g in evaluate.BARS for s in (*LAYOUTS, "all")}
    by = {(r["given"], r["scenes"]): r for r in rows}
    assert by["rgbd", "all"]["abs_rel"] < by["rgb", "all"]["abs_rel"]  # even untrained it passes the sensor's depth on
    assert all(0 <= r["area_oracle"] <= r["area"] for r in rows)
    assert "bar 0.02" in evaluate.line(by["rgbd", "all"])


def test_windows_hold_every_frame_once() -> None:
    for count, step in ((60, 1), (60, 4), (37, 4), (3, 4)):
        found = sorted(i for w in evaluate._windows(count, 8, step) for i in w)
        assert found == list(range(count))


def test_the_truth_of_a_capture_is_what_its_sensor_saw(shared: Callable[[str], Path]) -> None:
    pytest.importorskip("open3d")
    truth = evaluate.read(shared("captures/stake_a"))
    spec = Spec("pointmap", Port("images", (1, "N", 3, 96, 128), ""), {}, patch=16, fixed_hw=(96, 128))
    frame = truth.frames[7]
    grid = make_grid(frame.color_intrinsics or frame.intrinsics, spec)
    z, seen = evaluate.true_depth(truth, 7, grid), depth_to_grid(frame.depth(), frame.intrinsics, grid)
    both = (z > 0) & (seen > 0)
    assert both.mean() > 0.4
    assert np.median(np.abs(seen[both] / z[both] - 1)) < 0.01  # its bias of scale is up to one percent
    wide = evaluate.spoilt(frame, "wide crop")
    assert wide.color().shape[0] == wide.color_intrinsics.height
    assert evaluate.spoilt(frame, "night").color().mean() < 0.1 * frame.color().mean()


def test_what_is_no_capture_with_truth_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    with pytest.raises(CaptureError, match="truth"):
        evaluate.read(tmp_path)
