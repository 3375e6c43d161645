"""Forty clean meshes as people model them: verdict, parts, leaks, errors, and an independent test with balls.

    python -m benchmarks.contact.clean_meshes [--names chair shelf] [--again] [--up]

Everything is written as a file (STL, OBJ and PLY in turn; z up, metres) and goes through `realsim contact` with its
defaults. The independent test does not use the measure's code: balls and capsules of 1 cm land at 2 m/s on the
surface, half of them on seams between parts, from places where they touch nothing; one is stuck if its middle stays
inside the solid for the last fifth of a second. Rows go to benchmarks/results/clean_meshes.json. --up asks which axis
is up, of every mesh as it is and turned.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, Manifold, OpType

from benchmarks.store import Store
from realsim.core.meshes import mesh_of
from realsim.export import contact_mesh
from realsim.export.config import SceneConfig
from realsim.export.mend import read_mesh
from tests.truths.solids import grid_mesh

RESULTS = Path(__file__).parents[1] / "results" / "clean_meshes.json"
SUFFIXES = (".stl", ".obj", ".ply")
F64 = np.ndarray


def box(x: float, y: float, z: float, sx: float, sy: float, sz: float, turn: float = 0.0) -> Any:
    """A box on (x, y, z), its size, turned about z by degrees."""
    return Manifold.cube([sx, sy, sz], True).translate([0, 0, sz / 2]).rotate([0, 0, turn]).translate([x, y, z])


def union(parts: list[Any]) -> Any:
    return Manifold.batch_boolean(parts, OpType.Add)


def prism(outline: list[tuple[float, float]], width: float) -> Any:
    """An outline in x z, `width` wide in y about 0."""
    section = CrossSection([np.array(outline, float)], FillRule.NonZero)
    return Manifold.extrude(section, width).rotate([90, 0, 0]).translate([0, width / 2, 0])


def steps(count: int, rise: float, run: float, width: float) -> list[Any]:
    return [box(run * (k + 0.5), 0, 0, run, width, rise * (k + 1)) for k in range(count)]


def nosed(count: int, rise: float, run: float, width: float, nose: float) -> Any:
    blocks = [box(run * (k + 0.5), 0, 0, run, width, rise * (k + 1)) for k in range(count)]
    treads = [box(run * (k + 0.5) - nose / 2, 0, rise * (k + 1) - 0.04, run + nose, width, 0.04) for k in range(count)]
    return union(blocks + treads)


def spiral(count: int) -> list[Any]:
    out = []
    for k in range(count):
        a, b = np.radians(25 * k), np.radians(25 * (k + 1))
        ring = [
            (0.25 * np.cos(a), 0.25 * np.sin(a)),
            (np.cos(a), np.sin(a)),
            (np.cos(b), np.sin(b)),
            (0.25 * np.cos(b), 0.25 * np.sin(b)),
        ]
        out.append(Manifold.extrude(CrossSection([np.array(ring)], FillRule.NonZero), 0.15 * (k + 1)))
    return out


def cylinder(x: float, y: float, z: float, radius: float, height: float, sides: int = 24) -> Any:
    return Manifold.cylinder(height, radius, radius, sides).translate([x, y, z])


def legs(half_x: float, half_y: float, height: float, thick: float) -> list[Any]:
    return [box(a * half_x, b * half_y, 0, thick, thick, height) for a in (-1, 1) for b in (-1, 1)]


def chair() -> list[Any]:
    back = [box(-0.21, 0, 0.45, 0.04, 0.4, 0.45)]
    return [*legs(0.18, 0.16, 0.45, 0.05), box(0, 0, 0.41, 0.44, 0.4, 0.05), *back]


def shelf(boards: int = 5) -> list[Any]:
    sides = [box(a * 0.4, 0, 0, 0.04, 0.3, 1.2) for a in (-1, 1)]
    return [*sides, *[box(0, 0, 0.05 + 0.27 * k, 0.84, 0.3, 0.04) for k in range(boards)]]


def rubble(count: int, seed: int) -> list[Any]:
    rng = np.random.default_rng(seed)
    out = [box(0, 0, -0.05, 3, 2, 0.05)]
    for _ in range(count):
        points = rng.normal(size=(14, 3)) * rng.uniform(0.04, 0.14, 3)
        place = [rng.uniform(-1.2, 1.2), rng.uniform(-0.7, 0.7), rng.uniform(-0.03, 0.0) - points[:, 2].min()]
        out.append(Manifold.hull_points(points).translate(place))
    return out


def stones(seed: int) -> list[Any]:
    rng = np.random.default_rng(seed)
    place = [(0.3 * i + rng.uniform(-0.04, 0.04), 0.3 * j + rng.uniform(-0.04, 0.04)) for i in range(6) for j in (0, 1)]
    return [box(x, y, 0, 0.2, 0.2, rng.uniform(0.05, 0.2), rng.uniform(0, 90)) for x, y in place]


def pits() -> Any:
    slab = box(0, 0, -0.4, 3, 2, 0.4)
    return slab - box(-0.7, 0.2, -0.3, 0.5, 0.6, 0.4) - box(0.6, -0.3, -0.2, 0.6, 0.5, 0.4)


def arch(width: float) -> Any:
    return box(0, 0, 0, 0.9, width, 0.45) - Manifold.cylinder(2, 0.3, 0.3, 32, True).rotate([90, 0, 0])


def ladder() -> list[Any]:
    return [box(0, a * 0.25, 0, 0.06, 0.06, 1.5) for a in (-1, 1)] + [
        box(0, 0, 0.25 * k, 0.04, 0.5, 0.04) for k in range(1, 6)
    ]


def pallet() -> list[Any]:
    top = [box(0, -0.36 + 0.18 * k, 0.122, 1.2, 0.1, 0.03) for k in range(5)]
    middle = [box(-0.55 + 0.55 * k, 0, 0.1, 0.1, 0.82, 0.03) for k in range(3)]
    return [
        *top,
        *middle,
        *[box(-0.55 + 0.55 * i, -0.36 + 0.36 * j, 0, 0.1, 0.1, 0.11) for i in range(3) for j in range(3)],
    ]


SLOPE = np.tan(np.radians(12))
MESHES: dict[str, Callable[[], Any]] = {
    "stairs of boxes": lambda: steps(5, 0.15, 0.3, 1.2),
    "stairs, one solid": lambda: union(steps(5, 0.17, 0.28, 1.0)),
    "stairs on a slab": lambda: union([*steps(4, 0.18, 0.27, 0.9), box(0, 0, -0.1, 4, 2, 0.1)]),
    "stairs with nosing": lambda: nosed(6, 0.17, 0.28, 1.2, 0.03),
    "stairs with wide nosing": lambda: nosed(4, 0.16, 0.3, 1.0, 0.06),
    "stairs, mirrored": lambda: union(steps(5, 0.17, 0.28, 1.0)).mirror([1, 0, 0]),
    "stairs, turned 33": lambda: union(steps(5, 0.17, 0.28, 1.0)).rotate([0, 0, 33]),
    "stairs up and down": lambda: union(
        [*steps(4, 0.15, 0.3, 1.0), *[s.mirror([1, 0, 0]).translate([2.4, 0, 0]) for s in steps(4, 0.15, 0.3, 1.0)]]
    ),
    "spiral stairs": lambda: spiral(8),
    "spiral stairs, one solid": lambda: union(spiral(8)),
    "open stairs": lambda: (
        [box(0.28 * k, 0, 0.17 * (k + 1) - 0.04, 0.3, 1.0, 0.04) for k in range(6)]
        + [prism([(-0.15, 0), (0.1, 0), (1.6, 0.98), (1.35, 0.98)], 0.05).translate([0, a * 0.45, 0]) for a in (-1, 1)]
    ),
    "chair": chair,
    "chair, one solid": lambda: union(chair()),
    "stool": lambda: union([cylinder(0, 0, 0.42, 0.18, 0.05), *legs(0.1, 0.1, 0.44, 0.04)]),
    "table": lambda: [box(0, 0, 0.7, 1.2, 0.7, 0.04), *legs(0.55, 0.3, 0.7, 0.06)],
    "table, one solid": lambda: union([box(0, 0, 0.7, 1.2, 0.7, 0.04), *legs(0.55, 0.3, 0.72, 0.06)]),
    "shelf": shelf,
    "shelf, one solid": lambda: union(shelf()),
    "bench": lambda: union([box(0, 0, 0.4, 1.2, 0.3, 0.05), *[box(a * 0.5, 0, 0, 0.05, 0.3, 0.42) for a in (-1, 1)]]),
    "sofa": lambda: union(
        [
            box(0, 0, 0, 1.6, 0.8, 0.4),
            box(0, 0.35, 0, 1.6, 0.15, 0.8),
            box(-0.75, 0, 0, 0.12, 0.8, 0.6),
            box(0.75, 0, 0, 0.12, 0.8, 0.6),
        ]
    ),
    "pallet": pallet,
    "ladder": lambda: union(ladder()),
    "ramp": lambda: prism([(0, 0), (1.5, 0), (1.5, 1.5 * SLOPE)], 1.0),
    "ramp to a platform": lambda: prism([(0, 0), (2.2, 0), (2.2, 1.2 * SLOPE), (1.2, 1.2 * SLOPE)], 1.0),
    "ramp up and down": lambda: prism([(0, 0), (3.0, 0), (2.0, 0.25), (1.0, 0.25)], 1.0),
    "ramp with slats": lambda: union(
        [
            prism([(0, 0), (1.5, 0), (1.5, 1.5 * SLOPE)], 1.0),
            *[box(0.3 * k, 0, 0.3 * k * SLOPE - 0.05, 0.03, 1.0, 0.07) for k in range(1, 5)],
        ]
    ),
    "roof": lambda: prism([(0, 0), (1.6, 0), (1.6, 0.2), (0.8, 0.5), (0, 0.2)], 1.0),
    "ditch": lambda: (
        union([box(0, 0, -0.3, 3, 1.5, 0.3)]) - prism([(-0.5, 0.01), (-0.25, -0.2), (0.25, -0.2), (0.5, 0.01)], 2.0)
    ),
    "arch": lambda: arch(0.5),
    "tunnel": lambda: union([arch(1.5), box(0, 0, -0.05, 2.5, 2.5, 0.05)]),
    "pits": pits,
    "stepping stones": lambda: stones(1),
    "stones on a slab, one solid": lambda: union([*stones(2), box(0.75, 0.15, -0.06, 2.4, 1.2, 0.06)]),
    "beams": lambda: [box(0, 0.25 * k, 0, 1.6, 0.1, 0.12 + 0.03 * k) for k in range(4)],
    "rubble, 40 stones": lambda: rubble(40, 3),
    "boxes in a pile": lambda: [
        box(0, 0, 0, 0.5, 0.4, 0.3),
        box(0.45, 0.05, 0, 0.38, 0.4, 0.25, 8),
        box(0.2, 0, 0.3, 0.4, 0.3, 0.2, 25),
    ],
    "cylinders": lambda: [cylinder(0.5 * k, 0, 0, 0.15 + 0.03 * k, 0.2 + 0.05 * k) for k in range(4)],
    "slope of 6 degrees": lambda: grid_mesh(lambda x, y: x * np.tan(np.radians(6)), 4.0, 30),
    "hill": lambda: grid_mesh(lambda x, y: 0.15 * np.exp(-(x**2 + y**2) / 0.5), 3.0, 60),
    "rack with holes": lambda: (
        box(0, 0, 0, 0.6, 0.4, 0.12)
        - union([cylinder(-0.2 + 0.2 * i, -0.1 + 0.2 * j, 0.03, 0.05, 0.2) for i in range(3) for j in range(2)])
    ),
}


def triangles_of(made: Any) -> tuple[F64, F64]:
    """(vertices, triangles) of a solid, of several put together as they are, or of a sheet."""
    if isinstance(made, tuple):
        return made
    vertices, faces, count = [], [], 0
    for solid in made if isinstance(made, list) else [made]:
        mesh = solid.to_mesh64()
        vertices.append(np.asarray(mesh.vert_properties)[:, :3])
        faces.append(np.asarray(mesh.tri_verts, np.int64) + count)
        count += len(vertices[-1])
    return np.concatenate(vertices), np.concatenate(faces)


def one_surface(made: Any) -> tuple[F64, F64]:
    """The same with solids that touch or overlap made one, so that a point is inside where rays up cross it oddly."""
    return triangles_of(union(made) if isinstance(made, list) else made)


def write_mesh(name: str, folder: Path, turned: bool = False) -> Path:
    """The file of a mesh; `turned` with y up."""
    vertices, faces = triangles_of(MESHES[name]())
    if turned:
        vertices = np.column_stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]])
    path = folder / f"mesh{SUFFIXES[list(MESHES).index(name) % len(SUFFIXES)]}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def row(name: str) -> dict[str, Any]:
    """Verdict and figures of a mesh."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_mesh(name, Path(folder))
        out = Path(folder) / "out"
        out.mkdir()
        began = time.process_time()
        c = contact_mesh(path, out, SceneConfig()).contact
        seconds = time.process_time() - began
        stuck, dropped = stuck_objects(out / "scene.xml", *one_surface(MESHES[name]()))
    return {
        "mesh": name,
        "verdict": c["verdict"]["level"],
        "reasons": c["verdict"]["reasons"],
        "representation": c["representation"],
        "parts": sum(c["geoms"].values()),
        "seams": c.get("seams", 0),
        "leaks": c["leaks"],
        "median_mm": c["median_mm"],
        "p95_mm": c["p95_mm"],
        "through": c["sides"]["through"],
        "step_cost": c["step_cost_vs_plane"],
        "stuck": stuck,
        "dropped": dropped,
        "cpu_seconds": round(seconds, 1),
    }


