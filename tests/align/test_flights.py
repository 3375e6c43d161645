"""Stairs are platforms one after another, with a start and a goal; other steep things are not stairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.rooms import _level, _seen, open_stairs, room
from benchmarks.solids import block
from realsim.align import align
from realsim.align.config import AlignConfig
from realsim.types import AlignedScene, Scan, TerrainMesh


def aligned(mesh: TerrainMesh, noise: float = 0.0) -> AlignedScene:
    vertices = mesh.vertices + noise * np.random.default_rng(0).standard_normal(mesh.vertices.shape)
    return align(Scan(Path("stairs.ply"), "ply", vertices, mesh.triangles), AlignConfig())


def test_eight_treads_are_eight_platforms_with_a_start_and_a_goal() -> None:
    found = aligned(open_stairs())
    heights = sorted(p.size[2] for p in found.platforms)
    assert np.allclose(heights, 0.19 * np.arange(1, 9), atol=0.01)
    start, goal = found.platform("start"), found.platform("goal")
    assert start is not None
    assert goal is not None
    assert abs(goal.centroid[2] - start.centroid[2]) == pytest.approx(7 * 0.19, abs=0.01)
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
