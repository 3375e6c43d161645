"""Terrains: closed, reproducible, harder when asked; edges are where a foothold ends and nowhere else."""

import json
from itertools import pairwise

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim import robots
from realsim.core.errors import UnknownNameError
from realsim.core.geometry import transform
from trainer.errors import TrainerError
from trainer.terrain import FAMILIES, TESTS, flat, generate, grid, named
from trainer.terrain.base import Box, Platform, Terrain
from trainer.terrain.edges import feature_edges
from trainer.terrain.scene import load
from trainer.terrain.shapes import block, mesh

BOX = np.array([0.9, 0.8])


def of_boxes(*boxes: Box) -> Terrain:
    vertices, triangles = mesh(boxes)
    return Terrain("made", boxes, vertices, triangles, Platform(np.zeros(3), BOX), Platform(np.ones(3), BOX), 0.0)


def edge_length(terrain: Terrain) -> float:
    edges = feature_edges(terrain)
    return float(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum())


@settings(max_examples=20, deadline=None)
@given(family=st.sampled_from(list(FAMILIES)), difficulty=st.floats(0, 1), seed=st.integers(0, 10**6))
def test_every_terrain_is_closed_and_lies_between_its_platforms(family, difficulty, seed):
    terrain = generate(family, difficulty, seed)
    a, b, c = (terrain.vertices[terrain.triangles[:, k]] for k in range(3))
    # A closed mesh has no net area vector, and outward triangles enclose the boxes' volume (divergence theorem).
    assert np.allclose(np.cross(b - a, c - a).sum(0), 0, atol=1e-9)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(sum(np.prod(box.size) for box in terrain.boxes))
    assert np.allclose(terrain.start.centre, 0)
    assert terrain.goal.centre[1] == pytest.approx(0, abs=1e-12)
    assert 2.5 < terrain.goal.centre[0] < 5.0
    assert terrain.floor_z == pytest.approx(-0.35)
    assert terrain.vertices[:, 2].max() < 0.35


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_seed_gives_the_same_terrain_and_another_does_not(family):
    first, again, other = (generate(family, 0.7, seed) for seed in (5, 5, 6))
    assert np.array_equal(first.vertices, again.vertices)
    assert not np.array_equal(first.vertices, other.vertices)


def test_harder_terrain_has_less_to_stand_on():
    for family in ("stakes", "boxes", "beams"):
        area = [sum(b.size[0] * b.size[1] for b in generate(family, d, 1).boxes[2:]) for d in (0.0, 0.5, 1.0)]
        assert area[0] > area[1] > area[2], family


def test_the_grid_has_ten_rows_of_five_families_in_four_columns():
    terrains = grid(seed=2)
    assert len(terrains) == 200
    assert [t.family for t in terrains[:20:4]] == ["wedges", "stakes", "boxes", "trapezoids", "beams"]
    assert [round(9 * terrains[20 * row + 7].difficulty) for row in range(10)] == list(range(10))
    assert len({t.name for t in terrains}) == 200


@settings(max_examples=20, deadline=None)
@given(difficulty=st.floats(0, 1), seed=st.integers(0, 10**6))
def test_a_bend_leads_from_platform_to_platform_in_steps_that_a_robot_can_take(difficulty, seed):
    terrain = generate("bends", difficulty, seed)
    start, goal, *boxes = terrain.boxes
    for platform, box in ((terrain.start, start), (terrain.goal, goal)):
        corners = transform(box.T, box.size / 2 * [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
        assert np.allclose(corners[:, :2], platform.corners())
    way = [(b.T[:2, 3], b.size[0] / 2) for b in boxes]
    assert all(np.linalg.norm(q - p) < a + b + 0.25 for (p, a), (q, b) in pairwise(way))
    for platform, (middle, half) in ((terrain.start, way[0]), (terrain.goal, way[-1])):
        corner = float(np.hypot(*platform.size)) / 2
        assert np.linalg.norm(middle - platform.centre[:2]) < corner + half + 0.25
        assert not platform.contains(middle[None]).any()


def test_there_are_thirteen_named_tests():
    assert len(TESTS) == 13
    assert named("boston").family == "boston"
    with pytest.raises(UnknownNameError, match="stake1"):
        named("stake9")


def test_difficulty_outside_its_range_is_refused():
    with pytest.raises(TrainerError, match="between 0 and 1"):
        generate("boxes", 1.5, 0)


def test_a_lone_block_ends_at_the_four_edges_of_its_top():
    assert edge_length(of_boxes(block(0, 0, (0.6, 0.4, 0.3)))) == pytest.approx(2 * (0.6 + 0.4))


def test_a_joint_between_level_blocks_is_no_edge_but_a_step_down_is():
    level = of_boxes(block(-0.3, 0, (0.6, 0.4, 0.3)), block(0.3, 0, (0.6, 0.4, 0.3)))
    assert edge_length(level) == pytest.approx(2 * (1.2 + 0.4), abs=0.1)
    step = of_boxes(block(-0.3, 0, (0.6, 0.4, 0.3)), block(0.3, 0, (0.6, 0.4, 0.2)))
    # The upper block keeps its four edges; the lower one loses the one under the step.
    assert edge_length(step) == pytest.approx(2 * 1.0 + 2 * 0.6 + 0.4, abs=0.1)


def test_flat_ground_has_no_edges_and_forgives_touching_it():
    assert feature_edges(flat()).shape == (0, 2, 3)
    assert not flat().ground_fails


@pytest.fixture
def scene(tmp_path):
    """A scene as `realsim reconstruct` lays it out: two platforms, a scanned scrap of ground, one drawn mesh."""
    spec = mujoco.MjSpec()
    add = spec.worldbody.add_geom
    add(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, -0.3])
    for i, x in enumerate((0.0, 2.0)):
        add(name=f"part_{i}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.4, 0.4, 0.15], pos=[x, 0, -0.15])
    add(name="scrap", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.01], pos=[1, 1, -0.3])
    add(name="seen", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0], contype=0, conaffinity=0)
    spec.compile()
    (tmp_path / "scene.xml").write_text(spec.to_xml())
    parts = [trimesh.creation.box((0.8, 0.8, 0.3)).apply_translation((x, 0, -0.15)) for x in (0.0, 2.0)]
    trimesh.util.concatenate(parts).export(tmp_path / "mesh.ply")
    ends = {role: {"centroid": [x, 0, 0], "size": [0.8, 0.8, 0.3]} for role, x in (("start", 0.0), ("goal", 2.0))}
    (tmp_path / "report.json").write_text(json.dumps({"ground_z": -0.3, **ends}))
    return tmp_path


