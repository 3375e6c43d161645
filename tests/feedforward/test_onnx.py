"""Models through the one contract: generated files whose right answers are known, in every variant."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rooms
from analytic import CAMERA, UNIT, answers, check, room_frame, run
from hypothesis import given
from hypothesis import strategies as st

from realsim.core.errors import ModelError, PoseError
from realsim.core.geometry import exp_so3, invert_T, make_T
from realsim.core.types import Frame, Intrinsics
from realsim.feedforward.onnx.adapters import Prediction
from realsim.feedforward.onnx.adapters.mono import shift_and_focal
from realsim.feedforward.onnx.consistency import believed, edges
from realsim.feedforward.onnx.inputs import Inputs
from realsim.feedforward.onnx.place import place_windows, windows
from realsim.feedforward.onnx.preprocess import grid_to_depth, make_grid, to_tensor
from realsim.feedforward.onnx.session import open_model
from realsim.feedforward.onnx.sim3 import robust_similarity
from realsim.feedforward.onnx.spec import Port, Spec
from tests.truths.simulated_model import Shape, write_model

pytest.importorskip("onnx", reason="models for these tests are made with onnx (extra dev)")


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [room_frame(k, T) for k, T in enumerate(rooms.path(5, 0.15))]


VARIANTS = [
    Shape("pointmap"),
    Shape("pointmap", pose="raw9", conf="exp1", norm="imagenet", channels_first=True),
    Shape("pointmap", batched=False, input_name="imgs", conf="log_error", norm="half"),
    Shape("depth", pose="w2c", conf="exp1", norm="imagenet"),
    Shape("depth", pose="pose_enc9", conf="exp1", names={"pose": "pose_enc", "conf": "depth_conf"}, batched=False),
    Shape("depth", pose="c2w", conf="none", channels_first=True),
    Shape("world", pose="c2w", conf="exp1", batched=False, input_name="input_images"),
    Shape("world", pose="pose_enc9", conf="none", channels_first=True),
    Shape("pair", conf="exp1", norm="half", patch=16, batched=False, n_static=2),
    Shape("pair", conf="logit"),
]


@pytest.mark.parametrize("shape", VARIANTS, ids=lambda s: f"{s.kind}-{s.pose}-{s.conf}-{s.norm}")
def test_every_variant_of_the_contract_gives_the_truth(frames: list[Frame], shape: Shape, tmp_path: Path) -> None:
    poses = rooms.path(5, 0.15)
    told = answers(frames, poses, shape)
    if shape.pose == "pose_enc9":  # its camera has the middle of the picture for principal point, so has its answer
        h, w = told.depth.shape[1:]
        K = np.tile(np.array([[100.0, 0, w / 2], [0, 101.0, h / 2], [0, 0, 1]]), (5, 1, 1))
        told = replace(told, K=K)
    model = write_model(tmp_path / "m.onnx", told, shape)
    maps = run(frames, model)
    unit = UNIT
    if shape.kind == "pair":  # the unit is that of the first view's surest run
        unit = float(np.median(maps.load(0).points[..., 2][maps.load(0).mask] / frames[0].depth()[maps.load(0).mask]))
    check(maps, frames, poses, unit)
    assert maps.backend == "onnx"
    assert not any("guessed" in w for w in maps.warnings)


# ---------------------------------------------------------------- geometry of pictures


@pytest.mark.parametrize("fit", ["resize", "pad_white", "crop"])
def test_pixels_find_their_way_back(fit: str) -> None:
    """A plane's inverse depth, written on the model's grid, is the plane again on the depth camera's own pixels."""
    picture = Intrinsics(150, 100, 120.0, 121.0, 70.0, 52.0)
    depth_camera = Intrinsics(75, 50, 61.0, 60.0, 36.0, 25.0)
    spec = Spec("pointmap", Port("images", (1, "N", 3, 84, 98), ""), {}, fit=fit, fixed_hw=(84, 98))
    grid = make_grid(picture, spec)
    normal = np.array([0.1, 0.5, 0.4])
    on_grid = (grid.camera.rays() @ normal).astype(np.float32)
    back, mask = grid_to_depth(on_grid, on_grid > 0, grid, depth_camera)
    assert mask.mean() > (0.5 if fit == "crop" else 0.8)
    np.testing.assert_allclose(back[mask], (depth_camera.rays() @ normal)[mask], atol=2e-3)
    rows, columns = grid.content
    assert (rows.stop - rows.start, columns.stop - columns.start) == {
        "resize": (84, 98), "pad_white": (65, 98), "crop": (84, 98),
    }[fit]  # fmt: skip
    tensor = to_tensor(np.zeros((100, 150, 3), np.uint8), grid, "identity")
    assert tensor.shape == (3, 84, 98)
    assert tensor[:, rows, columns].max() == 0
    assert (tensor.sum() > 0) == (fit == "pad_white")  # white is only what was filled up


