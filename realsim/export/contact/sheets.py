"""`sheets`: solids where the surface has them, and a sheet behind every piece of surface that they do not carry.

Columns see what faces up or down. A wall that was seen from one side has no top and no bottom, so no column knows it;
a table without a measured underside becomes a block. Here every seen face has two sides: in front of it there is
air, because it was seen from there, and behind it there is something, however thin. Solids that fill the air in front
of a seen face are left out, and what of the surface nothing is left to carry becomes a sheet.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import areas
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel, Geom
from realsim.export.contact.columns import SHEET
from realsim.export.contact.islands import ROUGH
from realsim.export.contact.outline import area, convex_parts, outlines, sides
from realsim.export.contact.patches import LEAST, Patch, Samples, patches, sampled
from realsim.export.contact.polytope import Polytope
from realsim.export.contact.prisms import Prism, as_contact, as_geom, placed
from realsim.export.contact.probe import Reference
from realsim.export.contact.seams import overlap
from realsim.export.contact.shape import Shape

Slab = tuple[Prism, F64 | None, F64 | None]
# Set while looking at three real scans (Kinect stairs, a LiDAR room, a phone scan of a chair), FELT also at two more
# (boxes on a floor, slambook). What `sheets` gains is measured scene by scene against the other representations.
# FELT and THIN were 12 and 15 mm until the misses on five real captures were looked at. Those five are not fresh data.
FELT = 0.006  # metres, and at least the planes' tolerance: surface farther from every solid is not carried by it
FRONT = 0.03  # metres before a seen face where there is air
INSIDE = 0.01  # metres inside a solid: less is an edge that is off
SEEN = 0.5  # share of a solid's outside
THICK = 0.04  # metres of a sheet that holds things up: what falls fast sinks centimetres into a soft contact
THIN = 0.006  # metres of a sheet that has air behind it, and of one that is upright: its rim is seen from above
# Cells by which outlines are simplified, and by which convex parts may bulge over them. A cell grows with the scene,
# what is felt does not: outlines are off by FELT at most. Set on a LiDAR room (p95 15.4 to 14.5 mm, 9 % more parts); a
# corridor that it was not set on keeps its 1.5 mm with 12 % more parts, and below 43 m² nothing changes.
EDGE, BULGE = 1.0, 1.0
# Set on made corridors of 4 x 2 and 9 x 6 m (the second: 448 to 80 parts); on one of 35 x 21 m, where they were not,
# 1,254 to 514 parts, and 99.2 to 98.6 % of the rays from the side stop (tests/truths/scanned_rooms.py).
CLOSED = 0.15  # metres: half the width of a bay in a rim that nothing was seen through
BUMPS = 1.5  # tolerances that a patch may stand out of the sheets of others...
EDGES = 0.2  # ...for it to be an edge or a bump of theirs where more than this share of it does not
# Of one LiDAR room whose triangles are 5.8 cm wide: 2,434 sheets for 12,817, 97.6 for 99.7 % of the rays from the side.
# With EDGES of 0.5, 95.4 %; without WIDE, 2,995 sheets; without RIMS, 3,415; WIDE of 100, 2,113 sheets and 95.9 %.
# Of that room 8.1 % of the heights are off by 2 cm then, for 3.0. Two captures on which nothing was set keep their
# side rays (98.9 to 99.8 %, 98.3 to 98.2), with heights off 9.1 to 7.6 % and 2.1 to 2.6.
PLANES, RIMS = 8, 4  # parts of a triangle's width by which planes, and outlines in them, are known no better
WIDE = 30  # samples of a patch: what makes no such patch is clutter, whose planes may be...
COARSE = 2.0  # ...this many tolerances off
MOST = 300_000  # samples


def sheets(shape: Shape, config: SceneConfig) -> ContactModel:
    """Boxes and prisms, without those that fill seen air, and sheets behind the surface that they do not carry."""
    whole, mesh = shape.fine, shape.mesh
    vertices, seen = mesh.vertices, mesh.carrying
    surface = Reference(vertices, seen)
    surface_area = float(areas(vertices, seen).sum())
    tolerance = max(whole.tolerance, min(mesh.resolution / PLANES, ROUGH))
    spacing = max(0.01, float(np.sqrt(surface_area / MOST)))
    samples = sampled(vertices, seen, spacing)
    # Of a ceiling only the underside is known: no solid, but a sheet.
    below = [shape.planar_of(n) for n, island in enumerate(whole.islands) if island.top_seen > SEEN]
    near = max(FELT, tolerance)
    solids = [
        [prism for prism, of in zip(found.prisms, found.region, strict=True) if of == k]
        for found in below
        for k in sorted(set(found.region))
    ]
    kept = [prism for parts in solids if _is_solid(parts, samples, near) for prism in parts]
    lost = samples.where(~_felt(samples.points, kept, whole.floor, near))
    slabs = _carriers(lost, surface, whole.floor, tolerance, mesh.resolution)
    # What things land on reaches into what is beside it, and what lies against a solid into that: a ball would stay.
    carrying = [slab[0] for patch, slab in slabs if slab[1] is None and patch.axes[2, 2] > 0]
    others = [(patch, slab) for patch, slab in slabs if slab[1] is not None or patch.axes[2, 2] <= 0]
    behind = np.array([placed(*slab).mean(0) - (near + THIN) * patch.axes[2] for patch, slab in others]).reshape(-1, 3)
    against = _felt(behind, kept, (), 0.0)
    reaching = [placed(*slab) for (_, slab), on in zip(others, against, strict=True) if on]
    solid = overlap(as_contact("sheets", [*kept, *carrying], whole.floor, {}, reaching), tolerance)
    alone = [slab for (_, slab), on in zip(others, against, strict=True) if not on]
    made = [as_geom(f"sheet_{k}", *slab) for k, slab in enumerate(alone)]
    geoms = (*solid.geoms, *(geom for geom, _ in made))
    assets = (*solid.assets, *(asset for _, asset in made if asset is not None))
    counts = {"solids": len(kept), "solids_left_out": sum(map(len, solids)) - len(kept), "sheets": len(slabs)}
    counts |= {"seams": solid.statistics["seams"], "parts": len(geoms) - len(whole.floor)}
    statistics = whole.statistics | counts
    return ContactModel("sheets", geoms, assets, statistics)


def _is_solid(prisms: list[Prism], samples: Samples, near: float) -> bool:
    """Whether at least SEEN of the outside (top and sides) of a solid was seen, less what shows air inside it.

    A box passes; the block that columns make of a table top, or of half a table, does not.

    Args:
        prisms: what it is made of.
        near: metres from its faces up to which surface is its own.
    """
    bounds = Polytope(np.concatenate([prism.corners for prism in prisms]))
    around = samples.where(bounds.about(samples.points, near))
    on, air = np.zeros((2, len(around.points)), bool)
    front = around.points + FRONT * around.normals
    for part in [prism.solid for prism in prisms]:
        here, before = part.about(around.points, near), part.about(front)
        on[here] |= np.abs(part.depth(around.points[here])) < near
        air[before] |= part.depth(front[before]) > INSIDE
    return bool(around.area[on].sum() - around.area[air].sum() > SEEN * _outer_area(prisms))


def _outer_area(prisms: list[Prism]) -> float:
    """m^2 of top and sides, without sides at which another of the prisms goes on."""
    beside, across, total = [], [], 0.0
    for prism in prisms:
        side = sides(prism.outline)
        length, height = np.linalg.norm(side, axis=1), prism.top - prism.bottom
        out = INSIDE * np.column_stack([side[:, 1], -side[:, 0]]) / np.maximum(length, 1e-12)[:, None]
        beside.append(np.column_stack([prism.outline + side / 2 + out, (prism.top + prism.bottom) / 2]))
        across.append(length * (height + np.roll(height, -1)) / 2)
        total += abs(area(prism.outline))
    places = np.concatenate(beside)
    free = ~np.any([prism.solid.contains(places) for prism in prisms], axis=0)
    return total + float(np.concatenate(across)[free].sum())


def _felt(points: F64, prisms: list[Prism], floor: tuple[Geom, ...], near: float) -> NDArray[np.bool_]:
    """(M,) points that lie at most `near` metres from a solid's surface, inside one, or on the floor or below it."""
    felt = np.zeros(len(points), bool)
    for part in floor:
        size = np.array(part.size)
        top = part.pos[2] + (size[2] if part.type == "box" else 0.0)
        over = (np.abs(points[:, :2] - part.pos[:2]) < size[:2]).all(1) | (part.type == "plane")
        felt |= over & (points[:, 2] < top + near)
    for solid in [prism.solid for prism in prisms]:
        around = solid.about(points, near)
        felt[around] |= solid.contains(points[around], near)
    return felt


