"""`align` finds the simulation frame of scenes whose truth is known, and says so where it cannot."""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from types import ModuleType

import numpy as np
import pytest

from realsim.align import align
from realsim.align.cloud import sample_scan
from realsim.align.config import AlignConfig
from realsim.align.scene import along_walls
from realsim.align.winding import inside_out
from realsim.core.errors import AlignError, UnknownNameError
from realsim.core.geometry import exp_so3, invert_T, make_T, transform
from realsim.core.registry import Registry
from realsim.core.types import Scan

CONFIG = AlignConfig()


def truth(start=(0.0, 0.0, 0.30), goal=(2.4, 0.3, 0.25)):
    """T_sim_true for two top centroids in the scene's own level frame."""
    x = np.array(goal[:2]) - start[:2]
    yaw = np.arctan2(x[1], x[0])
    R = exp_so3([0, 0, -yaw])
    return make_T(R, -R @ np.array(start))


def errors(aligned, T_world_true, T_sim_true):
    """Tilt and yaw in degrees, origin in millimetres."""
    E = aligned.T_sim_world @ T_world_true @ invert_T(T_sim_true)
    tilt = np.degrees(np.arccos(np.clip(E[2, 2], -1, 1)))
    return tilt, abs(np.degrees(np.arctan2(E[1, 0], E[0, 0]))), 1000 * np.linalg.norm(E[:3, 3])


@pytest.fixture(scope="module")
def scene(render, course, walk):
    """The course as a walk round it sees it."""
    return render(course, walk())


@pytest.fixture(scope="module")
def here(scene):
    return align(scene, CONFIG)


@pytest.fixture(scope="module")
def there(render, course, walk, askew):
    """The same in a world that lies askew."""
    return align(render(course, walk(), T_world_true=askew), CONFIG)


def test_frame_of_a_course_in_a_world_askew(there, askew):
    aligned = there
    tilt, yaw, origin = errors(aligned, askew, truth())
    assert tilt < 0.1
    assert yaw < 0.3
    assert origin < 5
    start, goal = aligned.platform("start"), aligned.platform("goal")
    np.testing.assert_allclose(start.centroid, 0, atol=1e-6)
    np.testing.assert_allclose(start.size, [0.8, 0.7, 0.30], atol=0.012)
    np.testing.assert_allclose(goal.size, [0.8, 0.7, 0.25], atol=0.012)
    assert abs(goal.centroid[1]) < 1e-6
    assert goal.centroid[0] == pytest.approx(np.hypot(2.4, 0.3), abs=0.006)
    assert aligned.ground_z == pytest.approx(-0.30, abs=0.004)
    n, d = aligned.gravity.normal_world, aligned.gravity.offset_world
    on_floor = transform(askew, np.array([[0.0, 0, 0], [2, 1, 0]]))
    np.testing.assert_allclose(on_floor @ n + d, 0, atol=0.004)


def test_the_result_does_not_depend_on_how_the_world_lies(here, there, askew):
    np.testing.assert_allclose(there.T_sim_world @ askew, here.T_sim_world, atol=1e-5)
    assert there.gravity.tilt_sigma_deg == pytest.approx(here.gravity.tilt_sigma_deg, rel=1e-3)


def test_same_input_same_output(scene, here):
    again = align(scene, CONFIG)
    np.testing.assert_array_equal(again.T_sim_world, here.T_sim_world)
    np.testing.assert_array_equal(again.bounds, here.bounds)


def test_walls_and_clutter_are_cut_away_and_said(here):
    aligned = here
    low, high = aligned.bounds
    for corner in ([-0.4, -0.35, -0.3], [2.8, 0.65, 0.0]):
        inside = transform(truth(), np.add(corner, [0, 0, 0.3]))
        assert (inside[:2] > low[:2]).all()
        assert (inside[:2] < high[:2]).all()
    wall, clutter = transform(truth(), np.array([[1.2, 2.95, 1.0], [1.0, -2.2, 0.4]]))
    assert wall[1] > high[1]
    assert clutter[1] < low[1]
    assert low[2] < aligned.ground_z < high[2]
    assert any("object" in said for said in aligned.cropped)
    assert any("wall" in said for said in aligned.cropped)


