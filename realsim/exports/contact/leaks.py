"""Does anything get into what should be solid?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.exports.contact.probe import Reference, terrain_only

RADIUS = 0.01
DEEP = 0.015  # metres inside a solid


def count_leaks(
    spec: Any,
    reference: Reference,
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    ground_z: float,
    *,
    objects: int = 150,
    seed: int = 0,
) -> dict[str, int]:
    """Throw balls of 1 cm onto a terrain for a second and count those that end inside a solid or below the floor.

    Args:
        spec: `MjSpec` of the terrain.
        lower, upper: (2,) rectangle over which they are thrown, metres.

    Returns:
        {`leaks`, `leak_objects`}: how many got in, of how many that stayed over the reference.
    """
    import mujoco

    rng = np.random.default_rng(seed)
    spec = terrain_only(spec)
    spec.memory = 256 * 2**20
    top = reference.vertices[:, 2].max()
    for _ in range(objects):
        body = spec.worldbody.add_body(pos=[*rng.uniform(lower, upper), top + 0.05])
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=0.02, contype=1, conaffinity=0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(objects, 6)[:, :2] = rng.normal(0, 0.4, (objects, 2))
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    ends = data.qpos.reshape(objects, 7)[:, :3].copy()
    extent = reference.vertices[np.unique(reference.triangles)]
    over = ((ends[:, :2] > extent.min(0)[:2]) & (ends[:, :2] < extent.max(0)[:2])).all(1)
    # An edge that is a few millimetres off lets a ball lie where there should be solid; that is counted as error, not
    # as a leak.
    deep = reference.depth(ends) > DEEP
    inside = (reference.buried(ends) & deep) | (ends[:, 2] < min(ground_z, extent[:, 2].min()) - RADIUS)
    return {"leaks": int((inside & over).sum()), "leak_objects": int(over.sum())}
