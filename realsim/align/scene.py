"""`align`: the stage itself, from a metric scene or a scan to the simulation frame."""

from dataclasses import replace

import numpy as np

from realsim.align.cloud import Cloud, from_scan, from_views
from realsim.align.config import AlignConfig
from realsim.align.crop import crop, everything
from realsim.align.ground import Ground, find_ground
from realsim.align.platforms import find_faces, to_platform
from realsim.align.rim import refined
from realsim.align.roles import Roles, as_requested, by_rule, simulation_frame
from realsim.align.segment import Label, segmented
from realsim.core.geometry import invert_T, make_T, transform
from realsim.core.types import F64, AlignedScene, MetricScene, Platform, Scan

UPRIGHT, WALLS, PARALLEL = 0.2, 0.1, 0.3
"""Most |z| of an upright surface's normal; for walls, the least share of a scene that it is, and the least length of
the mean of its directions, by quarter turns. A LiDAR room has 0.14 and 0.5, a made corridor 0.55 and 0.95; stairs in
a niche 0.5 and 0.2."""


def align(source: MetricScene | Scan, config: AlignConfig) -> AlignedScene:
    """Put a metric scene or a scan into the simulation frame.

    Origin at the centroid of the start platform's top face, z against gravity, x from the start platform's centroid
    toward the goal's. Without a start: origin on the ground below the first camera; without a goal: x along its view,
    or along the walls that are nearest to that.

    Everything is computed relative to the first camera, so that the result does not depend on how the capture's
    world happens to lie; `T_sim_world` leads from that world.

    Raises:
        AlignError: no ground; two grounds that cannot be distinguished; no platform where one was requested.
    """
    if isinstance(source, Scan):
        cloud, T_cloud_world = from_scan(source, config.seed), np.eye(4)
    else:
        T_cloud_world = invert_T(source.T_world_camera[0])
        cloud = from_views(replace(source, T_world_camera=T_cloud_world @ source.T_world_camera))
    up = None if source.up_world is None else T_cloud_world[:3, :3] @ source.up_world
    ground = find_ground(cloud, config.seed, up)
    T_level_cloud = levelling(ground, cloud)
    level = _moved(cloud, T_level_cloud)
    if level.closed:
        level = level.take(level.normals[:, 2] > -0.5)  # what lies under the solids is out of sight
    labels = segmented(config.segmenter, level)
    faces = find_faces(level, labels)
    assumptions, warnings = list(ground.assumptions), list(ground.warnings)
    if cloud.turned:
        assumptions.append("the mesh is wound inside out: its triangles were flipped")

    inferred = sum(face.inferred for face in faces)
    if inferred:
        assumptions.append(
            f"a flight of stairs: of {inferred} treads the front edges were seen, not all of the tops, which are taken "
            "to be level and to reach back to the next edge"
        )

    T_level_world = T_level_cloud @ T_cloud_world
    if isinstance(source, MetricScene):
        faces = refined(faces, source, T_level_world)
    # The levelled frame's origin lies below the first camera: the nearer platform is the one nearer to it.
    ahead = along_walls(level.normals) if cloud.held else np.array([1.0, 0.0])
    roles = as_requested(faces, by_rule(faces, np.zeros(2)), ahead, source, config, T_level_world)
    assumptions += _assumed(roles, source, len(level.cameras) > 0)
    T_sim_level = simulation_frame(faces, roles, ahead)
    platforms = tuple(
        to_platform(face, T_sim_level, {roles[0]: "start", roles[1]: "goal"}.get(i, "platform"))
        for i, face in enumerate(faces)
    )
    cropped: list[str] = []
    if config.keep == "all":
        bounds = everything(_moved(level, T_sim_level))
    else:
        bounds, cropped = crop(_moved(level, T_sim_level), labels, platforms, float(T_sim_level[2, 3]), config.margin)

    platforms, outside = _kept(platforms, bounds)
    cropped += outside
    if isinstance(source, MetricScene):
        cropped = [*source.statistics.get("left_out", ()), *cropped]

    T_sim_world = T_sim_level @ T_level_world
    # n·x + d = 0 in the cloud's frame, expressed in the capture's world.
    normal = ground.gravity.normal_world
    offset = ground.gravity.offset_world + float(normal @ T_cloud_world[:3, 3])
    return AlignedScene(
        T_sim_world=T_sim_world,
        gravity=replace(ground.gravity, normal_world=T_cloud_world[:3, :3].T @ normal, offset_world=offset),
        ground_z=float(T_sim_level[2, 3]),
        platforms=platforms,
        bounds=bounds,
        metric=source if isinstance(source, MetricScene) else None,
        scan=source if isinstance(source, Scan) else None,
        cropped=tuple(cropped),
        assumptions=tuple(assumptions),
        warnings=tuple(warnings),
        statistics={
            "voxels": len(cloud),
            "labels": {label.name.lower(): int(np.count_nonzero(labels == label)) for label in Label},
            "ground_candidates": [dict(c) for c in ground.candidates[:6]],
        },
    )