def test_a_capture_upside_down_is_right_and_said(render, course, walk, askew):
    aligned = align(render(course, walk(roll=np.pi), T_world_true=askew), CONFIG)
    tilt, yaw, origin = errors(aligned, askew, truth())
    assert tilt < 0.1
    assert yaw < 0.3
    assert origin < 5
    assert any("upside down" in w for w in aligned.warnings)


def test_a_camera_held_sideways_needs_no_word(render, course, walk):
    aligned = align(render(course, walk(roll=np.pi / 2)), CONFIG)
    assert errors(aligned, np.eye(4), truth())[0] < 0.1
    assert not any("upside" in w for w in aligned.warnings)


def test_no_platforms_still_give_a_level_scene(render, walk, askew):
    poses = walk()
    aligned = align(render([((1.2, 0.1, 0.0), (0.2, 0.2, 0.2), 0.2)], poses, T_world_true=askew), CONFIG)
    assert aligned.platforms == ()
    assert any("no platform" in a for a in aligned.assumptions)
    E = aligned.T_sim_world @ askew
    assert np.degrees(np.arccos(min(1, E[2, 2]))) < 0.1
    foot = transform(E, np.array([*poses[0][:2, 3], 0.0]))
    np.testing.assert_allclose(foot, 0, atol=0.01)
    view = E[:3, :3] @ poses[0][:3, 2]
    assert abs(np.degrees(np.arctan2(view[1], view[0]))) < 0.1


def test_no_ground_is_refused(render, walk):
    wall = [((5.0, 0.0, -2.0), (0.1, 8.0, 6.0), 0.0)]
    poses = [make_T(walk(1)[0][:3, :3], [0, 0, 1.2])]
    level = make_T(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), [2.0, 0, 1.2])
    with pytest.raises(AlignError, match="no ground"):
        align(render(wall, [level], floor=False, up_world=np.array([0, 0, 1.0])), CONFIG)
    with pytest.raises(AlignError, match="no ground"):
        align(render(wall, [level], floor=False), CONFIG)
    with pytest.raises(AlignError, match="no points"):
        align(render([], poses, floor=False), CONFIG)


def test_a_wall_in_front_is_not_the_ground(render):
    """One view, looking ahead: much wall, little floor."""
    level = make_T(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), [0.0, 0, 0.6])
    aligned = align(render([((2.5, 0.0, 0.0), (0.1, 8.0, 6.0), 0.1)], [level]), CONFIG)
    assert aligned.gravity.normal_world[2] > 0.9999


def test_two_grounds_the_lower_is_taken_and_both_are_named(render, walk):
    stage = ((1.2, 2.3, 0.0), (6.0, 3.0, 0.25), 0.0)
    aligned = align(render([stage], walk()), CONFIG)
    assert any("two grounds" in w for w in aligned.warnings)
    assert abs((aligned.T_sim_world[:3, :3] @ [0, 0, 1.0])[2]) > 0.9999
    n, d = aligned.gravity.normal_world, aligned.gravity.offset_world
    assert d == pytest.approx(0.0, abs=0.01)
    assert n[2] > 0.9999


def valley(slope):
    """Two long slabs that meet in a ditch along y: both lie under everything, neither is level."""
    c, s = np.cos(slope), np.sin(slope)
    points = np.random.default_rng(0).uniform([-3, -3], [3, 3], (60_000, 2))
    z = np.abs(points[:, 0]) * s / c
    return np.column_stack([points, z])


