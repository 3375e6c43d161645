"""Every collision representation against the exact mesh: error, cost and build time.

    python -m benchmarks.contact.meshes [--names stakes beams] [--representations boxes hull] [--seconds 170] [--again]
                                 [--row-seconds 600]

Terrains: the ten of `tests/truths/solids.py`; the true meshes of the captures where they are found; and what `realsim
reconstruct` makes of those captures, against the truth. Baselines: the naive mesh (`hull`), plain height fields of 2
and 5 cm, CoACD with its own defaults as obj2mjcf calls it. Errors are measured through contacts with balls of 1 cm
(`realsim/export/contact/fidelity.py`); cost is the time of a step with G1 standing, against a plane.

Rows are written to benchmarks/results/contact.json as they are done, and those that are there are not done again: a run
may be cut off, or stopped by --seconds, and goes on where it was. Every row has a process of its own, which is stopped
after --row-seconds of processor time; that it was is then its row. Representations that take minutes are tried on the
terrains of EXPENSIVE only.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import trimesh

from benchmarks.store import Store
from realsim.core.files import read_json
from realsim.core.types import MeshQuality, TerrainMesh
from realsim.export import CONTACT
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_plane
from realsim.export.contact.choose import count_types, fit_contact
from realsim.export.contact.cost import step_cost
from realsim.export.contact.fidelity import measure
from realsim.export.contact.probe import Reference, spec_of
from realsim.export.contact.shape import Shape
from realsim.pipeline import reconstruct
from tests.truths.solids import PLATFORM, TERRAINS, terrain

CONFIG = SceneConfig()
RESULTS = Path(__file__).parents[1] / "results" / "contact.json"

RECONSTRUCTED = " reconstructed"
Row = dict[str, Any]
HEADER = (
    "terrain                 representation  median     p95     max  phantom overgaps  missing drop95  phan%  miss% "
    "leaks   cost   build\n                                            mm      mm      mm      cm2      cm2      cm2   "
    "  mm                    /plane   cpu s"
)


def auto(mesh: TerrainMesh, ground_z: float) -> ContactModel:
    return fit_contact(mesh, ground_z, CONFIG).contact


def coacd_default(mesh: TerrainMesh, ground_z: float) -> ContactModel:
    """CoACD with its own defaults (relative threshold 0.05, its own remeshing) on the whole mesh."""
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.triangles), seed=0)
    assets = tuple(Asset.of_points(f"part_{k}", np.asarray(v)) for k, (v, _) in enumerate(parts))
    geoms = tuple(Geom(a.name, "mesh", asset=a.name) for a in assets)
    return ContactModel("coacd_default", (floor_plane(ground_z), *geoms), assets)


SCANS = ("mixed_a reconstructed", "stake_a reconstructed")
EXPENSIVE = {
    "convex": ("stakes", "beams", "overhang", "arch", *SCANS),
    "sdf": ("stakes", "arch", *SCANS),
    "coacd_default": ("stakes", "beams", "overhang", "arch", *SCANS),
}
"""Terrains that a representation is tried on where it takes minutes."""


def named(name: str, **changes: Any) -> Callable[[TerrainMesh, float], ContactModel]:
    return lambda mesh, ground_z: CONTACT[name](Shape(mesh, ground_z), replace(CONFIG, **changes))


REPRESENTATIONS: dict[str, Callable[[TerrainMesh, float], ContactModel]] = {
    "auto": auto,
    "boxes": named("boxes"),
    "hybrid": named("hybrid"),
    "convex": named("convex", convex_columns=1_000_000),
    "hfield_2cm": named("hfield", hfield_resolution=0.02),
    "hfield_5cm": named("hfield", hfield_resolution=0.05),
    "sdf": named("sdf"),
    "hull": named("hull"),
    "coacd_default": coacd_default,
}


@dataclass(frozen=True)
class Case:
    """A terrain to represent, and the truth to measure against."""

    name: str
    mesh: TerrainMesh
    ground_z: float
    truth: tuple[np.ndarray, np.ndarray]
    """(V, 3) vertices and (K, 3) triangles of the exact surface, metres."""
    truth_z: float
    """Height of the true ground."""
    stand: np.ndarray
    """(3,) where G1 stands."""


def generated(name: str) -> Case:
    mesh = terrain(name)
    return Case(name, mesh, 0.0, (mesh.vertices, mesh.triangles), 0.0, np.array([0, 0, PLATFORM]))


def capture_truth(folder: Path) -> tuple[TerrainMesh, float]:
    """(true mesh of a rendered capture, z of its floor)."""
    mesh: Any = trimesh.load(folder / "gt" / "gt_mesh.ply", process=False)
    vertices, triangles = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, 1, None)
    truth = TerrainMesh(vertices, triangles, None, np.zeros(len(triangles), bool), quality, "truth", 0.0)
    return truth, float(read_json(folder / "gt" / "gt.json")["floor_z_sim"])


def true_capture(folder: Path) -> Case:
    mesh, ground_z = capture_truth(folder)
    return Case(folder.name, mesh, ground_z, (mesh.vertices, mesh.triangles), ground_z, np.zeros(3))


def reconstructed(folder: Path) -> Case:
    """A capture reconstructed with its given poses, as the command line does it."""
    truth, truth_z = capture_truth(folder)
    with tempfile.TemporaryDirectory() as out:
        found = reconstruct(folder / "capture", Path(out) / "scene")
    name = f"{folder.name}{RECONSTRUCTED}"
    return Case(name, found.mesh, found.aligned.ground_z, (truth.vertices, truth.triangles), truth_z, np.zeros(3))


Say = Callable[[Row], None]


def row(case: Case, representation: str, say: Say) -> None:
    """Send the figures of a row piece by piece: what was sent before a process is stopped is not lost."""
    began = time.process_time()
    contact = REPRESENTATIONS[representation](case.mesh, case.ground_z)
    seconds = time.process_time() - began
    chosen = {"chosen": contact.representation} if representation == "auto" else {}
    say(chosen | {"geoms": count_types(contact), "build_cpu_seconds": round(seconds, 2)})
    say(step_cost(spec_of(contact), case.stand))
    say(dict(measure(spec_of(contact), Reference(*case.truth), case.truth_z).figures))


def limited(seconds: int, case: Case, representation: str, chosen: Row | None) -> Row:
    """A row, made in a process of its own that may take `seconds` of processor time.

    Neither CoACD nor MuJoCo's distance fields can be interrupted from Python. A row that was not finished says so
    under `unfinished`, and holds what was known by then.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_in_child, args=(theirs, seconds, case, representation, chosen))
    child.start()
    theirs.close()
    out: Row = {"terrain": case.name, "representation": representation, "triangles": len(case.mesh.triangles)}
    try:
        while True:
            out |= ours.recv()
    except EOFError:
        child.join()
    if child.exitcode:
        doing = "measured" if "build_cpu_seconds" in out else "built"
        why = f"stopped after {seconds} s of processor time" if child.exitcode == -24 else f"exit {child.exitcode}"
        out["unfinished"] = f"{why} while being {doing}"
    return out


