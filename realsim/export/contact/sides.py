"""Contact from the side: does what was seen beside the robot stop it, and does nothing stop it before?"""

from typing import Any

import numpy as np

from realsim.core.meshes import across, connected, sampled
from realsim.core.types import F64
from realsim.export.contact.probe import BALL_RADIUS, Reference, SimTouch, first_touch

HEIGHTS = (0.1, 0.5, 1.0)  # metres above the ground: toes, knees, hips
GRAZES = 0.003  # metres below those: a box of just 0.5 m would be hit or missed by rounding
PLACES, WAYS = 40, 24  # places a height, directions a place
REACH = 6.0  # metres
AROUND = 0.5  # metres beside a mesh that stands on bare ground
WITHIN = 0.03  # metres about the surface in which a ray has to stop
UPRIGHT = 0.5  # most |z| of the normal of a side face
RUN = 0.10  # metres before the surface from which a ball is pushed
ENOUGH = 50  # rays; what fewer of them say is chance
FREE = 100.0
"""cm2 of one part's sides in free air from which a scene is not good. Set by hand, as much as is no pit
(`islands.PIT_AREA`). A ghost pillar has 1,440; 40 clean meshes, 10 exact ones and 5 rooms have none, nor have 17 of 20
scenes of others (72 on a climbing wall; 1,505 and 18,148 on two that were not good before)."""
SPACING, MOST = 0.02, 50_000  # metres between places on the sides of parts, and how many at most; by hand, for time
OUTSIDE = 0.001  # metres beside a part at which others do not cover it; by hand, a tenth of a probe


def side_figures(
    touch: SimTouch, reference: Reference, lower: F64, upper: F64, ground_z: float, seed: int = 0, *, bare: bool = False
) -> dict:
    """Level rays from free places against what was seen, and balls pushed against it where they hit.

    A place is free if it is in no solid, straight below it is a seen face that faces up, and nothing was seen within
    5 cm. Rays that meet the front of a seen side face within REACH count, unless they meet something invented before:
    the back of an obstacle that no camera saw is not free air because a ray that ignores it sees what stands beyond.
    What is not as high as a ball of 1 cm there, a facet of rolling ground, is no side face.

    A ray that misses an edge by millimetres may be stopped at it: early is what stops it more than WITHIN from any
    seen surface. Through is what lets it go on for more than WITHIN.

    Args:
        touch: balls of 1 cm against the terrain.
        lower, upper: (2,) rectangle in which places lie, metres.
        bare: whether the ground goes on where the mesh has no surface, so that places are free there and around it.

    Returns:
        JSON-able: `rays`, shares that `stopped`, went `through`, and were stopped `early`; the same `by_height_m`;
        `balls` and the share of them that went through. Shares are None where fewer than ENOUGH rays met anything.
    """
    rng = np.random.default_rng(seed)
    surface = reference.seen_only
    around = AROUND if bare else 0.0
    starts, ways, height = _rays(surface, lower - around, upper + around, ground_z, rng, bare)
    hit, cosine, normal = surface.cast(starts, ways)
    met = (hit < REACH) & (cosine < 0) & (np.abs(normal[:, 2]) < UPRIGHT)
    met &= reference.cast(starts, ways)[0] >= hit - 1e-6
    for beside in (-BALL_RADIUS, BALL_RADIUS):
        along = surface.cast(starts + np.array([0.0, 0.0, beside]), ways)[0]
        met[met] = np.abs(along[met] - hit[met]) <= WITHIN
    starts, ways, height, hit = starts[met], ways[met], height[met], hit[met]
    out: dict[str, Any] = {"rays": len(hit), "stopped": None, "through": None, "early": None}
    if len(hit) < ENOUGH:
        return out | {"by_height_m": {}, "balls": 0, "balls_through": None}
    off = _stops(touch, starts, ways) - hit
    early = np.flatnonzero(off < -WITHIN)
    near = surface.distance(starts[early] + (hit + off)[early, None] * ways[early]) <= WITHIN
    off[early[near]] = 0.0
    out |= _shares(off)
    by_height = {f"{h:g}": _shares(off[height == h]) for h in HEIGHTS if (height == h).sum() >= ENOUGH}
    return out | {"by_height_m": by_height} | _balls(touch, surface, starts, ways, hit)


