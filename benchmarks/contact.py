"""Every collision representation against the exact mesh: error, cost and build time.

    python -m benchmarks.contact [--names stakes beams] [--representations boxes hull] [--shared ../shared]

Terrains: the ten of `benchmarks/solids.py`, and the true meshes of the captures where they are found. Baselines: the
naive mesh (`hull`), plain height fields of 2 and 5 cm, CoACD as obj2mjcf calls it. Errors are measured through contacts
with balls of 1 cm (`realsim/export/contact/fidelity.py`); cost is the time of a step with G1 standing, against a plane.
Writes benchmarks/results/contact.json.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.solids import TERRAINS, terrain
from realsim.export import CONTACT
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_plane
from realsim.export.contact.choose import count_types, fit_contact
from realsim.export.contact.cost import step_cost
from realsim.export.contact.fidelity import measure
from realsim.export.contact.probe import Reference, spec_of
from realsim.files import read_json, to_json, write_text
from realsim.types import MeshQuality, TerrainMesh

CONFIG = SceneConfig()
RESULTS = Path(__file__).parent / "results" / "contact.json"

HEADER = (
    "terrain           representation  median     p95     max  phantom  missing drop95  phan%  miss% leaks   cost   "
    "build\n                                      mm      mm      mm      cm2      cm2     mm                    "
    "/plane   cpu s"
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


def named(name: str, **changes: Any) -> Callable[[TerrainMesh, float], ContactModel]:
    return lambda mesh, ground_z: CONTACT[name](mesh, ground_z, replace(CONFIG, **changes))


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


def capture_truth(folder: Path) -> tuple[TerrainMesh, float]:
    """(true mesh of a rendered capture, z of its floor)."""
    import trimesh

    mesh: Any = trimesh.load(folder / "gt" / "gt_mesh.ply", process=False)
    vertices, triangles = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, 1, None)
    truth = TerrainMesh(vertices, triangles, None, np.zeros(len(triangles), bool), quality, "truth", 0.0)
    return truth, float(read_json(folder / "gt" / "gt.json")["floor_z_sim"])


def row(name: str, representation: str, mesh: TerrainMesh, ground_z: float, stand: np.ndarray) -> dict[str, Any]:
    began = time.process_time()
    contact = REPRESENTATIONS[representation](mesh, ground_z)
    seconds = time.process_time() - began
    figures = measure(spec_of(contact), Reference(mesh.vertices, mesh.triangles), ground_z).figures
    out = {"terrain": name, "representation": representation, "triangles": len(mesh.triangles)}
    out |= dict(figures) | step_cost(spec_of(contact), stand)
    return out | {"geoms": count_types(contact), "build_cpu_seconds": round(seconds, 2)}


def line(r: dict[str, Any]) -> str:
    d, geoms = r["drop"], " ".join(f"{n} {k}" for k, n in r["geoms"].items())
    return (
        f"{r['terrain']:17s} {r['representation']:13s} {r['median_mm']:7.2f} {r['p95_mm']:7.2f} {r['max_mm']:7.1f} "
        f"{r['phantom_area_cm2']:8.0f} {r['missing_area_cm2']:8.0f} {d['p95_mm']:7.1f} {100 * d['phantom_share']:6.2f} "
        f"{100 * d['missing_share']:6.2f} {r['leaks']:5d} {r['step_cost_vs_plane']:6.2f} {r['build_cpu_seconds']:7.1f} "
        f"{geoms}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="*", help="terrains; all if not given")
    parser.add_argument("--representations", nargs="*", default=list(REPRESENTATIONS), choices=list(REPRESENTATIONS))
    shared = os.environ.get("REALSIM_SHARED", Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--shared", type=Path, default=Path(shared))
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args()
    cases: dict[str, Callable[[], tuple[TerrainMesh, float, np.ndarray]]] = {
        name: (lambda name=name: (terrain(name), 0.0, np.array([0, 0, 0.35]))) for name in TERRAINS
    }
    for folder in sorted((args.shared / "captures").glob("*/gt")):
        cases[folder.parent.name] = lambda folder=folder: (*capture_truth(folder.parent), np.zeros(3))
    rows = []
    print(HEADER)
    for name in args.names or cases:
        mesh, ground_z, stand = cases[name]()
        for representation in args.representations:
            rows.append(row(name, representation, mesh, ground_z, stand))
            print(line(rows[-1]), flush=True)
            write_text(args.out, to_json({"probe": "ball of 1 cm, 2000 lowered", "rows": rows}))


if __name__ == "__main__":
    main()
