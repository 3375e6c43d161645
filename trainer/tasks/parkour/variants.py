"""A terrain in several sizes: what the scale of a reconstruction leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trainer.tasks.parkour.config import RandomisationConfig
from trainer.terrain import Box, Platform, Terrain

_MANY = 13
"""Terrains from which on one size each is enough: a generated grid is random already."""


def sizes(terrains: Sequence[Terrain], config: RandomisationConfig) -> list[float]:
    """The scales in which every terrain is made, the true one in the middle."""
    count = config.terrain_variants or (5 if len(terrains) <= _MANY else 1)
    return [1.0] if count == 1 or not config.use else np.linspace(*config.terrain_scale, count).tolist()


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
    import mujoco

    copy = spec.copy()
    for geom in copy.worldbody.geoms:
        geom.pos = np.asarray(geom.pos) * ratio
        if geom.type not in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD):
            geom.size = np.asarray(geom.size) * ratio
    for mesh in copy.meshes:
        mesh.scale = np.asarray(mesh.scale) * ratio
    for field in copy.hfields:
        field.size = np.asarray(field.size) * ratio
    return copy


def _scaled_pose(T: np.ndarray, ratio: float) -> np.ndarray:
    moved = T.copy()
    moved[:3, 3] *= ratio
    return moved


def _scaled_platform(platform: Platform, ratio: float) -> Platform:
    return replace(platform, centre=platform.centre * ratio, size=platform.size * ratio)