def test_a_scene_keeps_what_collides_above_the_ground(scene):
    terrain = load(scene)
    assert sorted(g.name for g in terrain.contact.geoms) == ["part_0", "part_1"]
    assert edge_length(terrain) == pytest.approx(2 * 3.2)
    assert terrain.goal.centre[0] == 2.0


def test_a_robot_in_the_scene_is_no_terrain(scene):
    """`realsim reconstruct --robot g1` puts one in; the trainer has its own."""
    bare = load(scene).contact.compile()
    robot = robots.load("quadruped").placed(np.zeros(3)).spec
    (scene / "robot.xml").write_text(robot.to_xml())
    text = (scene / "scene.xml").read_text()
    (scene / "scene.xml").write_text(text.replace("</mujoco>", '<include file="robot.xml"/></mujoco>'))
    model = load(scene).contact.compile()
    assert (model.nbody, model.nu, model.nkey, model.njnt) == (1, 0, 0, 0)
    assert model.ngeom == bare.ngeom


def test_a_platform_lies_as_its_yaw_says(scene):
    """Its report gives the long side first, and the direction of that."""
    report = json.loads((scene / "report.json").read_text())
    report["goal"] |= {"size": [2.0, 0.6, 0.3], "yaw": np.pi / 2}
    (scene / "report.json").write_text(json.dumps(report))
    terrain = load(scene)
    at = np.array([[2.0, 0.9], [2.9, 0.0], [2.25, 0.0]])
    assert terrain.goal.contains(at).tolist() == [True, False, True]
    assert terrain.goal.contains(at, 0.1).tolist() == [True, False, False]
    assert terrain.goal.corners().max(0) == pytest.approx([2.3, 1.0])
    assert terrain.start.yaw == 0.0
    report["goal"]["yaw"] = "north"
    (scene / "report.json").write_text(json.dumps(report))
    with pytest.raises(TrainerError, match="the yaw of the goal platform"):
        load(scene)


def test_a_scene_without_platforms_is_refused(scene):
    (scene / "report.json").write_text(json.dumps({"ground_z": -0.3, "start": None, "goal": None}))
    with pytest.raises(TrainerError, match="no start platform"):
        load(scene)


def test_a_scene_of_the_wrong_scale_is_refused(scene):
    report = json.loads((scene / "report.json").read_text())
    report["goal"]["size"] = [41.0, 40.0, 3.0]
    (scene / "report.json").write_text(json.dumps(report))
    with pytest.raises(TrainerError, match="scale may be wrong"):
        load(scene)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ground_z": None}, "ground_z is not given"),
        ({"ground_z": "low"}, "ground_z is not given"),
        ({"ground_z": 5.0}, "ground is not at a height"),
        ({"start": "there"}, "no start platform"),
        ({"start": {"size": [0.8, 0.8]}}, "centre of the start platform is not given"),
        ({"start": {"size": "big", "centroid": [0, 0, 0]}}, "size of the start platform is not given"),
        ({"goal": {"size": [0.8, 0.8], "centroid": [float("nan"), 0, 0]}}, "centre of the goal platform is not given"),
        ({"goal": {"size": [0.8, 0.8], "centroid": [0, 0, 0]}}, "the same place"),
        ({"goal": {"size": [0.8, 0.8], "centroid": [20, 0, 0]}}, "does not lie on the mesh"),
    ],
)
def test_a_report_that_cannot_be_right_is_refused(scene, change, message):
    report = json.loads((scene / "report.json").read_text()) | change
    (scene / "report.json").write_text(json.dumps(report))
    with pytest.raises(TrainerError, match=message):
        load(scene)


@pytest.mark.parametrize(
    ("name", "message"),
    [("mesh.ply", "cut off"), ("scene.xml", "not plain XML"), ("report.json", "cannot be read")],
)
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_file_that_was_cut_off_is_named(scene, name, message, share):
    path = scene / name
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(TrainerError, match=message) as raised:
        load(scene)
    assert raised.value.file == str(path)


def test_a_report_of_another_kind_is_refused(scene):
    (scene / "report.json").write_text("[]")
    with pytest.raises(TrainerError, match="no report"):
        load(scene)


@pytest.mark.parametrize("name", ["scene.xml", "mesh.ply", "report.json"])
def test_a_folder_that_lacks_a_file_is_named(scene, name):
    (scene / name).unlink()
    with pytest.raises(TrainerError, match=f"no {name}"):
        load(scene)