def test_two_inclined_grounds_are_refused_unless_up_is_known(source):
    points = valley(np.radians(12))
    upward = np.column_stack(
        [-np.sign(points[:, 0]) * np.tan(np.radians(12)), np.zeros(len(points)), np.ones(len(points))]
    )
    normals = upward / np.linalg.norm(upward, axis=1)[:, None]
    with pytest.raises(AlignError, match="two grounds"):
        align(Scan(source, "cloud", points, normals=normals, sensor_position=np.array([0, 0, 1.5])), CONFIG)
    known = Scan(source, "cloud", points, normals=normals, sensor_position=np.array([0, 0, 1.5]), up_world=normals[0])
    aligned = align(known, CONFIG)
    assert np.degrees(np.arccos(min(1, aligned.gravity.normal_world @ normals[0]))) < 0.5


def test_start_and_goal_as_requested(scene, here):
    goal = here.platform("goal").centroid
    turned = align(scene, AlignConfig(start=(float(goal[0]), float(goal[1]))))
    np.testing.assert_allclose(transform(turned.T_sim_world @ invert_T(here.T_sim_world), goal), 0, atol=1e-6)
    assert turned.platform("goal").size[2] == pytest.approx(0.30, abs=0.005)


def test_start_by_pixel(scene, here):
    goal = transform(invert_T(here.T_sim_world), here.platform("goal").centroid)
    p = transform(invert_T(scene.T_world_camera[6]), goal)
    camera = scene.frames[6].intrinsics
    pixel = ("0006", int(p[0] / p[2] * camera.fx + camera.cx), int(p[1] / p[2] * camera.fy + camera.cy))
    turned = align(scene, AlignConfig(start_pixel=pixel))
    np.testing.assert_allclose(transform(turned.T_sim_world, goal), 0, atol=1e-6)


@pytest.mark.parametrize(
    ("config", "match"),
    [
        (AlignConfig(start=(9.0, 9.0)), "a platform of"),
        (AlignConfig(start=(0.0, 0.0), goal=(0.1, 0.0)), "same platform"),
        (AlignConfig(start=(0.0, 0.0), start_pixel=("0000", 1, 1)), "twice"),
        (AlignConfig(start_pixel=("nobody", 1, 1)), "nobody"),
        (AlignConfig(goal_pixel=("0000", 900, 1)), "outside"),
    ],
)
def test_what_cannot_be_meant_is_refused(render, course, walk, config, match):
    with pytest.raises(AlignError, match=match):
        align(render(course, walk(8)), config)


def test_an_unknown_segmenter_is_named(render, course, walk):
    with pytest.raises(UnknownNameError, match="geometric"):
        align(render(course, walk(4)), AlignConfig(segmenter="geometrc"))


def test_another_segmenter_can_be_installed(render, course, walk, monkeypatch):
    """An entry point is found by its name, and must return a label a point."""

    package = ModuleType("their_package")
    point = EntryPoint("theirs", "their_package:segment", "realsim.segmenters")
    monkeypatch.setitem(sys.modules, package.__name__, package)
    monkeypatch.setattr("realsim.core.registry.entry_points", lambda group: [point])
    monkeypatch.setattr("realsim.align.segment.SEGMENTERS", Registry("segmenter", {}, "realsim.segmenters"))

    def nothing_but_ground(cloud):
        return np.where(np.abs(cloud.points[:, 2]) < 0.03, 1, 0)

    scene = render(course, walk(6))
    package.segment = nothing_but_ground
    aligned = align(scene, AlignConfig(segmenter="theirs"))
    assert aligned.platforms == ()
    assert aligned.statistics["labels"]["obstacle"] == 0
    package.segment = lambda cloud: np.full(3, 7)
    with pytest.raises(AlignError, match="contract"):
        align(scene, AlignConfig(segmenter="theirs"))


MIDDLE, HALF = np.array([1.2, 0.1]), np.array([1.9, 1.0])
"""Of the floor of a mesh made by hand, metres: as much of it as stands out from the course. It is sampled densely."""


