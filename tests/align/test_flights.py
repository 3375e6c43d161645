"""Stairs are platforms one after another, with a start and a goal; other steep things are not stairs."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold

from realsim.align import align
from realsim.align.config import AlignConfig
from realsim.core.types import AlignedScene, Scan, TerrainMesh
from realsim.meshing import build
from realsim.meshing.config import MeshConfig
from tests.truths.rooms import _level, _seen, open_stairs, room
from tests.truths.solids import block


def aligned(mesh: TerrainMesh, noise: float = 0.0) -> AlignedScene:
    vertices = mesh.vertices + noise * np.random.default_rng(0).standard_normal(mesh.vertices.shape)
    return align(Scan(Path("stairs.ply"), "ply", vertices, mesh.triangles), AlignConfig())


def test_eight_treads_are_eight_platforms_with_a_start_before_them_and_a_goal_on_top() -> None:
    found = aligned(open_stairs())
    heights = sorted(p.size[2] for p in found.platforms)
    assert np.allclose(heights, 0.19 * np.arange(1, 9), atol=0.01)
    goal = found.platform("goal")
    assert found.platform("start") is None  # the way begins on the ground
    assert goal is not None
    assert goal.centroid[2] == pytest.approx(8 * 0.19, abs=0.01)
    assert all(abs(p.size[0] - 0.8) < 0.06 and abs(p.size[1] - 0.26) < 0.06 for p in found.platforms)
    assert found.bounds[1, 2] > max(p.centroid[2] for p in found.platforms)


def test_a_turning_flight_is_one_too() -> None:
    """Four steps ahead and four to the left."""
    places = [(0.3 * k, 0.0, 0.3, 0.8) for k in range(4)] + [(0.9, 0.55 + 0.3 * k, 0.8, 0.3) for k in range(4)]
    whole = block(*places[0], 0.18)
    for k, place in enumerate(places[1:], 2):
        whole += block(*place, 0.18 * k)
    found = aligned(_seen(whole, [_level(-1.5, -1.5, 2.5, 2.5, 0.0)]))
    assert len(found.platforms) == 8


def test_stakes_and_furniture_are_no_flight() -> None:
    """Small tops of rising height, a step apart, are stakes to step on; a table beside a chair is no stair."""
    whole = block(0, 0, 0.2, 0.2, 0.15)
    for k in range(1, 6):
        whole += block(0.3 * k, 0, 0.2, 0.2, 0.15 * (k + 1))
    assert aligned(_seen(whole, [_level(-1, -1, 2.5, 1, 0.0)])).platforms == ()
    assert len(aligned(room()).platforms) <= 3


def edges(going: float, turn: float = 0.0, count: int = 8, rise: float = 0.19) -> TerrainMesh:
    """Front edges of boards, 5 cm high, as they are seen from below, and the ground; each `turn` degrees further."""
    heights = rise * np.arange(1, count + 1)
    angles = np.radians(turn) * np.arange(count)
    left = np.cumsum([[0.0, 0.35]] + [[going * np.cos(a), going * np.sin(a)] for a in angles[:-1]], axis=0)
    sheets = []
    for (x, y), z, a in zip(left, heights, angles, strict=True):
        right = [x + 0.7 * np.sin(a), y - 0.7 * np.cos(a)]
        front = [[x, y, z - 0.05], [*right, z - 0.05], [*right, z], [x, y, z]]
        sheets.append((front, [-np.cos(a), -np.sin(a), 0]))
    return _seen(Manifold(), [_level(-1.5, -1.5, 2.5, 2.5, 0.0), *sheets])


@pytest.mark.parametrize("turn", [0.0, 8.0])
@given(seed=st.integers(0, 100))
@settings(max_examples=2, deadline=None)
def test_a_flight_seen_from_below_reaches_from_edge_to_edge(turn: float, seed: int) -> None:
    """Each tread as high as its edge, as deep as the next edge says; the way begins on the ground and ends on top."""
    rng = np.random.default_rng(seed)
    rise, going = rng.uniform(0.15, 0.22), rng.uniform(0.20, 0.30)
    found = aligned(edges(going, turn, rise=rise), noise=0.002)
    assert np.allclose(sorted(p.size[2] for p in found.platforms), rise * np.arange(1, 9), atol=0.02)
    assert all(p.inferred and p.size[0] > 0.6 for p in found.platforms)
    deep = going - (0.35 * np.radians(turn))  # at the middle of an edge 70 cm wide that turns about its left end
    assert np.median([p.area / 0.7 for p in found.platforms]) == pytest.approx(deep if turn == 0 else going, abs=0.06)
    goal = found.platform("goal")
    assert found.platform("start") is None
    assert goal is not None
    assert goal.size[2] == max(p.size[2] for p in found.platforms)
    assert any("front edges" in said for said in found.assumptions)


def test_shelves_and_two_boards_are_no_flight() -> None:
    """Edges above each other are a bookcase; three boards that rise may be anything."""
    assert aligned(edges(0.0)).platforms == ()
    assert aligned(edges(0.25, count=3)).platforms == ()


def test_an_inferred_tread_is_in_the_scene_and_said() -> None:
    """Its top holds what falls on it, and counts as not seen."""
    scene = aligned(edges(0.26))
    mesh = build(scene, MeshConfig())
    assert mesh.inferred is not None
    assert mesh.invented[mesh.inferred].all()
    corners = mesh.vertices[mesh.carrying]
    for platform in scene.platforms:
        on = np.abs(corners[:, :, 2] - platform.centroid[2]).max(1) < 1e-6
        crosses = np.cross(corners[on, 1] - corners[on, 0], corners[on, 2] - corners[on, 0])
        assert 0.5 * crosses[:, 2].sum() > 0.75 * platform.area
    assert len(mesh.carrying) == len(mesh.seen) + mesh.inferred.sum()