def free_side_figures(touch: SimTouch, reference: Reference, ground_z: float, noise: float = 0.0) -> dict[str, Any]:
    """Sides of parts that stand in free air, far from any surface: of a pillar under what floats, most of them.

    Far is more than WITHIN and the `noise` (metres) that the surface itself has. Air is free but behind the nearest
    surface, and not where a solid reaches down from a surface that has no underside.

    Returns:
        JSON-able: `free_sides_cm2` of the part that has most of them, and about where, (3,) `free_sides_at` or None.
    """
    vertices, faces = touch.triangles
    part, cross = connected(faces), across(vertices, faces)
    area = np.linalg.norm(cross, axis=1) / 2
    low, far = ground_z + WITHIN, WITHIN + noise
    side = (np.abs(cross[:, 2]) < 2 * UPRIGHT * area) & (vertices[faces][..., 2].max(1) > low)
    faces, part, cross, area = faces[side], part[side], cross[side], area[side]
    count = int(np.clip(area.sum() / SPACING**2, 1, MOST))
    none = {"free_sides_cm2": 0.0, "free_sides_at": None}
    if not len(faces):
        return none
    points, face = sampled(vertices, faces, count, np.random.default_rng(0))
    out = cross[face] / np.maximum(np.linalg.norm(cross[face], axis=1, keepdims=True), 1e-15)
    here = (points[:, 2] > low) & (reference.distance(points) > far)
    points, face, out = points[here], face[here], out[here]
    bare = touch.clearance(points + OUTSIDE * out, np.tile([1.0, 0, 0, 0], (len(points), 1))) > -BALL_RADIUS
    bare &= ~reference.buried(points - WITHIN * out)
    t, facing, _ = reference.cast(points, -reference.normals(points))
    bare &= np.isinf(t) | (facing <= 0)  # of what is below an edge, the ray may miss that
    points, of = points[bare], part[face[bare]]
    if not len(points):
        return none
    most = int(np.bincount(of).argmax())
    found = (of == most).sum() * area.sum() / count
    return {
        "free_sides_cm2": round(1e4 * float(found), 2),
        "free_sides_at": points[of == most].mean(0).round(3).tolist(),
    }


def _rays(
    surface: Reference, lower: F64, upper: F64, ground_z: float, rng: np.random.Generator, bare: bool
) -> tuple[F64, F64, F64]:
    """(starts, directions, height of each) of all rays."""
    starts, ways, heights = [], [], []
    for h in HEIGHTS:
        xy = rng.uniform(lower, upper, (20 * PLACES, 2))
        place = np.column_stack([xy, np.full(len(xy), ground_z + h - GRAZES)])
        fall, cosine, _ = surface.cast(place, np.broadcast_to([0.0, 0.0, -1.0], place.shape))
        place = place[(np.isfinite(fall) & (cosine < -UPRIGHT)) | (bare & np.isinf(fall))]
        # Solids that stand on a floor have it below them too: inside one is no free place.
        place = place[(surface.distance(place) > 0.05) & ~surface.buried(place)][:PLACES]
        turn = 2 * np.pi * (np.arange(WAYS) + rng.random((len(place), 1))) / WAYS
        starts.append(np.repeat(place, WAYS, axis=0))
        ways.append(np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1).reshape(-1, 3))
        heights.append(np.full(len(ways[-1]), h))
    return np.concatenate(starts), np.concatenate(ways), np.concatenate(heights)


def _stops(touch: SimTouch, starts: F64, ways: F64) -> F64:
    """(N,) metres to where the collision geoms stop each ray; 0 where it starts in one, inf where none does."""
    places, which = np.unique(starts, axis=0, return_inverse=True)
    inside = touch.clearance(places, np.tile([1.0, 0, 0, 0], (len(places), 1))) <= -BALL_RADIUS
    stop = Reference(*touch.triangles).cast(starts, ways)[0]
    stop[inside[which.reshape(-1)]] = 0.0
    return stop


def _shares(off: F64) -> dict[str, Any]:
    shares = {"stopped": np.abs(off) <= WITHIN, "through": off > WITHIN, "early": off < -WITHIN}
    return {"rays": len(off)} | {name: round(float(of.mean()), 4) for name, of in shares.items()}


def _balls(touch: SimTouch, surface: Reference, starts: F64, ways: F64, hit: F64, most: int = 500) -> dict[str, Any]:
    """Balls pushed at places where rays met something: rays may see what contacts do not have."""
    pick = np.unique(np.linspace(0, len(hit) - 1, most).astype(int))
    back = np.minimum(RUN, hit[pick] / 2)
    begin = starts[pick] + (hit[pick] - back)[:, None] * ways[pick]
    quats = np.tile([1.0, 0, 0, 0], (len(pick), 1))

    def exact(positions: F64, quats: F64) -> F64:
        return surface.distance(positions) - BALL_RADIUS

    free = (exact(begin, quats) > 0) & (touch.clearance(begin, quats) > 0)
    begin, way, quats = begin[free], ways[pick][free], quats[free]
    if len(begin) < ENOUGH:
        return {"balls": len(begin), "balls_through": None}
    length = RUN + WITHIN + BALL_RADIUS
    should = first_touch(exact, begin, quats, way, length)
    does = first_touch(touch.clearance, begin, quats, way, length)
    meets = np.isfinite(should)
    through = meets & ~(does <= should + WITHIN)
    return {"balls": int(meets.sum()), "balls_through": round(float(through.sum() / max(meets.sum(), 1)), 4)}