def mesh_of(boxes, half=HALF):
    """Vertices and triangles of boxes on a floor, z up."""
    V = [np.array([[*(MIDDLE + half * s), 0] for s in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)]
    F = [np.array([[0, 1, 2], [0, 2, 3]])]
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    sides = np.array(
        [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
         [1, 3, 5], [3, 7, 5]]
    )  # fmt: skip
    for bottom, extent, yaw in boxes:
        F.append(sides + sum(len(v) for v in V))
        V.append(corners * extent @ exp_so3([0, 0, yaw]).T + bottom)
    return np.concatenate(V), np.concatenate(F).astype(np.int32)


def test_a_mesh_made_by_hand(course, source):
    V, F = mesh_of(course[:4])
    aligned = align(Scan(source, "mesh", V, F), CONFIG)
    tilt, yaw, origin = errors(aligned, np.eye(4), truth())
    assert tilt < 0.05
    assert yaw < 0.5
    assert origin < 8
    assert aligned.scan is not None
    assert aligned.metric is None
    assert len(aligned.assumptions) >= 2


def test_a_cloud_with_y_up_and_no_normals(course, source):
    V, F = mesh_of(course[:4])
    points, _ = sample_scan(V, F, 0)
    T_y_up = make_T(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    aligned = align(Scan(source, "cloud", transform(T_y_up, points)), CONFIG)
    tilt, _, origin = errors(aligned, T_y_up, truth())
    assert tilt < 0.05
    assert origin < 8
    assert any("+y" in a for a in aligned.assumptions)


def test_a_sparse_cloud_is_looked_at_more_coarsely(course, source):
    V, F = mesh_of(course[:4], np.array([3.0, 3.0]))
    points, _ = sample_scan(V, F, 0)
    rng = np.random.default_rng(0)
    sparse = points[rng.choice(len(points), int(0.06 * len(points)), replace=False)]  # 1200 a square metre
    sparse = sparse + 0.003 * rng.standard_normal(sparse.shape)
    aligned = align(Scan(source, "cloud", sparse, up_world=np.array([0.0, 0, 1])), CONFIG)
    tilt, yaw, origin = errors(aligned, np.eye(4), truth())
    assert tilt < 0.1
    assert yaw < 1
    assert origin < 15


def test_a_scan_that_knows_up_is_believed(course, source):
    V, F = mesh_of(course[:4])
    T = make_T(exp_so3([2.0, 0.5, -1.0]))
    aligned = align(Scan(source, "mesh", transform(T, V), F, up_world=T[:3, 2]), CONFIG)
    assert errors(aligned, T, truth())[0] < 0.05


ASKEW = make_T(exp_so3([2.0, 0.5, -1.0]))
LYING = make_T(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
HEAD_DOWN = make_T(exp_so3([np.pi, 0, 0]))


def plinth(boxes, thickness=0.1):
    """The same with sides and an underside: every piece is closed."""
    return mesh_of([((*MIDDLE, -thickness), (*2 * HALF, thickness), 0.0), *boxes], 0 * HALF)


def turned(T, V, F, up=None):
    return inside_out(*sample_scan(transform(T, V), F, 0), up)


@pytest.mark.parametrize(
    ("closed", "up_known", "T"),
    [(False, False, ASKEW), (True, True, LYING)],
)
def test_a_mesh_wound_inside_out_gives_the_same_scene(course, source, closed, up_known, T):
    V, F = plinth(course[:4]) if closed else mesh_of(course[:4])
    scan = Scan(source, "mesh", transform(T, V), F, up_world=T[:3, 2] if up_known else None)
    right, wrong = align(scan, CONFIG), align(replace(scan, triangles=F[:, ::-1].copy()), CONFIG)
    assert errors(right, T, truth())[0] < 0.05
    np.testing.assert_allclose(wrong.T_sim_world, right.T_sim_world, atol=2e-3)  # other samples
    assert len(wrong.platforms) == len(right.platforms)
    assert not any("inside out" in a for a in right.assumptions)
    assert any("inside out" in a for a in wrong.assumptions)


@pytest.mark.parametrize("T", [LYING, ASKEW])
def test_a_mesh_of_right_winding_is_left_alone(course, T):
    """Whatever its axis; and a room seen from inside is no block inside out."""
    for V, F in (mesh_of(course[:4]), plinth(course[:4])):
        assert not turned(T, V, F)
        assert not turned(T, V, F, T[:3, 2])
    assert turned(T, V, F[:, ::-1])  # a closed one
    V, F = mesh_of([((0, 0, 0), (5.0, 4.0, 2.5), 0.0)], 0 * HALF)
    assert not turned(T, V, F[:, ::-1], T[:3, 2])


def test_what_lies_under_a_floor_that_faces_up_in_its_file_is_a_pit(course):
    V, F = mesh_of(course[:4])
    assert not turned(HEAD_DOWN, V, F[:, ::-1])


@pytest.mark.parametrize(
    ("thickness", "T"),
    [(0.005, ASKEW), (0.05, HEAD_DOWN), (0.3, LYING)],
)
def test_of_a_slab_under_a_course_the_upper_face_is_the_ground(course, source, thickness, T):
    """Thinner or thicker than a voxel. Where no axis of the file points up, or the one that is believed points down
    (a low course hangs under its slab nearly as well as it stands on it), that is a warning and a question."""
    V, F = plinth(course[:4], thickness)
    aligned = align(Scan(source, "mesh", transform(T, V), F), CONFIG)
    assert any("?" in w and "up" in w for w in aligned.warnings) == (T is HEAD_DOWN or T is ASKEW)
    if T is not HEAD_DOWN:
        assert errors(aligned, T, truth())[0] < 0.05
        assert aligned.ground_z == pytest.approx(-0.30, abs=0.005)


def test_the_axis_of_the_file_is_believed_where_nothing_tells(source):
    """A bare slab stands on either face."""
    V, F = plinth([], 0.02)
    aligned = align(Scan(source, "mesh", V, F), CONFIG)
    assert aligned.T_sim_world[2, 2] == pytest.approx(1, abs=1e-6)
    assert not aligned.warnings


def test_a_scanner_that_knows_where_it_stood_starts_nearest(course, source):
    V, F = mesh_of(course[:4])
    aligned = align(Scan(source, "cloud", V, F, sensor_position=np.array([2.9, 1.0, 1.5])), CONFIG)
    assert errors(aligned, np.eye(4), truth((2.4, 0.3, 0.25), (0, 0, 0.30)))[2] < 8
    assert not any("sensor stood" in a for a in aligned.assumptions)


def test_a_scan_of_nothing_is_refused(source):
    with pytest.raises(AlignError, match="too few"):
        align(Scan(source, "cloud", np.zeros((3, 3))), CONFIG)


@pytest.mark.parametrize("turn", [-44.0, -10.0, 0.0, 30.0, 44.0])
def test_without_a_goal_x_is_along_the_walls_that_are_nearest(turn: float) -> None:
    """Of a room turned by so many degrees; a round post on a floor turns nothing."""
    rng = np.random.default_rng(0)
    angle = np.radians(turn + 90 * rng.integers(4, size=2000)) + rng.normal(0, 0.1, 2000)
    walls = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    floor = np.tile([0.0, 0.0, 1.0], (2000, 1))
    x = along_walls(np.concatenate([walls, floor]))
    assert np.degrees(np.arctan2(x[1], x[0])) == pytest.approx(turn, abs=1.0)
    around = rng.uniform(-np.pi, np.pi, 2000)
    post = np.column_stack([np.cos(around), np.sin(around), 0 * around])
    np.testing.assert_array_equal(along_walls(np.concatenate([post, floor])), [1, 0])
