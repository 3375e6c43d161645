"""The same course with wider tops: no point of it lies lower, and its tops are as high as before."""

import mujoco
import numpy as np
import pytest

from trainer import terrain as terrains
from trainer.terrain import Terrain
from trainer.terrain.edges import convex_parts
from trainer.terrain.widen import LADDER, ladder, widened

LOW = -0.2
"""Metres: what lies higher is a foothold or its flank."""


def heights(terrain: Terrain) -> np.ndarray:
    """(N,) of the contact geometry on a grid of 2 cm."""
    far = terrain.goal.centre[0] + 0.3
    axes = np.meshgrid(np.arange(-0.3, far, 0.02), np.arange(-0.5, 0.5, 0.02), indexing="ij")
    xy = np.stack(axes, -1).reshape(-1, 2)
    out = np.full(len(xy), terrain.floor_z)
    for part in convex_parts(terrain):
        up = part.normals[:, 2] > 1e-9
        z = ((part.offsets[up] - xy @ part.normals[up][:, :2].T) / part.normals[up][:, 2]).min(1)
        inside = part.contains(np.column_stack([xy, z - 1e-6]), 1e-6)
        out = np.where(inside, np.maximum(out, z), out)
    return out


@pytest.mark.parametrize("family", terrains.ALL)
def test_tops_grow_and_none_sinks(family: str) -> None:
    true = terrains.generate(family, 1.0, 3)
    before, after = heights(true), heights(widened(true, 0.12))
    assert (after >= before - 1e-9).all()
    assert (after > LOW).sum() > 1.1 * (before > LOW).sum()
    assert after.max() < before.max() + 0.025  # a wedge of 20 degrees, continued by 6 cm


def test_a_beam_is_wider_by_what_is_asked() -> None:
    true = terrains.generate("beams", 1.0, 0)
    for old, new in zip(true.boxes, widened(true, 0.05).boxes, strict=True):
        assert new.size - old.size == pytest.approx([0.05, 0.05, 0.0])
        assert pytest.approx(old.T) == new.T


def test_convex_parts_and_fields_of_a_reconstruction_grow() -> None:
    """A box as a mesh, a box, and a field with one raised cell: each is wider by 12 cm at the same height."""
    from dataclasses import replace

    spec = mujoco.MjSpec()
    cube = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.2, 0.0)])
    spec.add_mesh(name="cube", uservert=(cube + np.array([1.0, 0.0, 0.0])).ravel())
    world = spec.worldbody
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="cube")
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1], pos=[2.0, 0, -0.1])
    field = spec.add_hfield(name="field", nrow=21, ncol=21, size=[0.2, 0.2, 1.0, 0.1])
    raised = np.zeros((21, 21))
    raised[10, 10] = 1.0
    field.userdata = raised.ravel()
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field", pos=[3.0, 0, -1.0])
    scene = replace(terrains.generate("beams", 0.5, 0), contact=spec, boxes=())
    wider = widened(scene, 0.12)
    for old, new in zip(convex_parts(scene), convex_parts(wider), strict=True):
        a, b = (np.ptp(np.vstack(part.rings), axis=0) for part in (old, new))
        assert b - a == pytest.approx([0.12, 0.12, 0.0], abs=1e-6)
        assert np.vstack(new.rings).max(0)[2] == pytest.approx(0.0, abs=1e-6)
    model = wider.contact.compile()
    assert int((model.hfield_data > 0.5).sum()) == 7 * 7  # 6 cm are three cells of 2 cm
    assert len(wider.vertices) == len(scene.vertices) + 16  # what rays see: the scan, and the grown parts
    assert spec.compile().mesh_vert.shape == (8, 3)  # the given one is as it was


def test_the_last_rung_is_the_course() -> None:
    course = terrains.generate("stakes", 1.0, 0)
    rungs = ladder((course,))
    assert rungs[-1] is course
    assert list(LADDER) == sorted(LADDER, reverse=True)
    assert len({t.family for t in rungs}) == len(LADDER)