def test_sizes_are_multiples_of_the_patch_and_not_too_large() -> None:
    for w, h in ((640, 480), (1920, 1440), (100, 37), (256, 192)):
        for patch in (14, 16):
            spec = Spec("pointmap", Port("images", (1, "N", 3, "H", "W"), ""), {}, patch=patch)
            grid = make_grid(Intrinsics(w, h, 500.0, 500.0, w / 2, h / 2), spec)
            assert grid.width % patch == grid.height % patch == 0
            assert grid.width * grid.height <= 255_000
            assert abs(np.log(grid.width / grid.height / (w / h))) < 0.25


def test_normalisations_are_those_of_the_published_models() -> None:
    grid = make_grid(CAMERA, Spec("pointmap", Port("images", (1, "N", 3, "H", "W"), ""), {}))
    white = np.full((84, 112, 3), 255, np.uint8)
    assert to_tensor(white, grid, "half").max() == 1
    assert to_tensor(0 * white, grid, "half").min() == -1
    black = to_tensor(0 * white, grid, "imagenet")[:, 0, 0]
    np.testing.assert_allclose(black, [-0.485 / 0.229, -0.456 / 0.224, -0.406 / 0.225], rtol=1e-6)


def test_planes_have_no_edges_and_steps_do() -> None:
    slanted = 1 / (CAMERA.rays() @ np.array([0.0, 0.9, 0.05])).astype(np.float32)
    slanted = np.where((slanted > 0) & (slanted < 20), slanted, 0).astype(np.float32)
    valid = slanted > 0
    assert not (edges(slanted, valid) & (slanted < 5)).any()
    stepped = np.ones((40, 60), np.float32)
    stepped[:, 30:] = 1.3
    found = edges(stepped, stepped > 0)
    assert found[:, 29:31].all()
    assert not found[:, :27].any()


def test_confidence_is_limited_by_value_and_by_percentile() -> None:
    depth = np.ones((10, 10), np.float32)
    conf = np.linspace(0, 1, 100, dtype=np.float32).reshape(10, 10)
    kept = believed(depth, conf, depth > 0, min_confidence=0.5, drop_percent=20.0)
    assert conf[kept].min() > 0.59
    same = believed(depth, 0 * conf + 0.9, depth > 0, 0.5, 20.0)
    assert same.all()  # a model that is equally sure everywhere loses nothing


# ---------------------------------------------------------------- single views


def test_focal_length_and_shift_of_a_single_view_are_recovered() -> None:
    depth = rooms.ray_cast(rooms.path(1)[0], CAMERA)[0].astype(np.float32)
    rays = CAMERA.rays()
    points = 0.7 * rays * depth[..., None]
    points[..., :2] /= 1.06  # the model's focal length is 6 percent longer
    points[..., 2] -= 0.4
    shift, ratio = shift_and_focal(points.astype(np.float32), rays[..., :2], depth > 0)
    assert abs(shift - 0.4) < 1e-3
    assert abs(ratio - 1.06) < 1e-3


def test_one_frame_of_a_single_view_model(frames: list[Frame], tmp_path: Path) -> None:
    shape = Shape("mono", batched=False, input_name="image", conf="none", shift=0.3, extra_inputs=("num_tokens",))
    model = write_model(tmp_path / "m.onnx", answers(frames[:1], rooms.path(5, 0.15)[:1], shape), shape)
    maps = run(frames[:1], model)
    view = maps.load(0)
    ratio = (view.points[..., 2] / frames[0].depth())[view.mask & (frames[0].depth() > 0)]
    assert np.quantile(np.abs(ratio / np.median(ratio) - 1), 0.9) < 0.005
    with pytest.raises(PoseError, match=r"no poses[\s\S]*onnx\+depth"):
        run(frames, model)