def stuck_objects(scene: Path, vertices: F64, triangles: F64, count: int = 200) -> tuple[int, int]:
    """(balls and capsules that stay inside, how many landed): at 2 m/s, half of them on edges of collision geoms."""
    import open3d

    surface = open3d.t.geometry.RaycastingScene()
    surface.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
    spec = mujoco.MjSpec.from_file(str(scene))
    rng = np.random.default_rng(5)
    low, high = vertices.min(0), vertices.max(0)
    xy = rng.uniform(low[:2], high[:2], (count, 2))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    edges = [p for g in range(model.ngeom) if model.geom_contype[g] for p in _top_edges(model, data, g, rng)]
    if edges:
        xy[: count // 2] = np.array(edges)[rng.integers(len(edges), size=count // 2)]
    rays = np.column_stack([xy, np.full(count, high[2] + 1), np.tile([0, 0, -1.0], (count, 1))]).astype(np.float32)
    z = high[2] + 1 - surface.cast_rays(open3d.core.Tensor(rays))["t_hit"].numpy()
    xy, z = xy[np.isfinite(z)], z[np.isfinite(z)]
    turn = rng.uniform(0, np.pi, len(z))
    ends = 0.03 * (np.arange(len(z)) % 2)[:, None] * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    begin = np.column_stack([xy, z + 0.012])
    along = begin[:, None] + np.linspace(-1, 1, 9)[:, None] * ends[:, None]
    free = surface.compute_distance(open3d.core.Tensor(along.astype(np.float32))).numpy().min(1) > 0.01
    free &= ~_inside(surface, along).any(1)
    begin, ends = begin[free], ends[free]
    for place, end in zip(begin, ends, strict=True):
        body = spec.worldbody.add_body(pos=place)
        body.add_freejoint()
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if end.any() else mujoco.mjtGeom.mjGEOM_SPHERE
        shape = {"fromto": [*-end, *end]} if end.any() else {}
        body.add_geom(type=kind, size=[0.01, 0, 0], mass=0.03, contype=2, conaffinity=1, **shape)
    for geom in spec.worldbody.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = 1, 2
    spec.memory = 2**28
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 6)[:, 2] = -2.0
    mujoco.mj_step(model, data, nstep=round(0.8 / model.opt.timestep))
    inside = np.ones(len(begin), bool)
    for _ in range(10):
        mujoco.mj_step(model, data, nstep=round(0.02 / model.opt.timestep))
        inside &= _inside(surface, data.qpos.reshape(-1, 7)[:, :3])
    return int(inside.sum()), len(begin)


