"""Height of the ground of a mesh: its own floor, or its lowest point; and the surface that a ground hides."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.core.meshes import across, sampled, used
from realsim.core.types import F64, TerrainMesh

LEVEL = 0.01  # metres: one level
SHARE = 0.05  # of all that is level: less is no floor
AROUND = 0.25
"""Share of the rim, and of all that is level, at a floor's height; on rolling ground, each height has a few percent."""
SLAB = 0.25
"""Area of a slab's sides for each area of its top up to which it is a floor. Set on two slabs under stakes (3 x 2 m, 2
and 10 cm thick: 0.03 and 0.17), a podium of two tiers (1.1) and a pyramid of four (0.36), which are no floors."""
SAMPLES = 400_000
CELL = 0.02  # metres; larger where the mesh is
CELLS = 150  # a side, at most
PROBES = 4000  # places at which the surface below the ground is touched
DEEP = 0.015  # metres: as in the measure of contact, what is farther off than this is missing


@dataclass(frozen=True)
class GroundLevel:
    """The height that was taken, and why."""

    z: float
    """Metres."""
    slab: bool
    """Whether it is the top of a slab, whose sides then lie below the ground."""
    description: str
    """Both for the user, to go after "the ground was taken to be"."""


def ground_level(mesh: TerrainMesh) -> GroundLevel:
    """The mesh's own floor, else its lowest point.

    A floor goes on where the mesh ends, so the rim of the mesh, seen from above, lies at its height. Where most of the
    rim ends lower (the sides of a box, the legs of a table), the level found is the top of something that stands on the
    ground, and a plane there would swallow whatever is below. Only a slab is a floor all the same: wide for its
    thickness, all around the mesh, with something on it.
    """
    named = used(mesh.vertices, mesh.triangles)
    lowest = float(named[:, 2].min())
    level, area, share = _lowest_level(mesh)
    if level - lowest < LEVEL:
        level = level if share > AROUND else lowest
        return GroundLevel(level, False, f"at z = {level:.3f} m, the mesh's lowest level")
    top, bottom, cell = _rim(mesh)
    at, below = np.abs(bottom - level) <= LEVEL, bottom < level - LEVEL
    if at.sum() > below.sum() and at.mean() > AROUND and not _on_legs(mesh, level, area):
        return GroundLevel(level, False, f"at z = {level:.3f} m, the floor of the mesh")
    sides = float(np.clip(level - bottom, 0, None).sum()) * cell
    carries = float(named[:, 2].max()) > level + LEVEL
    around = carries and bool(np.mean(np.abs(top - level) <= LEVEL) > 0.9)
    if around and sides <= SLAB * area:
        thick = 100 * float(np.median(level - bottom))
        description = f"at z = {level:.3f} m, the top of a slab of {thick:.0f} cm"
        return GroundLevel(level, True, f"{description}; if the slab itself is terrain, pass --ground-z {lowest:.3f}")
    description = f"at z = {lowest:.3f} m, the lowest point: the mesh has no floor of its own"
    return GroundLevel(
        lowest, False, description + f"; if its floor is at {level:.3f} m, pass --ground-z {level:.3f}" * around
    )


def hidden_cm2(mesh: TerrainMesh, scene_xml: Path, ground: GroundLevel, noise: float = 0.0) -> float:
    """Area of the mesh's surface below the ground, cm^2, that could be touched and is not there in the scene.

    What lies under another surface that faces up cannot be touched; what faces down rests on something. A pit that
    the scene has is no loss, nor are the sides of a slab, which by assumption goes on beyond the mesh.

    Args:
        noise: metres that the mesh itself may be off.
    """
    import mujoco

    from realsim.export.contact.probe import BALL, BALL_RADIUS, Reference, SimTouch

    deep = DEEP + noise
    corners, cross = mesh.vertices[mesh.triangles], across(mesh.vertices, mesh.triangles)
    double = np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(double, 1e-20)[:, None]
    faces = np.flatnonzero((corners[..., 2].min(1) < ground.z - deep) & (normal[:, 2] > -0.5))
    if not len(faces):
        return 0.0
    points, of = sampled(mesh.vertices, mesh.triangles[faces], PROBES, np.random.default_rng(0))
    share = double[faces].sum() / 2 / len(points)
    below = points[:, 2] < ground.z - deep
    if ground.slab:
        low, high = mesh.vertices.min(0)[:2] + CELL, mesh.vertices.max(0)[:2] - CELL
        below &= ((points[:, :2] > low) & (points[:, :2] < high)).all(1)
    off = points[below] + 2 * BALL_RADIUS * normal[faces][of[below]]
    off = off[~Reference(mesh.vertices, mesh.triangles).buried(off)]
    if not len(off):
        return 0.0
    upright = np.tile([1.0, 0, 0, 0], (len(off), 1))
    clearance = SimTouch(mujoco.MjSpec.from_file(str(scene_xml)), BALL).clearance(off, upright)
    return round(float((np.abs(clearance - BALL_RADIUS) > deep).sum()) * share * 1e4, 1)


