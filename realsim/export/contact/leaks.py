"""Does anything get into what should be solid?"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.export.contact.probe import Reference, terrain_only

RADIUS = 0.01
DEEP = 0.015  # metres inside a solid
FALL = 0.5  # metres above the surface below from which a ball falls: a foot comes down no faster than 3 m/s
SETTLED = 10  # looks at the end in all of which a leak is inside
LOOKS = 100  # times a second that a ball's place is noted


def count_leaks(
    spec: Any,
    reference: Reference,
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    ground_z: float,
    *,
    objects: int = 150,
    seed: int = 0,
    noise: float = 0.0,
) -> dict[str, Any]:
    """Throw balls of 1 cm onto a terrain for a second and count those that get through its surface.

    A leak ends inside a solid, having gone through a measured face from its front, or below the floor. One that rolls
    in under a table, where nobody knows what is there, does not.

    Args:
        spec: `MjSpec` of the terrain.
        lower, upper: (2,) rectangle over which they are thrown, metres.
        noise: metres that the reference itself may be off.

    Returns:
        {`leaks`, `leak_objects`, `leak_places`}: how many got in, of how many that stayed over the reference, and
        (leaks, 3) where those ended, to the millimetre.
    """
    import mujoco

    rng = np.random.default_rng(seed)
    spec = terrain_only(spec)
    spec.memory = 256 * 2**20
    top = float(reference.vertices[:, 2].max())
    xy = np.array([rng.uniform(lower, upper) for _ in range(objects)])
    begin = np.minimum(reference.start_above(xy, ground_z) - 2 * RADIUS, top + 0.05)
    begin = np.minimum(begin, np.nan_to_num(reference.top(xy, begin), nan=ground_z) + FALL)
    for place, z in zip(xy, begin, strict=True):
        body = spec.worldbody.add_body(pos=[*place, z])
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=0.02, contype=1, conaffinity=0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(objects, 6)[:, :2] = rng.normal(0, 0.4, (objects, 2))
    path = [data.qpos.reshape(objects, 7)[:, :3].copy()]
    for _ in range(LOOKS):
        mujoco.mj_step(model, data, nstep=round(1.0 / LOOKS / model.opt.timestep))
        fall = data.qvel.reshape(objects, 6)[:, 2]
        np.maximum(fall, -((2 * 9.81 * FALL) ** 0.5), out=fall)  # what rolls off a shelf falls farther
        path.append(data.qpos.reshape(objects, 7)[:, :3].copy())
    ends = path[-1]
    extent = reference.vertices[np.unique(reference.triangles)]
    over = ((ends[:, :2] > extent.min(0)[:2]) & (ends[:, :2] < extent.max(0)[:2])).all(1)
    # An edge that is a few millimetres off lets a ball lie where there should be solid; that is counted as error, not
    # as a leak. Nor is one that is just bouncing: contacts are soft, and it is out again a moment later.
    below = ends[:, 2] < min(ground_z, extent[:, 2].min()) - 2 * RADIUS
    inside = _entered(reference.seen_only(), np.array(path)) > 0
    for place in path[-SETTLED:]:
        inside &= reference.buried(place) & (reference.depth(place) > DEEP + noise)
    inside |= below
    through = inside & over
    places = ends[through].round(3).tolist()
    return {"leaks": len(places), "leak_objects": int(over.sum()), "leak_places": places}


def _entered(surface: Reference, path: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) how often each of the ways (T, N, 3) goes through a surface from its front, less how often from its back."""
    start, step = path[:-1].reshape(-1, 3), np.diff(path, axis=0).reshape(-1, 3)
    length = np.linalg.norm(step, axis=1)
    way = step / np.maximum(length, 1e-12)[:, None]
    moved = length > 1e-6
    through = np.zeros(len(start), np.int64)
    t, cosine, _ = surface.cast(start[moved], way[moved])
    through[moved] = np.where(t <= length[moved], np.where(cosine < 0, 1, -1), 0)
    return through.reshape(len(path) - 1, -1).sum(0)