def _in_child(pipe: Connection, seconds: int, case: Case, representation: str, chosen: Row | None) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    if chosen is None:
        row(case, representation, pipe.send)
    else:
        # The row of what `auto` chose: its figures, and its own time to build.
        began = time.process_time()
        REPRESENTATIONS[representation](case.mesh, case.ground_z)
        kept = {k: v for k, v in chosen.items() if k not in ("chosen", "representation")}
        pipe.send(kept | {"build_cpu_seconds": round(time.process_time() - began, 2)})


def line(r: Row) -> str:
    if "unfinished" in r:
        return f"{r['terrain']:23s} {r['representation']:13s} {r['unfinished']}"
    d, geoms = r["drop"], " ".join(f"{n} {k}" for k, n in r["geoms"].items())
    return (
        f"{r['terrain']:23s} {r['representation']:13s} {r['median_mm']:7.2f} {r['p95_mm']:7.2f} {r['max_mm']:7.1f} "
        f"{r['phantom_area_cm2']:8.0f} {r['phantom_over_gaps_cm2']:8.0f} {r['missing_area_cm2']:8.0f} "
        f"{d['p95_mm']:7.1f} {100 * d['phantom_share']:6.2f} {100 * d['missing_share']:6.2f} {r['leaks']:5d} "
        f"{r['step_cost_vs_plane']:6.2f} {r['build_cpu_seconds']:7.1f} {geoms}"
    )