# ---------------------------------------------------------------- windows


@given(n=st.integers(1, 60), most=st.integers(2, 20), static=st.booleans())
def test_windows_cover_all_views_and_overlap(n: int, most: int, static: bool) -> None:
    plan = windows(n, most, most if static else None)
    assert sorted({i for w in plan for i in w}) == list(range(n))
    for w in plan:
        assert len(w) == most if static else len(w) <= most
    for a, b in pairwise(plan):
        assert len(set(a) & set(b)) >= min(6, most // 2)


@pytest.mark.parametrize("static", [None, 8])
def test_windows_are_joined_by_similarities(static: int | None, tmp_path: Path) -> None:
    poses = rooms.path(14, 0.08)
    many = [room_frame(k, T) for k, T in enumerate(poses)]
    shape = Shape("pointmap", max_views=8, n_static=static)
    model = write_model(tmp_path / "m.onnx", answers(many, poses, shape), shape)
    maps = run(many, model)
    check(maps, many, poses)
    assert maps.statistics["views_a_run"] == 8


def test_every_window_may_have_its_own_world_and_unit() -> None:
    """The similarity between runs is found from the views that they share, with a fifth of the pixels wrong."""
    poses = rooms.path(10, 0.1)
    depth = np.stack([rooms.ray_cast(T, CAMERA)[0] for T in poses]).astype(np.float32)
    rng = np.random.default_rng(0)

    def predicted(views: Sequence[int]) -> Prediction:
        unit = 0.5 + 0.3 * rng.random()
        move = make_T(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, 2, 3))
        T = poses[list(views)].copy()
        T[:, :3, 3] *= unit
        local = unit * CAMERA.rays() * depth[list(views)][..., None]
        wrong = rng.random(local.shape[:3]) < 0.2
        local[wrong] *= rng.uniform(0.5, 2, (int(wrong.sum()), 1))
        mask = depth[list(views)] > 0
        return Prediction(local.astype(np.float32), move @ T, mask.astype(np.float32), mask, 1 / unit)

    placed = place_windows(predicted, 10, 6, None)
    T = placed.T_world_camera
    unit = np.linalg.norm(T[1, :3, 3] - T[0, :3, 3]) / np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3])
    found, true = invert_T(T[0]) @ T, invert_T(poses[0]) @ poses
    np.testing.assert_allclose(found[:, :3, 3] / unit, true[:, :3, 3], atol=2e-3)
    np.testing.assert_allclose(found[:, :3, :3], true[:, :3, :3], atol=2e-3)
    np.testing.assert_allclose(np.median((placed.depth / depth)[:, 40:44, 50:60], axis=(1, 2)), unit, rtol=2e-2)
    np.testing.assert_allclose(placed.claims, 1 / unit, rtol=1e-2)
    assert set(placed.part) == {0}


@given(st.integers(0, 10_000))
def test_a_similarity_is_found_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.normal((0, 0, 4), 1, (200, 3))
    T = make_T(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, 3, 3))
    T[:3, :3] *= (scale := float(np.exp(rng.normal(0, 1))))
    q = p @ T[:3, :3].T + T[:3, 3]
    q[:60] += rng.normal(0, 5, (60, 3))
    found = robust_similarity(p, q, scale * p[:, 2])
    assert found is not None
    np.testing.assert_allclose(found.T, T, atol=1e-6 * scale)
    assert abs(found.scale / scale - 1) < 1e-6
    assert 0.69 <= found.inliers <= 0.75


# ---------------------------------------------------------------- together with the sensor


def with_hole(frame: Frame, factor: float = 1.0) -> Frame:
    """The frame with sensor depth (times `factor`), and a hole of 20 x 25 pixels in it."""
    depth = frame.depth() * np.float32(factor)
    depth[45:65, 40:65] = 0
    return replace(frame, read_depth=lambda: depth)


