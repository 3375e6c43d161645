"""The same terrain changed as a diagnosis or the doubt of a scale has it: larger, or with pieces at other heights."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from realsim.core.geometry import make_T
from trainer.physics.world import SLOT
from trainer.terrain.base import Box, Platform, Terrain
from trainer.terrain.shapes import mesh

_NEAR_M = 0.03
"""Points of the scan this near to a piece's box belong to it."""


def scaled(terrain: Terrain, ratio: float) -> Terrain:
    """The same course, larger by `ratio` about the origin."""
    if ratio == 1.0:
        return terrain
    return replace(
        terrain,
        boxes=tuple(Box(b.size * ratio, _scaled_pose(b.T, ratio)) for b in terrain.boxes),
        vertices=terrain.vertices * ratio,
        start=_scaled_platform(terrain.start, ratio),
        goal=_scaled_platform(terrain.goal, ratio),
        floor_z=terrain.floor_z * ratio,
        contact=None if terrain.contact is None else scaled_spec(terrain.contact, ratio),
    )


def scaled_spec(spec: Any, ratio: float) -> Any:
    """A copy of a `mujoco.MjSpec` whose world geoms (primitives, meshes, height fields) are larger by `ratio`."""
    copy = spec.copy()
    for geom in copy.worldbody.geoms:
        geom.pos = np.asarray(geom.pos) * ratio
        if geom.type not in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD):
            geom.size = np.asarray(geom.size) * ratio
    for part in copy.meshes:
        part.scale = np.asarray(part.scale) * ratio
    for field in copy.hfields:
        field.size = np.asarray(field.size) * ratio
    return copy


def _scaled_pose(T: np.ndarray, ratio: float) -> np.ndarray:
    moved = T.copy()
    moved[:3, 3] *= ratio
    return moved


def _scaled_platform(platform: Platform, ratio: float) -> Platform:
    return replace(platform, centre=platform.centre * ratio, size=platform.size * ratio)


def shifted(
    terrains: Sequence[Terrain], heights: Mapping[str, tuple[float, float]]
) -> tuple[list[Terrain], tuple[str, ...]]:
    """The terrains with pieces moved up by the middle of their interval, and names that no terrain has.

    Rays see the moved pieces too.

    Args:
        heights: `slotK` for box K of generated terrain, or the name of a geom of a scene -> (low, high) metres.
    """
    middles = {name: (low + high) / 2 for name, (low, high) in heights.items()}
    found: set[str] = set()
    moved = [_moved(terrain, middles, found) for terrain in terrains]
    return moved, tuple(name for name in heights if name not in found)


def _moved(terrain: Terrain, heights: Mapping[str, float], found: set[str]) -> Terrain:
    if terrain.contact is not None:
        return _moved_scene(terrain, heights, found)
    named = {f"{SLOT}{k}" for k in range(len(terrain.boxes))} & heights.keys()
    if not named:
        return terrain
    found |= named
    boxes = tuple(
        replace(box, T=make_T(box.T[:3, :3], np.add(box.T[:3, 3], [0, 0, heights.get(f"{SLOT}{k}", 0.0)])))
        for k, box in enumerate(terrain.boxes)
    )
    vertices, triangles = mesh(boxes)
    return replace(terrain, boxes=boxes, vertices=vertices, triangles=triangles)


def _moved_scene(terrain: Terrain, heights: Mapping[str, float], found: set[str]) -> Terrain:
    named = {g.name for g in terrain.contact.geoms} & heights.keys()
    if not named:
        return terrain
    found |= named
    contact, vertices = terrain.contact.copy(), terrain.vertices.copy()
    model = contact.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in named:
        geom = model.geom(name).id
        local = (terrain.vertices - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        inside = np.all(abs(local - centre) < half + _NEAR_M, axis=1)
        vertices[inside, 2] += heights[name]
        contact.geom(name).pos = np.add(contact.geom(name).pos, [0, 0, heights[name]])
    return replace(terrain, contact=contact, vertices=vertices)
