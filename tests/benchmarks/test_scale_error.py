"""The scale benchmark's own measure: registration finds a scale that was put in, and rows add up."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scenes import scale_error
from benchmarks.scenes.scale_error import BAR, PAPER, TERRAINS, measure, summary, true_surface
from benchmarks.scenes.scale_sources import OURS, SOURCES, Capture, Found
from realsim.core.geometry import exp_so3, make_T, transform
from realsim.core.types import FrameSet
from realsim.synth import TERRAINS as KINDS
from realsim.synth.terrain import make_terrain


def test_thirteen_terrains_and_all_sources() -> None:
    assert len(TERRAINS) == 13
    assert {kind for kind, _ in TERRAINS.values()} <= set(KINDS)
    assert set(PAPER) <= set(TERRAINS)
    assert set(OURS) < set(SOURCES)


@pytest.mark.parametrize("name", ["Narrow1", "Boston"])
def test_registration_finds_the_scale_that_was_put_in(name: str) -> None:
    terrain = make_terrain(*TERRAINS[name])
    nothing = FrameSet((), Path(name), "test")
    surface = true_surface(Capture(terrain, np.zeros((0, 4, 4)), np.zeros(0), nothing, 1.0, (0, 0)))
    rng = np.random.default_rng(0)
    solids = [s for s in terrain.solids if s.role != "scenery"]
    t = np.concatenate([s.vertices[s.triangles] for s in solids])
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    face = rng.choice(len(t), 60_000, p=area / area.sum())
    true = np.einsum("mk,mkd->md", rng.dirichlet([1, 1, 1], len(face)), t[face])
    moved = make_T(exp_so3([0.3, -0.2, 1.0]), [1.0, 2.0, -0.5])
    points = transform(moved, 1.031 * (true + rng.normal(0, 0.004, true.shape)))
    row = measure(Found(points, true, (0.95, 0.98)), surface)
    assert abs(row["scale"] - 1.031) < 1e-3
    assert abs(row["pixel_scale"] - 1.031) < 1e-3
    assert row["holds"]  # 1 / 1.031 lies in the interval
    broken = measure(Found(rng.normal(0, 1, true.shape), true), surface)
    assert "not the true shape" in broken["error"]


def test_the_summary_counts_failures_and_coverage() -> None:
    row = {"terrain": "Stake1", "seed": 0, "source": "rgbd", "cpu_seconds": 1.0}
    rows = [
        {**row, "scale_error": 0.002, "pixel_error": 0.001, "holds": True},
        {**row, "scale_error": 0.004, "pixel_error": 0.003, "holds": False},
        {**row, "error": "no"},
    ]
    found = summary(rows)["rgbd"]
    assert (found["captures"], found["failed"], found["coverage"]) == (3, 1, 0.5)
    assert (found["mean"], found["worst"]) == (pytest.approx(0.003), 0.004)
    assert found["pixel_mean"] == pytest.approx(0.002)


def test_rows_are_kept_between_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale_error, "RESULTS", tmp_path / "scale_error.json")
    store = scale_error.open_store()
    assert store.rows == []
    row = {"terrain": "Stake1", "seed": 0, "source": "rgbd", "cpu_seconds": 1.0, "pixel_error": 0.002}
    old = {"terrain": "Stake1", "seed": 1, "source": "rgbd", "cpu_seconds": 1.0, "scale_error": 0.002}
    for each in (row, old):
        store.add({**each, "frames": 16})
    scale_error.save(store)
    assert scale_error.open_store().rows == [{**row, "frames": 16, "run": store.run}]
    assert scale_error.open_store(fresh=True).rows == []
    data = json.loads((tmp_path / "scale_error.json").read_text())
    assert data["bar"]["mean"] == BAR["mean"]
    assert "sensor_scale_sigma" in data["noise"]