def _inside(surface: Any, points: F64) -> F64:
    """(...) whether points (..., 3) are more than a millimetre inside a solid, or below a sheet."""
    import open3d

    up = np.concatenate([points, np.broadcast_to([0, 0, 1.0], points.shape)], -1).astype(np.float32)
    deep = surface.compute_distance(open3d.core.Tensor(points.astype(np.float32))).numpy() > 0.001
    return deep & (surface.count_intersections(open3d.core.Tensor(up)).numpy() % 2 == 1)


def _top_edges(model: Any, data: Any, geom: int, rng: np.random.Generator) -> list[F64]:
    """Places (2,) along the upper edges of a box or the hull of a mesh."""
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * model.geom_size[geom]
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        corners = mesh_of(model, model.geom_dataid[geom])[0]
    else:
        return []
    points = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
    top = points[points[:, 2] > points[:, 2].max() - 0.02]
    one, two = rng.integers(len(top), size=(2, 8))
    return list((top[one] + rng.random((8, 1)) * (top[two] - top[one]))[:, :2])


def ask_up() -> None:
    """Prints what is taken to be up of every mesh, as it is and with y up."""
    for name in MESHES:
        said = []
        for turned in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                up = read_mesh(write_mesh(name, Path(folder), turned)).up
            said.append("asks" if up.question else up.axis)
        print(f"{name:30s} z up: {said[0]:5s} y up: {said[1]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="*", help="meshes; all if not given")
    parser.add_argument("--again", action="store_true", help="do the rows anew that are there already")
    parser.add_argument("--up", action="store_true", help="only ask which axis is up")
    args = parser.parse_args()
    if args.up:
        ask_up()
        return
    store = Store(RESULTS, ("mesh",))
    for name in args.names or MESHES:
        if args.again or store.get(mesh=name) is None:
            r = store.add(row(name))
            print(
                f"{r['mesh']:30s} {r['verdict']:5s} {r['representation']:7s} parts {r['parts']} (seams {r['seams']}) "
                f"leaks {r['leaks']} stuck {r['stuck']}/{r['dropped']} error {r['median_mm']:.1f}/{r['p95_mm']:.1f} mm "
                f"cost {r['step_cost']:.2f} cpu {r['cpu_seconds']} s {' '.join(r['reasons'])}",
                flush=True,
            )
    rows = [r for r in store.rows if r["mesh"] in MESHES]
    good = sum(r["verdict"] == "good" for r in rows)
    store.facts = {"good": good, "meshes": len(rows), "stuck": sum(r["stuck"] for r in rows)}
    store.save()
    print(f"{good} of {len(rows)} good")


if __name__ == "__main__":
    main()
