"""A recorded trial as an animated glTF 2.0 binary: any viewer plays it, the camera is the viewer's own."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.files import write_bytes
from realsim.core.types import F64
from realsim.export.gltf import Z_UP_TO_Y_UP, GltfFile
from trainer.physics import PhysicsConfig
from trainer.physics.world import slots_for, world_spec
from trainer.replay import Recording
from trainer.robots import TrainedRobot
from trainer.terrain import Terrain

GROUND_MARGIN = 2.0
"""Metres of ground around the course."""


def glb(recording: Recording, robot: TrainedRobot, terrain: Terrain, path: str | Path) -> Path:
    """Write the trial: terrain, ground, and a node for each body of the robot that moves as recorded."""
    import mujoco

    model = world_spec(robot, terrain, slots_for([terrain]), PhysicsConfig()).compile()
    file = GltfFile()
    root = file.node("course", rotation=Z_UP_TO_Y_UP)
    ground = _ground(terrain)
    file.node("ground", parent=root, mesh=_mesh(file, "ground", *ground, colour=(0.33, 0.36, 0.39)))
    # Triangles with corners of their own, so that faces are drawn flat.
    corners = terrain.vertices[terrain.triangles].reshape(-1, 3)
    vertices, triangles = corners, np.arange(len(corners)).reshape(-1, 3)
    if len(triangles):
        file.node("terrain", parent=root, mesh=_mesh(file, "terrain", vertices, triangles, colour=(0.72, 0.6, 0.45)))
    times = np.arange(len(recording.qpos)) * recording.dt
    positions, quaternions = _body_poses(model, recording.qpos)
    clock = file.array(times.astype("<f4"), "SCALAR", limits=True)
    for body in range(1, model.nbody):
        shape = _body_mesh(model, body)
        if shape is None:
            continue
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
        node = file.node(name, parent=root, mesh=_mesh(file, name, *shape, colour=(0.8, 0.82, 0.85)))
        file.move(node, clock, positions[:, body], quaternions[:, body])
    target = Path(path)
    write_bytes(target, file.to_bytes())
    return target


def _body_poses(model: Any, qpos: F64) -> tuple[F64, F64]:
    """((T, B, 3) positions, (T, B, 4) quaternions w x y z) of all bodies, without jumps of the quaternions' sign."""
    import mujoco

    data = mujoco.MjData(model)
    positions, quaternions = np.zeros((len(qpos), model.nbody, 3)), np.zeros((len(qpos), model.nbody, 4))
    for t, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        positions[t], quaternions[t] = data.xpos, data.xquat
        if t:
            # q and -q are one rotation, but a viewer interpolates between neighbours.
            flip = (quaternions[t] * quaternions[t - 1]).sum(-1) < 0
            quaternions[t, flip] *= -1
    return positions, quaternions


def _body_mesh(model: Any, body: int) -> tuple[F64, NDArray[np.int64]] | None:
    """The body's primitives as one mesh in its frame; None for a body without any."""
    import trimesh
    from mujoco import mjtGeom

    parts = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        kind, size = model.geom_type[geom], model.geom_size[geom]
        if kind == mjtGeom.mjGEOM_CAPSULE:
            part = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[12, 12])
            part.apply_translation(-part.bounds.mean(0))  # whatever end trimesh takes for the origin
        elif kind == mjtGeom.mjGEOM_CYLINDER:
            part = trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=16)
        elif kind == mjtGeom.mjGEOM_SPHERE:
            part = trimesh.creation.icosphere(subdivisions=2, radius=size[0])
        elif kind == mjtGeom.mjGEOM_BOX:
            part = trimesh.creation.box(2 * size)
        else:
            continue
        part.apply_transform(trimesh.transformations.quaternion_matrix(model.geom_quat[geom]))
        part.apply_translation(model.geom_pos[geom])
        parts.append(part)
    if not parts:
        return None
    whole: Any = trimesh.util.concatenate(parts)
    return np.asarray(whole.vertices), np.asarray(whole.faces)


def _ground(terrain: Terrain) -> tuple[F64, NDArray[np.int64]]:
    points = np.array([terrain.start.centre[:2], terrain.goal.centre[:2]])
    (x0, y0), (x1, y1) = points.min(0) - GROUND_MARGIN, points.max(0) + GROUND_MARGIN
    z = terrain.floor_z
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]), np.array([[0, 1, 2], [0, 2, 3]])


def _mesh(
    file: GltfFile, name: str, vertices: F64, triangles: NDArray[np.int64], colour: tuple[float, float, float]
) -> int:
    """A mesh in one colour (linear RGB)."""
    import trimesh

    normals = np.asarray(trimesh.Trimesh(vertices, triangles, process=False).vertex_normals)
    pbr = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return file.mesh(name, vertices, normals, triangles, pbr)