def _carriers(
    samples: Samples, surface: Reference, floor: tuple[Geom, ...], tolerance: float, resolution: float
) -> list[tuple[Patch, Slab]]:
    """Sheets behind all patches, the largest first; not behind the rounded edges and bumps of those before."""
    made: list[tuple[Patch, Slab]] = []
    parts: list[Polytope] = []
    bounds = np.zeros((0, 2, 3))
    for patch, off in track(_sized(samples, tolerance), "building sheets"):
        left, near = samples.points[patch.index], BUMPS * off
        if off > FELT:  # where there is less noise, each small face is one of its own
            left = left[~_felt(left, [], floor, near)]
            low, high = (left.min(0) - near, left.max(0) + near) if len(left) else (np.inf, -np.inf)
            for k in np.flatnonzero((bounds[:, 0] <= high).all(1) & (bounds[:, 1] >= low).all(1)):
                left = left[~parts[k].contains(left, near)]
        if len(left) >= max(LEAST, EDGES * len(patch.index)):
            slabs = _slabs(patch, samples, surface, off, resolution)
            made += [(patch, slab) for slab in slabs]
            parts += [Polytope(placed(*slab)) for slab in slabs]
            new = [(part.lower, part.upper) for part in parts[len(bounds) :]]
            bounds = np.concatenate([bounds, np.array(new).reshape(-1, 2, 3)])
    return made