def test_holes_of_the_sensor_are_completed_and_nothing_else(frames: list[Frame], tmp_path: Path) -> None:
    poses = rooms.path(5, 0.15)
    shape = Shape("pointmap")
    told = answers(frames, poses, shape)
    # The model is 3 percent off and bent by another 2 from left to right: the rim of the hole knows better.
    bend = 1.03 + 0.02 * np.linspace(-1, 1, 112)
    model = write_model(tmp_path / "m.onnx", replace(told, depth=told.depth * bend), shape)
    holed = [with_hole(f) for f in frames]
    maps = run(holed, model, "onnx+depth")
    for k, frame in enumerate(frames):
        view, true, sensor = maps.load(k), frame.depth(), holed[k].depth()
        hole = (sensor == 0) & (true > 0) & view.mask
        assert hole.sum() > 150
        assert np.median(np.abs(view.points[..., 2][hole] / true[hole] - 1)) < 0.01
        measured = view.mask & (sensor > 0)
        np.testing.assert_allclose(view.points[..., 2][measured], sensor[measured], rtol=1e-6)
        assert view.confidence[hole].max() < np.median(view.confidence[measured])
    expected = invert_T(poses[0]) @ poses
    np.testing.assert_allclose(maps.T_world_camera[:, :3, 3], expected[:, :3, 3], atol=0.01)
    assert maps.backend == "onnx+depth"


def test_the_models_rough_poses_are_refined_against_the_depth(tmp_path: Path) -> None:
    poses = rooms.path(6, 0.12)
    seen = [rooms.frame(k, T) for k, T in enumerate(poses)]
    rough = poses.copy()
    rng = np.random.default_rng(1)
    for T in rough:
        T[:3, 3] += rng.normal(0, 0.01, 3)
        T[:3, :3] = T[:3, :3] @ exp_so3(rng.normal(0, 0.008, 3))
    told = answers(seen, poses, Shape("pointmap"))
    rough[:, :3, 3] *= UNIT
    model = write_model(tmp_path / "m.onnx", replace(told, T_world_camera=rough), Shape("pointmap"))
    expected = (invert_T(poses[0]) @ poses)[:, :3, 3]

    def error(backend: str) -> float:
        T = run(seen, model, backend).T_world_camera
        unit = UNIT if backend == "onnx" else 1.0
        return float(np.linalg.norm(T[:, :3, 3] / unit - expected, axis=1).max())

    assert error("onnx") > 0.015
    assert error("onnx+depth") < 0.005


def test_a_single_view_model_completes_frames_whose_poses_come_from_depth(tmp_path: Path) -> None:
    poses = rooms.path(4, 0.12)
    seen = [rooms.frame(k, T, noise=0) for k, T in enumerate(poses)]
    shape = Shape("mono", batched=False, conf="none", shift=0.2)
    model = write_model(tmp_path / "m.onnx", answers(seen, poses, shape), shape)
    holed = []
    for f in seen:
        depth = f.depth().copy()
        depth[150:190, 120:180] = 0
        holed.append(replace(f, read_depth=lambda d=depth: d))
    maps = run(holed, model, "onnx+depth")
    view, true = maps.load(1), seen[1].depth()
    hole = (holed[1].depth() == 0) & (true > 0) & view.mask
    assert hole.sum() > 1000
    assert np.median(np.abs(view.points[..., 2][hole] / true[hole] - 1)) < 0.01


def test_sensor_depth_is_fed_only_where_it_may_be(frames: list[Frame], tmp_path: Path) -> None:
    shape = Shape("pointmap", extra_inputs=("depths", "intrinsics"))
    model = open_model(write_model(tmp_path / "m.onnx", answers(frames, rooms.path(5, 0.15), shape), shape))
    for with_depth in (False, True):
        feeds = Inputs.of(frames, model.spec, with_depth=with_depth).feeds((0, 1, 1))
        assert feeds["images"].shape == (1, 3, 3, 84, 112)
        assert feeds["depths"].shape == (1, 3, 84, 112)
        assert feeds["depths"].any() == with_depth
        np.testing.assert_allclose(feeds["intrinsics"][0, 0], CAMERA.K)
    with_poses = Spec(**{**vars(model.spec), "extra_inputs": (Port("poses", (1, "N", 4, 4), "tensor(float)"),)})
    with pytest.raises(ModelError, match="takes poses"):
        Inputs.of(frames, with_poses, with_depth=True)