def summary(rows: list[Row]) -> list[str]:
    """A Markdown table: one line a representation and kind of mesh, over the terrains that it was tried on."""
    head = (
        "| representation | meshes | median mm | p95 mm | farthest mm | phantom % | missing % | over gaps cm2 | leaks "
        "| cost | build s |"
    )
    out = [head, "|---|" + "---:|" * 10]
    for kind in ("exact", "reconstructed"):
        for name in REPRESENTATIONS:
            some = [
                r
                for r in rows
                if r["representation"] == name and r["terrain"].endswith(RECONSTRUCTED) == (kind == "reconstructed")
            ]
            stopped = [r for r in some if "unfinished" in r]
            out += [f"| `{name}` | {r['terrain']}: {r['unfinished']} |" + " |" * 9 for r in stopped]
            some = [r for r in some if r not in stopped]
            if not some:
                continue
            worst = {k: max(r[k] for r in some) for k in ("median_mm", "p95_mm", "max_mm", "phantom_over_gaps_cm2")}
            share = {k: 100 * max(r["drop"][k] for r in some) for k in ("phantom_share", "missing_share")}
            cost = max(r["step_cost_vs_plane"] for r in some)
            build = max(r["build_cpu_seconds"] for r in some)
            out.append(
                f"| `{name}` | {len(some)} {kind} | {worst['median_mm']:.2f} | {worst['p95_mm']:.1f} "
                f"| {worst['max_mm']:.0f} | {share['phantom_share']:.1f} | {share['missing_share']:.1f} "
                f"| {worst['phantom_over_gaps_cm2']:.0f} | {sum(r['leaks'] for r in some)} | {cost:.1f} | {build:.0f} |"
            )
    return out


def wanted(terrain_name: str, representations: Iterable[str]) -> list[str]:
    """Those representations that are tried on a terrain at all."""
    return [r for r in representations if terrain_name in EXPENSIVE.get(r, (terrain_name,))]


def save(store: Store, names: Iterable[str]) -> dict[str, list[str]]:
    """Write the rows with their table and what is still to be measured; returns that, {terrain: representations}."""
    done = {(r["terrain"], r["representation"]) for r in store.rows}
    missing = {n: [r for r in wanted(n, REPRESENTATIONS) if (n, r) not in done] for n in names}
    missing = {n: some for n, some in missing.items() if some}
    what = "ball of 1 cm, 2000 lowered"
    store.facts = {"probe": what, "missing": missing, "summary": summary(store.rows)}
    store.save()
    return missing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="*", help="terrains; all if not given")
    parser.add_argument("--representations", nargs="*", default=list(REPRESENTATIONS), choices=list(REPRESENTATIONS))
    shared = os.environ.get("REALSIM_SHARED", Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--shared", type=Path, default=Path(shared))
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no row after this time")
    parser.add_argument("--row-seconds", type=int, default=600, help="processor time that a row may take")
    parser.add_argument("--again", action="store_true", help="do the rows anew that are there already")
    args = parser.parse_args()
    cases: dict[str, Callable[[], Case]] = {name: partial(generated, name) for name in TERRAINS}
    for gt in sorted((args.shared / "captures").glob("*/gt")):
        cases[gt.parent.name] = partial(true_capture, gt.parent)
        cases[gt.parent.name + RECONSTRUCTED] = partial(reconstructed, gt.parent)
    began = time.monotonic()
    store = Store(args.out, ("terrain", "representation"))
    for name in args.names or cases:
        todo = [
            r
            for r in wanted(name, args.representations)
            if args.again or store.get(terrain=name, representation=r) is None
        ]
        case = None
        for representation in todo:
            if time.monotonic() - began > args.seconds:
                break
            case = case or cases[name]()
            chosen = store.get(terrain=name, representation="auto") or {}
            # What `auto` chose is measured already: the same input gives the same geoms.
            known = chosen if chosen.get("chosen") == representation else None
            row = store.add(limited(args.row_seconds, case, representation, known))
            print(line(row), file=sys.stderr, flush=True)
            save(store, cases)
    missing = save(store, cases)
    print(HEADER)
    print("\n".join(line(r) for r in store.rows))
    print("\nThe worst of the meshes that each was tried on:\n")
    print("\n".join(summary(store.rows)))
    print("\nNot measured: " + ("; ".join(f"{k}: {', '.join(v)}" for k, v in missing.items()) or "nothing"))


if __name__ == "__main__":
    main()
