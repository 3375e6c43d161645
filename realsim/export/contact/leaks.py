"""Does anything get into what should be solid?"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across, used
from realsim.export.contact.probe import Reference, SimTouch

RADIUS = 0.01
DEEP = 0.015  # metres inside a solid
HELD = RADIUS / 2  # metres by which a ball overlaps parts that push it into each other, by all of its radius at a plain
# seam; what lies on a surface overlaps it by less than a millimetre
FALL = 0.5  # metres above the surface below from which a ball falls: a foot comes down no faster than 3 m/s, and...
LANDS = 2.0  # ...no slower than this, metres a second, on a low thing too (as in benchmarks/contact/clean_meshes.py)
MOST_EDGES = 100_000  # of the geoms that are looked at, for memory
SETTLED = 10  # looks at the end in all of which a leak is inside
LOOKS = 100  # times a second that a ball's place is noted
THROWS = 6  # at most: what no ball stays on ends too. Off posts of 6 cm 3 of 40 stay, off a can 35 of 150; of forty
# clean meshes all keep half of the first


def count_leaks(
    touch: SimTouch,
    reference: Reference,
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    ground_z: float,
    *,
    objects: int = 150,
    seed: int = 0,
    noise: float = 0.0,
) -> dict[str, Any]:
    """Throw balls of 1 cm onto a terrain for a second and count those that get through its surface: half of them onto
    edges of its geoms, where two may meet; of either half, every second straight down. They are thrown again until as
    many as half of one throw stayed on it: small things keep few, and what parts hold would go unseen.

    A leak ends inside a solid, having gone through a measured face from its front, or below the floor. One that rolls
    in under a table, where nobody knows what is there, does not. What is no deeper, but between parts that push it into
    each other, is held.

    Args:
        touch: anything against the terrain.
        lower, upper: (2,) rectangle over which they are thrown, metres.
        objects: balls in one throw.
        noise: metres that the reference itself may be off.

    Returns:
        {`leaks`, `held`, `leak_objects`, `leak_places`}: how many got in and how many are held, of how many that stayed
        over the reference, and (leaks + held, 3) where those ended, to the millimetre.
    """
    rng = np.random.default_rng(seed)
    counts: dict[str, Any] = {"leaks": 0, "held": 0, "leak_objects": 0, "leak_places": []}
    for _ in range(THROWS):
        xy = rng.uniform(lower, upper, (objects, 2))
        on_edges = _on_edges(touch, lower, upper, objects // 2, rng)
        xy[: len(on_edges)] = on_edges
        for name, found in _throw(touch, reference, xy, ground_z, rng, noise).items():
            counts[name] += found
        if counts["leak_objects"] >= objects // 2:
            break
    return counts


def _throw(
    touch: SimTouch,
    reference: Reference,
    xy: NDArray[np.float64],
    ground_z: float,
    rng: np.random.Generator,
    noise: float,
) -> dict[str, Any]:
    """What one throw at (N, 2) places adds to the counts of `count_leaks`."""
    import mujoco

    objects = len(xy)
    spec = touch.spec.copy()
    spec.memory = 256 * 2**20
    top = float(reference.vertices[:, 2].max())
    begin = np.minimum(reference.start_above(xy, ground_z) - 2 * RADIUS, top + 0.05)
    begin = np.minimum(begin, np.nan_to_num(reference.top(xy, begin), nan=ground_z) + FALL)
    for place, z in zip(xy, begin, strict=True):
        body = spec.worldbody.add_body(pos=[*place, z])
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=0.02, contype=1, conaffinity=0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(objects, 6)[:, 2] = -LANDS
    data.qvel.reshape(objects, 6)[::2, :2] = rng.normal(0, 0.4, (objects, 2))[::2]
    path, overlap = [data.qpos.reshape(objects, 7)[:, :3].copy()], []
    for _ in range(LOOKS):
        mujoco.mj_step(model, data, nstep=round(1.0 / LOOKS / model.opt.timestep))
        fall = data.qvel.reshape(objects, 6)[:, 2]
        np.maximum(fall, -((2 * 9.81 * FALL) ** 0.5), out=fall)  # what rolls off a shelf falls farther
        path.append(data.qpos.reshape(objects, 7)[:, :3].copy())
        overlap.append(np.zeros(objects))
        one, other = np.sort([data.contact.geom1, data.contact.geom2], axis=0)
        of_part = model.geom_type[one] != int(mujoco.mjtGeom.mjGEOM_HFIELD)  # its cells at a step overlap a ball
        ball = other[of_part] - (model.ngeom - objects)
        np.maximum.at(overlap[-1], ball, -data.contact.dist[of_part])
    ends = path[-1]
    extent = used(reference.vertices, reference.triangles)
    over = ((ends[:, :2] > extent.min(0)[:2]) & (ends[:, :2] < extent.max(0)[:2])).all(1)
    # An edge that is a few millimetres off lets a ball lie where there should be solid; that is counted as error, not
    # as a leak. Nor is one that is just bouncing: contacts are soft, and it is out again a moment later.
    below = ends[:, 2] < min(ground_z, extent[:, 2].min()) - 2 * RADIUS
    inside = _entered(reference.seen_only, np.array(path)) > 0
    held = inside.copy()
    for place, by in zip(path[-SETTLED:], overlap[-SETTLED:], strict=True):
        buried = reference.buried(place)
        inside &= buried & (reference.depth(place) > DEEP + noise)
        held &= buried & (by > HELD)
    through, held = (inside | below) & over, held & ~inside & ~below & over
    counts = {"leaks": int(through.sum()), "held": int(held.sum()), "leak_objects": int(over.sum())}
    return counts | {"leak_places": ends[through | held].round(3).tolist()}


def _on_edges(
    touch: SimTouch, lower: NDArray[np.float64], upper: NDArray[np.float64], count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """(count, 2) places on edges of the geoms in a rectangle; none where there are no edges, or are everywhere."""
    import mujoco

    if any(geom.type == mujoco.mjtGeom.mjGEOM_HFIELD for geom in touch.spec.geoms):
        return np.zeros((0, 2))
    vertices, faces = touch.triangles
    faces = faces[across(vertices, faces)[:, 2] > 0]
    faces = faces[:: 1 + len(faces) // MOST_EDGES]
    ends = vertices[faces[:, [0, 1, 1, 2, 2, 0]], :2].reshape(-1, 2, 2)
    ends = ends[((ends > lower) & (ends < upper)).all((1, 2))]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if not length.any():
        return np.zeros((0, 2))
    start, end = ends[rng.choice(len(ends), count, p=length / length.sum())].transpose(1, 0, 2)
    return np.asarray(start + rng.random((count, 1)) * (end - start))


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
