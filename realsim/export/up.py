"""Which axis of a mesh file points up."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import AT_ONCE, across, compact, sound
from realsim.core.rays import Rays
from realsim.core.types import F64
from realsim.export.contact.outline import area

# Evidence for z against y in nats. Set on 32 meshes of furniture, stairs and terrains in both frames, with and without
# their base at zero (benchmarks/contact/clean_meshes.py --up), and on two files of phones and Blender.
AREA = 1.6
"""Most that the ratio of the areas facing up counts: a wall that stands is not laid down for its area alone."""
EDGEWISE = np.log(1000)
"""Of that ratio: a sheet has nothing to stand on when it is looked at along its edge."""
FLOOR = 1.0
"""For a floor: level surface, facing up, over half of the plan, within a fifth of the height above the lowest such, or
above the lowest point where nothing stands higher."""
BASE = 1.5
"""For a mesh whose numbers begin at 0 along one axis and not along the other, with triangles there: modellers stand
things on zero. The edge of a grid that begins there has none."""
BEARING, OF_HEIGHT = 1.0, 0.01
"""For the base that it stands on: what the lowest points (of that share of the height) span of the plan, each a tenth
more, as the log of their ratio."""
WAYS = 32  # directions that sample that hull: a disc keeps 99.4 % of its area
MIRROR, SLACK = 0.75, 0.005
"""For being its own mirror image along the other axis and not along this: what stands is mirrored in upright planes. By
how far the mirror image is off on average, with that slack, in sizes.
These two and CLEAR were chosen of 48 triples on 41 meshes of ten public packages, as they are and turned: of 82, 58 are
right for 41, 9 asked with the wrong axis first for 12, 2 wrong unasked for 5. On 40 meshes where they were not set, 77
of 80 are right for 75."""
HABIT = 0.75
"""For z in STL, PLY, OBJ and OFF (most have it so, and phones and Blender write y); twice as much for y in GLB."""
CLEAR = 1.2
"""What is less is a question."""
PROBES = 2000
"""Points at which the surface that faces up is tested for lying within another solid."""
CLOSED = 0.01
"""Share of a surface's area that its vector area may be: that of a closed one is zero."""
WALKABLE = np.cos(np.radians(35))


@dataclass(frozen=True)
class Up:
    """The axis that is taken to point up."""

    axis: str
    """z or y."""
    question: str | None = None
    """What to ask the user where both are plausible."""
    notes: tuple[str, ...] = ()


def y_to_z(points: F64) -> F64:
    """Points (..., 3) of a world with y up, turned so that z is."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x, -z, y], -1)


def find_up(vertices: F64, triangles: NDArray[np.int64], suffix: str) -> Up:
    """z or y, from the surface that faces up along each, from what lies at zero, and from the habits of the format.

    Args:
        vertices: (V, 3) of the file. triangles: (K, 3); bad ones do not count.
        suffix: of the file, lower case.
    """
    vertices, named = compact(vertices, triangles[sound(vertices, triangles)])
    habit = -2 * HABIT if suffix == ".glb" else HABIT
    usual = "z" if habit > 0 else "y"
    cross = across(vertices, named)
    cross /= 2
    weights = np.linalg.norm(cross, axis=1)
    whole = float(weights.sum())
    if not whole:
        return Up(usual)
    volume = float(np.einsum("ij,ij->", (vertices - vertices.mean(0))[named[:, 0]], cross))
    closed = float(np.linalg.norm(cross.sum(0))) < CLOSED * whole
    # Of an open surface, few triangles tell how far a mirror image is off, and a caster of all may take a gigabyte.
    apart = 1 if closed else 1 + len(named) // AT_ONCE
    mesh = _Mesh(vertices, named, cross, weights, Rays(vertices, named[::apart]), closed)
    z, y = (_facing_up(mesh, axis, 1) for axis in (2, 1))
    turned_z, turned_y = (_facing_up(mesh, axis, -1) for axis in (2, 1))
    # An open surface has no volume: it faces the way in which more of it can be walked on.
    inside_out = volume < 0 if closed else turned_z.area + turned_y.area > z.area + y.area
    if inside_out:
        z, y = turned_z, turned_y
    ratio = float(np.log((z.area + 1e-9) / (y.area + 1e-9)))
    evidence = habit + (ratio if abs(ratio) > EDGEWISE else float(np.clip(ratio, -AREA, AREA)))
    evidence += FLOOR * (int(z.floor) - int(y.floor)) + BASE * (int(z.base) - int(y.base))
    bears_z, bears_y = (0.1 + _bearing(vertices, axis) for axis in (2, 1))
    off_z, off_y = _off_mirrored(mesh)
    evidence += BEARING * np.log(bears_z / bears_y) + MIRROR * (off_z - off_y) / (off_z + off_y + SLACK)
    axis = "z" if evidence > 0 else "y"
    areas = f"{float(f'{z.area:.2g}'):g} m2 face up along z, {float(f'{y.area:.2g}'):g} m2 along y"
    if abs(evidence) < CLEAR:
        return Up(axis, f"z or y may point up ({areas}); {axis} was taken: pass --up z or --up y.")
    if axis == "z" and usual == "z":
        return Up("z")
    other = "z" if axis == "y" else "y"
    return Up(axis, notes=(f"{axis} of the file points up ({areas}); if not, pass --up {other}",))


@dataclass(frozen=True)
class _Mesh:
    vertices: F64
    """(V, 3), each of which a triangle names."""
    triangles: NDArray[np.int32]
    cross: F64
    """(K, 3) along the triangles' normals, as long as their areas..."""
    weights: F64
    """...(K,)."""
    surface: Rays
    closed: bool


