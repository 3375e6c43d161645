"""Laws of the metric scale: equivariance, robustness, coverage of its interval, and when it is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.errors import ScaleError, UnknownNameError
from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import Frame, Intrinsics, Pointmaps, PointView
from realsim.scale import ESTIMATORS, estimate, to_metric
from realsim.scale.config import ScaleConfig
from realsim.scale.metric import bootstrap_median, lower_half

CAMERA = Intrinsics(48, 36, 40.0, 40.0, 23.5, 17.5)
FAST = ScaleConfig(bootstrap=200)


def capture(units=2.0, count=6, noise=0.01, gain=1.0, grid=1, seed=0, off=None):
    """Pointmaps whose predicted depth is the true depth divided by `units`; frame `off` (index, factor) is wrong."""
    frames, views = [], []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        rows = np.linspace(3.0, 1.0, CAMERA.height)[:, None]
        true = (rows + 0.2 * np.sin(np.arange(CAMERA.width) / 5 + i)).astype(np.float32)
        sensor = np.where(rng.random(true.shape) < 0.05, 0, true / gain).astype(np.float32)
        factor = off[1] if off and off[0] == i else 1.0
        small = Intrinsics.resized(CAMERA, CAMERA.width // grid, CAMERA.height // grid)
        z = true[grid // 2 :: grid, grid // 2 :: grid] / units * factor
        z = (z * (1 + noise * rng.standard_normal(z.shape))).astype(np.float32)
        pose = make_T(exp_so3([0, 0.1 * i, 0]), np.array([0.3 * i, 0, 1.0]) / units)
        frames.append(Frame(f"f{i}", CAMERA, lambda d=sensor: d))
        views.append(
            (
                PointView(small.rays() * z[..., None], rng.random(z.shape).astype(np.float32), np.ones(z.shape, bool)),
                pose,
            )
        )
    return Pointmaps(
        tuple(frames), np.stack([p for _, p in views]), lambda i: views[i][0], "made", False, depth_gain=gain
    )


@pytest.mark.parametrize("method", list(ESTIMATORS))
@pytest.mark.parametrize("grid", [1, 2])
def test_every_estimator_finds_the_scale(method, grid):
    scene = to_metric(capture(units=2.0, grid=grid), replace(FAST, method=method))
    assert scene.scale.value == pytest.approx(2.0, rel=0.02 if grid > 1 else 0.004)
    low, high = scene.scale.ci90
    assert low <= scene.scale.value <= high
    assert len(scene.scale.per_frame) == 6
    assert scene.scale.method == method
    assert not scene.scale.warnings


@settings(max_examples=15, deadline=None)
@given(k=st.floats(0.01, 100.0), method=st.sampled_from(list(ESTIMATORS)))
def test_scale_is_equivariant(k, method):
    """Points and poses k times as large have a scale k times as small, and the metric scene stays as it is."""
    points = capture(count=3)

    def load(i):
        view = points.load(i)
        return replace(view, points=view.points * np.float32(k))

    poses = points.T_world_camera.copy()
    poses[:, :3, 3] *= k
    config = replace(FAST, method=method)
    one, other = to_metric(points, config), to_metric(replace(points, load=load, T_world_camera=poses), config)
    assert other.scale.value * k == pytest.approx(one.scale.value, rel=1e-4)
    assert other.scale.per_frame_spread == pytest.approx(one.scale.per_frame_spread, abs=1e-4)
    np.testing.assert_allclose(other.T_world_camera, one.T_world_camera, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(other.load(1).points, one.load(1).points, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("method", list(ESTIMATORS))
def test_depth_that_is_the_prediction_gives_one(method):
    """As for the backend `rgbd`: points made from corrected sensor depth have scale 1, within the interval."""
    points = capture(units=1.0, noise=0.0, gain=0.992)

    def load(i):
        z = points.frames[i].depth() * np.float32(0.992)
        return PointView(CAMERA.rays() * z[..., None], (z > 0).astype(np.float32), z > 0)

    scale = to_metric(replace(points, load=load), replace(FAST, method=method, sensor_sigma=0.0)).scale
    assert scale.value == pytest.approx(1.0, abs=1e-6)
    assert scale.ci90[0] <= 1.0 <= scale.ci90[1]
    assert scale.ci90[1] - scale.ci90[0] < 1e-5


def test_the_interval_knows_what_is_not_known_of_the_sensor():
    """Frames that agree do not make the sensor true; metric poses that gave its gain do."""
    points = capture(units=1.0, noise=0.0)
    unknown = to_metric(points, FAST).scale
    phone = to_metric(points, FAST, sensor_sigma=0.04).scale
    corrected = to_metric(replace(points, depth_gain_sigma=0.0005), FAST).scale
    assert unknown.ci90[1] - unknown.ci90[0] == pytest.approx(2 * 1.645 * 0.006, rel=0.01)
    assert phone.ci90[1] - phone.ci90[0] == pytest.approx(2 * 1.645 * 0.04, rel=0.01)
    assert corrected.ci90[1] - corrected.ci90[0] == pytest.approx(2 * 1.645 * 0.0005, rel=0.05)
    assert corrected.sensor_sigma == 0.0005


def test_two_sources_of_metres_that_differ_are_not_known_better_than_that():
    points = capture(units=1.0, noise=0.0)
    scale = to_metric(replace(points, depth_gain=0.96, depth_gain_sigma=0.002), FAST, sensor_sigma=0.04).scale
    assert scale.sensor_sigma == pytest.approx(0.02, rel=0.05)


@settings(max_examples=20, deadline=None)
@given(factor=st.floats(0.05, 20.0), index=st.integers(0, 6))
def test_one_bad_frame_does_not_move_the_median(factor, index):
    good = to_metric(capture(count=7), FAST).scale
    bad = to_metric(capture(count=7, off=(index, factor)), FAST).scale
    assert min(good.per_frame) * 0.999 <= bad.value <= max(good.per_frame) * 1.001
    if abs(np.log(factor)) > 0.2:
        assert any(f"f{index} (" in w for w in bad.warnings)


def test_the_interval_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(300):
        low, high = bootstrap_median(1.7 * np.exp(0.03 * rng.standard_normal(25)), 300, trial)
        hits += low <= 1.7 <= high
    assert 0.84 < hits / 300 < 0.96


def test_disagreeing_frames_are_warned_of_then_refused_and_named():
    ratios = np.array([1.0, 1.1, 0.9, 1.05, 0.93, 1.08])
    names = [f"f{i}" for i in range(6)]
    assert any("disagree" in w for w in estimate(ratios, names, FAST).warnings)
    with pytest.raises(ScaleError, match="disagree") as caught:
        estimate(np.array([1.0, 2.0, 0.5, 1.9, 0.4, 1.1]), names, FAST)
    assert "f4 (0.4)" in str(caught.value)
    relaxed = replace(FAST, max_spread=2.0)
    assert estimate(np.array([1.0, 2.0, 0.5, 1.9, 0.4, 1.1]), names, relaxed).value == pytest.approx(1.05)


def test_frames_without_depth_say_nothing_and_none_at_all_is_refused():
    points = capture(count=3)
    blind = replace(points.frames[1], read_depth=lambda: np.zeros((36, 48), np.float32))
    some = to_metric(replace(points, frames=(points.frames[0], blind, points.frames[2])), FAST)
    assert np.isnan(some.scale.per_frame[1])
    assert any("f1" in w for w in some.scale.warnings)
    with pytest.raises(ScaleError, match="cannot be determined"):
        to_metric(replace(points, frames=(blind,) * 3), FAST)


def test_views_are_read_once_for_the_estimate():
    points, read = capture(count=5), []

    def load(i):
        read.append(i)
        return points.load(i)

    to_metric(replace(points, load=load), FAST)
    assert read == list(range(5))


def test_what_the_pointmaps_know_is_handed_on():
    points = replace(capture(), warnings=("w",), statistics={"a": 1}, depth_gain=1.0, world_is_capture=True)
    scene = to_metric(points, FAST, np.array([0, 0, 1.0]))
    assert scene.warnings == ("w",)
    assert scene.statistics == {"a": 1}
    np.testing.assert_array_equal(scene.up_world, [0, 0, 1])


def test_up_in_the_capture_says_nothing_of_a_world_that_the_backend_chose():
    """ARKit's +y is up; in the first camera's axes it is down."""
    points, up = capture(), np.array([0, 1.0, 0])
    assert not points.world_is_capture
    scene = to_metric(points, FAST, up)
    assert scene.up_world is None
    assert scene.scale == to_metric(points, FAST).scale
    assert to_metric(replace(points, world_is_capture=True), FAST, up).up_world is up


def test_lower_half_follows_gravity_where_it_is_known():
    shape, up = (4, 6), np.array([0.0, -1.0, 0.0])  # camera axes as world axes: image down is world down
    rows = lower_half(shape, np.eye(4), None)
    np.testing.assert_array_equal(rows, lower_half(shape, np.eye(4), up))
    assert rows[2:].all()
    assert not rows[:2].any()
    upside_down, sideways = make_T(exp_so3([0, 0, np.pi])), make_T(exp_so3([0, 0, np.pi / 2]))
    assert lower_half(shape, upside_down, up)[:2].all()
    assert not lower_half(shape, upside_down, up)[2:].any()
    assert lower_half(shape, sideways, up)[:, 3:].all()
    straight_down = make_T(exp_so3([-np.pi / 2, 0, 0]))
    np.testing.assert_array_equal(lower_half(shape, straight_down, up), rows)


def test_an_unknown_estimator_is_named():
    with pytest.raises(UnknownNameError, match="median"):
        to_metric(capture(count=1), replace(FAST, method="mean"))