def levelling(ground: Ground, cloud: Cloud) -> F64:
    """(4, 4) T_level_cloud: z up, ground at z = 0, origin below the first camera, x along its view in the plan.

    Where it looks straight down, x is the direction of the image's upper side. Scans: origin below the sensor, or
    the source's origin if that is not known, x along the source's own x (or z, where x is up).
    """
    z = ground.plane.normal
    origin = cloud.cameras[0, :3, 3] if len(cloud.cameras) else np.zeros(3)
    ahead = [np.eye(3)[0], np.eye(3)[2]]
    if cloud.held:
        ahead = [cloud.cameras[0, :3, 2], -cloud.cameras[0, :3, 1]]
    forward = next(a for a in ahead if np.linalg.norm(a - (a @ z) * z) > 0.2)
    x = forward - (forward @ z) * z
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    foot = origin - ground.plane.height(origin) * z
    return make_T(R, -R @ foot)


def along_walls(normals: F64) -> F64:
    """(2,) unit x of a levelled frame, turned by at most 45 degrees onto the directions of most upright surface; left
    as it is where that has none. Boxes about walls that lie across the axes hold half a room: a simulator then
    collides everything in it (G1 in a scanned room: 1.7 times the time for pairs).

    Args:
        normals: (M, 3) unit, in the levelled frame.
    """
    across = normals[np.abs(normals[:, 2]) < UPRIGHT]
    mean = np.exp(4j * np.arctan2(across[:, 1], across[:, 0])).sum() / max(len(across), 1)
    turn = np.angle(mean) / 4 if len(across) > WALLS * len(normals) and np.abs(mean) > PARALLEL else 0.0
    return np.array([np.cos(turn), np.sin(turn)])


def _kept(platforms: tuple[Platform, ...], bounds: F64) -> tuple[tuple[Platform, ...], list[str]]:
    """The platforms that stand within the bounds as a whole, and in words the others: nothing can stand on those."""
    low, high = bounds[0, :2], bounds[1, :2]
    inside = tuple(p for p in platforms if ((p.outline >= low) & (p.outline <= high)).all())
    outside = [
        f"a level top of {p.size[0]:.2f} x {p.size[1]:.2f} m at x {p.centroid[0]:.1f}, y {p.centroid[1]:.1f} m, outside"
        for p in platforms
        if not any(p is q for q in inside)
    ]
    return inside, outside


def _moved(cloud: Cloud, T: F64) -> Cloud:
    return replace(
        cloud, points=transform(T, cloud.points), normals=cloud.normals @ T[:3, :3].T, cameras=T @ cloud.cameras
    )


def _assumed(roles: Roles, source: MetricScene | Scan, stood: bool) -> list[str]:
    """Assumptions of the frame that the capture does not settle."""
    start, goal = roles
    seen = stood and isinstance(source, MetricScene)
    ahead = "the first camera's view or walls near it" if seen else "the source's own x"
    below = "the first camera" if isinstance(source, MetricScene) else "the sensor" if stood else "the source's origin"
    if start is None and goal is not None:
        return [f"the way begins on the ground: the origin is below {below}, x toward the goal"]
    if start is None:
        return [f"no platform was found: the origin is on the ground below {below}, x along {ahead}"]
    if goal is None:
        return [f"only one platform was found: it is the start, and x is along {ahead}"]
    if not stood:
        return ["the scan does not say where its sensor stood: the platform nearer its origin is the start"]
    return []