def _lowest_level(mesh: TerrainMesh) -> tuple[float, float, float]:
    """(z, area in m^2, share of all that is level and faces up) of the lowest level that holds SHARE of that; the
    mesh's lowest point if nothing does."""
    height, normal = mesh.vertices[:, 2][mesh.triangles], across(mesh.vertices, mesh.triangles)
    area = np.linalg.norm(normal, axis=1) / 2
    level = normal[:, 2] > np.cos(np.radians(5)) * 2 * area
    if not level.any():
        return float(height.min()), 0.0, 0.0
    z = height[level].mean(1)
    bins = np.floor((z - z.min()) / LEVEL).astype(int)
    sums = np.bincount(bins, area[level])
    wide = np.flatnonzero(sums > SHARE * sums.sum())
    if not len(wide):  # a slope or rolling ground has some of every height
        return float(height.min()), 0.0, 0.0
    first = int(wide[0])
    near = bins == first
    return float(np.average(z[near], weights=area[level][near])), float(sums[first]), float(sums[first] / sums.sum())


def _on_legs(mesh: TerrainMesh, level: float, area: float) -> bool:
    """Whether a level surface of that area (m^2) is carried by what stands below it: legs that do not reach its rim.
    The walls of a pit are below a floor too, and open above; what reaches through a sheet of floor meets its back."""
    from realsim.export.contact.probe import Reference

    corners, cross = mesh.vertices[mesh.triangles], across(mesh.vertices, mesh.triangles)
    double = np.linalg.norm(cross, axis=1)
    middle = corners.mean(1)
    leg = (np.abs(cross[:, 2]) < 0.5 * double) & (middle[:, 2] < level - DEEP)
    if not leg.any():
        return False
    beside = middle[leg] + LEVEL * cross[leg] / double[leg, None]
    up = np.tile([0.0, 0.0, 1.0], (len(beside), 1))
    above, facing, _ = Reference(mesh.vertices, mesh.triangles).cast(beside, up)
    under = (facing < 0) & (beside[:, 2] + above < level + LEVEL)
    return bool(double[leg][under].sum() / 2 > SHARE * area)


def _rim(mesh: TerrainMesh) -> tuple[F64, F64, float]:
    """z at which the mesh ends above and below, each (M,), in the cells along its outline seen from above; their size
    in metres."""
    from scipy import ndimage

    points, _ = sampled(mesh.vertices, mesh.triangles, SAMPLES, np.random.default_rng(0))
    points = np.concatenate([points, used(mesh.vertices, mesh.triangles)])
    lower, upper = points.min(0)[:2], points.max(0)[:2]
    cell = max(CELL, float((upper - lower).max()) / CELLS)
    place = np.floor((points[:, :2] - lower) / cell).astype(int) + 1
    low = np.full(place.max(0) + 2, np.inf)
    high = -low
    np.minimum.at(low, (place[:, 0], place[:, 1]), points[:, 2])
    np.maximum.at(high, (place[:, 0], place[:, 1]), points[:, 2])
    outside, _ = ndimage.label(~np.isfinite(low))
    rim = np.isfinite(low) & ndimage.binary_dilation(outside == outside[0, 0])
    return high[rim], low[rim], cell
