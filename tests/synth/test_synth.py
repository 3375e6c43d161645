"""Synthetic captures: closed solids, depth as geometry has it, noise as the model has it, stable bytes."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from realsim.core.errors import RealsimError, UnknownNameError
from realsim.core.geometry import exp_so3, is_rotation, make_T, transform
from realsim.core.types import Intrinsics
from realsim.synth import PLACES, TERRAINS, SynthConfig, compare, write_capture
from realsim.synth.camera import INTRINSICS, DepthSensor, follow_route, look_at, walk
from realsim.synth.capture import camera_poses
from realsim.synth.errors import read_surface
from realsim.synth.render import Renderer
from realsim.synth.terrain import Terrain, make_terrain, top_centroid
from realsim.synth.truth import read_truth

SMALL = Intrinsics(80, 60, 77.0, 77.0, 39.5, 29.5)


@pytest.mark.parametrize("name", TERRAINS)
def test_solids_are_closed_and_point_outward(name: str) -> None:
    for solid in make_terrain(name, 3).solids:
        edges = np.vstack([solid.triangles[:, [0, 1]], solid.triangles[:, [1, 2]], solid.triangles[:, [2, 0]]])
        assert {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}
        a, b, c = (solid.vertices[solid.triangles[:, k]] for k in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0


@pytest.mark.parametrize("name", TERRAINS)
def test_simulation_frame(name: str) -> None:
    terrain = make_terrain(name, 1)
    start, goal = terrain.of("start")[0], terrain.of("goal")[0]
    np.testing.assert_allclose(top_centroid(start), 0, atol=1e-12)
    assert top_centroid(goal)[0] > 1.5
    assert top_centroid(goal)[1] == pytest.approx(0, abs=1e-12)
    for solid in terrain.of("start", "goal", "obstacle"):
        assert solid.vertices[:, 2].min() >= terrain.floor_z - 1e-9
    scenery = np.vstack([s.vertices for s in terrain.of("scenery")])
    near = ((scenery[:, :2] > terrain.bounds[0, :2] - 0.5) & (scenery[:, :2] < terrain.bounds[1, :2] + 0.5)).all(1)
    assert not near.any()


def test_unknown_terrain_lists_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="stakes"):
        make_terrain("stake", 0)


def test_walk_is_rigid_and_starts_behind_the_start_platform() -> None:
    bounds = make_terrain("stakes", 0).bounds
    poses = walk(bounds, 40, np.random.default_rng(0), both_sides=True)
    assert all(is_rotation(T[:3, :3]) for T in poses)
    assert poses[0, 0, 3] < bounds[0, 0]
    assert poses[0, 0, 2] > 0.7  # looks along +x
    assert poses[0, 2, 1] < 0  # the image's y points down
    assert (poses[:, 1, 3] > 0.5).any()
    assert (poses[:, 1, 3] < -0.5).any()


@pytest.mark.parametrize("name", PLACES)
def test_places_that_are_gone_through_once_do_not_come_back(name: str) -> None:
    way = [follow_route(t.eyes, t.aims, 60, np.random.default_rng(0))[:, :3, 3] for t in _both_ways(name)]
    back = [_comes_back(eyes) for eyes in way]
    assert back == [True, False]


def _both_ways(name: str) -> list[Terrain]:
    return [make_terrain(name, 0, once) for once in (False, True)]


def _comes_back(eyes: np.ndarray) -> bool:
    apart = np.linalg.norm(eyes[:, None] - eyes[None], axis=-1)
    return bool((apart[np.triu_indices(len(eyes), 12)] < 0.6).any())


def test_a_gap_takes_frames_out_of_the_middle() -> None:
    config = SynthConfig("corridor", frames=6, gap=4)
    rng = np.random.default_rng
    terrain = make_terrain("corridor", 0)
    whole = camera_poses(terrain, replace(config, frames=10, gap=0), rng(0))
    np.testing.assert_array_equal(camera_poses(terrain, config, rng(0)), whole[[0, 1, 2, 7, 8, 9]])


def test_depth_is_that_of_the_floor() -> None:
    terrain = make_terrain("boxes", 0)
    renderer = Renderer(tuple(terrain.of("floor")), SMALL, 0)
    T = look_at(np.array([1.0, 0.2, 1.0]), np.array([1.5, 0.0, terrain.floor_z]), roll=0.1)
    # Along a pixel's ray with z = 1, the floor lies at (floor_z - eye_z) / ray_z.
    expected = (terrain.floor_z - 1.0) / (SMALL.rays() @ T[:3, :3].T)[..., 2]
    np.testing.assert_allclose(renderer.depth(T), expected, rtol=1e-5)


def test_visible_points_are_those_that_depth_shows() -> None:
    terrain = make_terrain("stakes", 0)
    renderer = Renderer(terrain.solids, SMALL, 0)
    T = walk(terrain.bounds, 5, np.random.default_rng(0))[2]
    depth = renderer.depth(T)
    points = transform(T, (SMALL.rays() * depth[..., None]).reshape(-1, 3))
    toward = T[:3, 3] - points
    seen = renderer.visible(points + 1e-4 * toward, toward, T)
    assert seen.mean() > 0.99
    behind = renderer.visible(points - 0.05 * toward, toward, T)
    assert behind.mean() < 0.02


def test_noise_follows_the_square_of_depth() -> None:
    sensor = DepthSensor(scale=1.005)
    for z in (1.0, 2.0, 4.0):
        measured = sensor.measure(np.full((240, 320), z, np.float32), np.random.default_rng(0)) / 1000
        valid = measured > 0
        assert 0.95 < valid.mean() < 0.99
        assert np.median(measured[valid]) == pytest.approx(1.005 * z, abs=0.002 * z)
        # Steps of disparity add their share to what the noise alone would be.
        step = sensor.step / 19.25 / np.sqrt(12)
        assert measured[valid].std() == pytest.approx((1.005 * z) ** 2 * np.hypot(0.0018, step), rel=0.08)
    assert not sensor.measure(np.full((8, 8), np.inf, np.float32), np.random.default_rng(0)).any()


def test_edges_have_holes_and_flying_pixels() -> None:
    true = np.full((240, 320), 3.0, np.float32)
    true[:, :160] = 1.0
    measured = DepthSensor(holes=0.0).measure(true, np.random.default_rng(0)) / 1000
    edge = measured[:, 157:163]
    assert ((edge > 1.2) & (edge < 2.7)).any()
    assert (edge == 0).mean() > 5 * (measured[:, :150] == 0).mean()


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synth") / "a"
    write_capture(folder, SynthConfig(terrain="mixed", frames=3, poses=True, seed=5))
    return folder


def test_layout_and_poses_agree_with_the_truth(capture: Path) -> None:
    names = sorted(p.relative_to(capture / "capture").as_posix() for p in (capture / "capture").rglob("*.*"))
    pictures = [f"color/{i:06d}.jpg" for i in range(3)] + [f"depth/{i:06d}.png" for i in range(3)]
    assert names == sorted(["camera_intrinsic.json", "trajectory.log", *pictures])
    k = json.loads((capture / "capture" / "camera_intrinsic.json").read_text())
    assert np.reshape(k["intrinsic_matrix"], (3, 3)).T.tolist() == INTRINSICS.K.tolist()
    truth, samples = read_truth(capture / "truth")
    lines = [line.split() for line in (capture / "capture" / "trajectory.log").read_text().splitlines()]
    T = np.array([line for i, line in enumerate(lines) if i % 5], float).reshape(-1, 4, 4)
    np.testing.assert_allclose(np.array(truth["T_sim_world"]) @ T, truth["T_sim_camera"], atol=1e-8)
    # What the depth images show lies on the true surface: samples seen by a view project to that view's depth.
    depth = cv2.imread(str(capture / "capture" / "depth" / "000000.png"), cv2.IMREAD_UNCHANGED) / 1000
    p = transform(np.linalg.inv(np.array(truth["T_sim_camera"][0])), samples.points[samples.seen == 3])
    u, v = (p[:, :2] / p[:, 2:] @ np.diag([INTRINSICS.fx, INTRINSICS.fy]) + [INTRINSICS.cx, INTRINSICS.cy]).round().T
    measured = depth[v.astype(int), u.astype(int)] / truth["depth_scale"]
    kept = measured > 0
    assert np.median((np.abs(measured - p[:, 2]) / p[:, 2] ** 2)[kept]) < 0.003


def test_same_config_same_bytes(capture: Path, tmp_path: Path) -> None:
    config = SynthConfig(terrain="mixed", frames=3, poses=True, seed=5)
    write_capture(tmp_path / "b", config)
    for path in sorted(capture.rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(capture)).read_bytes(), path
    with pytest.raises(RealsimError, match="exists"):
        write_capture(tmp_path / "b", replace(config, frames=1))


def test_pictures_have_features_and_light(capture: Path) -> None:
    picture = cv2.imread(str(capture / "capture" / "color" / "000000.jpg"))
    assert picture.shape == (480, 640, 3)
    assert 60 < picture.mean() < 190
    assert len(cv2.SIFT_create().detect(picture)) > 400


def test_compare_finds_what_was_done_to_the_mesh(capture: Path, tmp_path: Path) -> None:
    perfect = read_surface(capture / "truth" / "mesh.ply")
    w = np.radians([0.3, -0.2, 0.6])
    T = make_T(1.005 * exp_so3(w), [0.004, -0.003, 0.005])
    for name, transformation in (("perfect", np.eye(4)), ("moved", T)):
        _write_ply(tmp_path / name / "mesh.ply", transform(transformation, perfect.vertices), perfect.triangles)
    good = compare(tmp_path / "perfect", capture / "truth")
    assert good["scale_error"] < 1e-4
    assert good["tops_mm"] < 0.05
    assert good["f_score_1cm"] > 0.999
    bad = compare(tmp_path / "moved", capture / "truth")
    assert bad["scale_error"] == pytest.approx(0.005, abs=2e-4)
    assert bad["tilt_deg"] == pytest.approx(np.degrees(np.arccos(exp_so3(w)[2, 2])), abs=0.01)
    assert bad["yaw_deg"] == pytest.approx(-0.6, abs=0.02)
    # The origin that was delivered is T's; seen from the truth it lies at -R^T t / s.
    assert bad["origin_mm"] == pytest.approx(1e3 * np.linalg.norm(T[:3, 3]) / 1.005, abs=0.3)
    assert bad["delivered"]["tops_mm"] > 3


def test_compare_refuses_what_is_no_scene(capture: Path, tmp_path: Path) -> None:
    with pytest.raises(RealsimError, match="no mesh"):
        compare(tmp_path, capture / "truth")
    with pytest.raises(RealsimError, match="no truth"):
        compare(tmp_path, tmp_path)


def _write_ply(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> None:
    path.parent.mkdir(parents=True)
    trimesh.Trimesh(vertices, triangles, process=False).export(path)