def _sized(samples: Samples, tolerance: float) -> list[tuple[Patch, float]]:
    """(patch, metres that its points may lie off its plane), the largest first. Clutter is looked at again, for fewer
    and coarser planes; not where there is little noise."""
    found = patches(samples, tolerance)
    sized = [(patch, tolerance) for patch in found if tolerance <= FELT or len(patch.index) >= WIDE]
    if len(sized) < len(found):
        clutter = np.ones(len(samples.points), bool)
        clutter[np.concatenate([np.zeros(0, int), *(patch.index for patch, _ in sized)])] = False
        off, left = min(COARSE * tolerance, ROUGH), np.flatnonzero(clutter)
        sized += [(replace(patch, index=left[patch.index]), off) for patch in patches(samples.where(clutter), off)]
    return sorted(sized, key=lambda one: -float(samples.area[one[0].index].sum()))


def _slabs(patch: Patch, samples: Samples, surface: Reference, tolerance: float, resolution: float) -> list[Slab]:
    """Convex sheets behind a patch, and the frame that each is given in (rotation and place; None: the world's).

    Behind a face is straight below or above it, unless it is upright: a slanting sheet that were as thick along its
    normal would stand out beside what was seen, and hold what falls past.

    Args:
        tolerance: metres that the patch's points may lie off its plane.
        resolution: metres between the mesh's vertices.
    """
    from scipy import ndimage

    cell = samples.spacing / 2
    points = samples.points[patch.index]
    flat = (points - patch.origin) @ patch.axes[:2].T
    lower = flat.min(0) - 3 * cell
    shape = np.ceil((flat.max(0) + 3 * cell - lower) / cell).astype(int) + 1
    mask = np.zeros(shape[::-1], bool)
    column, row = ((flat - lower) / cell).round().astype(int).T
    mask[row, column] = True
    near = ndimage.binary_dilation(mask, np.ones((7, 7)))
    rows, columns = np.nonzero(near)
    at = patch.origin + (lower + cell * np.column_stack([columns, rows])) @ patch.axes[:2]
    normal = patch.axes[2]
    t, cosine, _ = surface.cast(at + 2 * tolerance * normal, np.broadcast_to(-normal, at.shape))
    mask[rows, columns] = (np.abs(t - 2 * tolerance) < 1.5 * tolerance) & (cosine < 0)
    facing = 0.0 if abs(normal[2]) < 0.5 else float(np.sign(normal[2]))
    # A dent is no way through, nor a hole in a wall that nothing was seen through; but a foot gets what was seen alone.
    bay = CLOSED if tolerance > FELT else 0.0  # the rim of what has less noise is its own: steps, not bays
    rows, columns = np.nonzero(_closed(mask, round(bay / cell)) & ~mask)
    at = patch.origin + (lower + cell * np.column_stack([columns, rows])) @ patch.axes[:2]
    t, _, _ = surface.cast(at + 2 * tolerance * normal, np.broadcast_to(-normal, at.shape))
    mask[rows, columns] = (np.isinf(t) & (facing <= 0)) | (t < 4 * tolerance)
    behind = np.array([0.0, 0.0, -facing]) if facing else -normal
    room = _room(points, behind, surface)
    thick = float(np.clip(np.percentile(room, 10), THIN, {-1.0: SHEET, 0.0: THIN, 1.0: THICK}[facing]))
    layers = [(mask, thick)]
    if (
        facing > 0 and (room >= THICK).mean() > SEEN and thick < THICK
    ):  # a rim that is thinner makes the rest no thinner
        deep = mask.copy()
        rows, columns = np.nonzero(mask)
        at = patch.origin + (lower + cell * np.column_stack([columns, rows])) @ patch.axes[:2]
        deep[rows, columns] = _room(at + tolerance * behind, behind, surface) >= THICK
        layers.append((ndimage.binary_opening(deep, np.ones((3, 3))), THICK))
    out = []
    edge, bulge = min(EDGE, FELT / cell), BULGE
    if tolerance > FELT:  # noise moves an outline as it moves a plane; a foot feels that of what it stands on
        edge = max(tolerance, 0.0 if facing > 0 else resolution / RIMS) / cell
        bulge = 1.5 * edge
    for part, thick in [(part, by) for here, by in layers for part in convex_parts(outlines(here, edge), bulge)]:
        corners = np.column_stack([lower + cell * part[:, ::-1], np.zeros(len(part))])
        frame: tuple[F64 | None, F64 | None] = (None, None)
        if facing:
            corners = corners @ patch.axes + patch.origin
        else:
            frame = (patch.axes.T, patch.origin)
        if area(corners[:, :2]) < 0:
            corners = corners[::-1]
        z = corners[:, 2]
        out.append((Prism(corners[:, :2], z + thick * (facing < 0), z - thick * (facing >= 0)), *frame))
    return [slab for slab in out if not slab[0].flat]


def _closed(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """A region without its holes, and without bays in its rim that are narrower than twice `radius` cells."""
    from scipy import ndimage

    wide = np.pad(mask, radius + 1)
    far = ndimage.distance_transform_edt(~wide) > radius
    bays = ndimage.distance_transform_edt(~far) > radius if far.any() else wide
    return np.asarray(ndimage.binary_fill_holes(wide | bays))[radius + 1 : -radius - 1, radius + 1 : -radius - 1]


def _room(points: F64, behind: F64, surface: Reference) -> F64:
    """(N,) metres behind points of a face up to THICK, or less where another face was seen behind it."""
    t, cosine, _ = surface.cast(points + 0.003 * behind, np.broadcast_to(behind, points.shape))
    # A face that is left there was seen from behind: solid in between. One that is met from its front has air.
    return np.minimum(np.where(cosine > 0, t + 0.003, t - FRONT), THICK)
