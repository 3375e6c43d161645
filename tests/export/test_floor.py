"""The floor: whole beside pits, and what hangs above it with no top of its own."""

import numpy as np
import pytest

from realsim.core.types import TerrainMesh
from realsim.export.contact.base import floor_around
from realsim.export.contact.boxes import boxes
from realsim.export.contact.probe import BALL, SimTouch, first_touch, spec_of
from realsim.export.contact.shape import Shape
from tests.export.measured import CONFIG, FACING_UP, fidelity
from tests.export.test_contact import underside
from tests.truths.solids import block, with_floor


def test_a_pit_leaves_the_floor_beside_it_whole() -> None:
    """Boxes around a hole for each pit, prisms in the holes alone; nothing falls through where they meet."""
    slab = block(0, 0, 4, 3, 0.0, -0.4)
    for x, y in ((1.2, 0.5), (-1.0, -0.6)):
        slab -= block(x, y, 0.3, 0.3, 0.1, -0.1)
    mesh = with_floor(slab + block(0, 0, 0.3, 0.3, 0.3, -0.2), margin=-0.5)
    mesh = TerrainMesh(mesh.vertices, mesh.triangles[:-2], None, mesh.invented[:-2], mesh.quality, "", 0.0)
    contact = boxes(Shape(mesh, 0.0), CONFIG)
    assert sum(g.name.startswith("floor") for g in contact.geoms) < 10
    assert len(contact.geoms) < 30
    f = fidelity(contact, mesh, probes=900, feet=0)
    assert f["max_mm"] < 10
    assert f["leaks"] == 0


def test_a_pit_that_no_camera_saw_is_not_dug() -> None:
    """A mesh was closed below the floor where things stood in the way of it."""
    slab = block(0, 0, 2, 2, 0.0, -0.4) - block(0.3, 0, 0.4, 0.5, 0.1, -0.05)
    mesh = with_floor(slab, margin=-0.5)
    corners = mesh.vertices[mesh.triangles[:-2]]
    bottom = (np.abs(corners[:, :, 2] + 0.05) < 1e-6).all(1)
    for invented, kinds in ((bottom, {"plane"}), (~bottom, {"box", "mesh"})):
        seen = TerrainMesh(mesh.vertices, mesh.triangles[:-2], None, invented, mesh.quality, "", 0.0)
        assert {g.type for g in boxes(Shape(seen, 0.0), CONFIG).geoms} <= kinds


def test_boxes_around_holes_cover_the_floor_and_leave_the_holes() -> None:
    holes = np.array([[[0, 0], [1, 1]], [[2, 0.5], [3, 2.0]], [[0.2, 3], [0.8, 4.0]]])
    floor = floor_around(holes, 0.3, reach=2.0)
    points = np.random.default_rng(0).uniform([-2, -2], [5, 6], (4000, 2))
    inside = ((points[:, None] > holes[:, 0]) & (points[:, None] < holes[:, 1])).all(2).any(1)
    centre, half = np.array([g.pos for g in floor]), np.array([g.size for g in floor])
    covered = (np.abs(points[:, None] - centre[:, :2]) <= half[:, :2]).all(2).any(1)
    np.testing.assert_array_equal(covered, ~inside)
    np.testing.assert_allclose(centre[:, 2] + half[:, 2], 0.3)


def test_what_was_seen_from_below_alone_is_a_sheet() -> None:
    """The tread of an open staircase, of which the cameras saw the underside."""
    mesh = with_floor(block(0, 0, 0.4, 0.3, 0.3, 0.25))
    corners = mesh.vertices[mesh.triangles]
    top = (corners[:, :, 2] > 0.29).all(1)
    mesh = TerrainMesh(mesh.vertices, mesh.triangles[~top], None, mesh.invented[~top], mesh.quality, "", 0.0)
    contact = boxes(Shape(mesh, 0.0), CONFIG)
    assert underside(contact) == pytest.approx(0.25, abs=0.001)
    touch = SimTouch(spec_of(contact), BALL)
    t = first_touch(touch.clearance, np.array([[0, 0, 0.6]]), FACING_UP[None], np.array([[0, 0, -1.0]]), 1.0)
    assert 0.6 - t[0] - 0.01 == pytest.approx(0.26, abs=0.001)