@dataclass(frozen=True)
class _FacingUp:
    """What speaks for one axis."""

    area: float
    """m^2 on which one could walk; within another solid nobody can."""
    floor: bool
    base: bool


def _facing_up(mesh: _Mesh, axis: int, way: int) -> _FacingUp:
    area = mesh.weights
    up = way * mesh.cross[:, axis] > WALKABLE * np.maximum(area, 1e-30)
    heights = mesh.vertices[:, axis][mesh.triangles]
    fifth = 0.2 * float(np.ptp(heights)) + 1e-6
    lowest = heights[up].min(initial=heights.max())
    if not (heights[up] > lowest + fifth).any():
        lowest = heights.min()  # what nothing stands on is a floor only where the mesh begins
    sizes = np.ptp(mesh.vertices, 0)
    footprint = float(np.delete(sizes, axis).prod())
    at_bottom = up & (heights.max(1) < lowest + fifth)
    zero = 1e-3 * float(sizes.max())
    base = heights.min() > -zero and bool((heights.max(1) < zero).any())
    free = _outside(mesh, np.where(up, area, 0.0), way) if mesh.closed else 1.0
    return _FacingUp(free * float(area[up].sum()), bool(area[at_bottom].sum() > 0.5 * footprint), base)


def _bearing(points: F64, axis: int) -> float:
    """Share of the plan that the hull of the lowest points covers."""
    plan, heights = np.delete(points, axis, 1), points[:, axis]
    low = plan[heights <= heights.min() + OF_HEIGHT * np.ptp(heights)]
    around = np.linspace(0, 2 * np.pi, WAYS, endpoint=False)
    outline = np.array([low[np.argmax(low @ [np.cos(a), np.sin(a)])] for a in around])
    return abs(area(outline)) / max(float(np.ptp(plan, axis=0).prod()), 1e-30)


def _off_mirrored(mesh: _Mesh) -> tuple[float, float]:
    """How far the surface's mirror images along z and along y are off it, on average, in parts of its size."""
    points, _ = _scattered(mesh, mesh.weights)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    off = [mesh.surface.distance(np.where(np.arange(3) == axis, low + high - points, points)).mean() for axis in (2, 1)]
    return float(off[0] / np.ptp([low, high], 0).max()), float(off[1] / np.ptp([low, high], 0).max())


def _scattered(mesh: _Mesh, weights: F64) -> tuple[F64, NDArray[np.int64]]:
    """((PROBES, 3) points of triangles drawn by weights (K,), and the triangles)."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(weights), PROBES, p=weights / weights.sum())
    return np.einsum("nk,nkj->nj", rng.dirichlet(np.ones(3), PROBES), mesh.vertices[mesh.triangles[chosen]]), chosen


def _outside(mesh: _Mesh, weights: F64, way: int) -> float:
    """Share of an area, by weights (K,) of its triangles, within no other solid: from within one, a ray outward
    leaves more surfaces than it enters."""
    if not weights.any():
        return 1.0
    points, chosen = _scattered(mesh, weights)
    outward = way * mesh.cross[chosen] / mesh.weights[chosen, None]
    ray, _, triangle = mesh.surface.crossings(points + 1e-4 * np.ptp(points, 0).max() * outward, outward)
    leaving = np.sign(way * np.einsum("nj,nj->n", mesh.cross[triangle], outward[ray]))
    return float((np.bincount(ray, leaving, PROBES) < 0.5).mean())
