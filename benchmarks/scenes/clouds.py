"""Clouds that do not say from where they were seen: what becomes of them, against the exact terrain.

    python -m benchmarks.scenes.clouds [--names stake1 narrow3]

Each test terrain is scanned as in `benchmarks/training/ttt_sources.py` (5 mm of noise, no normals) and reconstructed
by default. Collision geometry is measured twice (`realsim/export/contact/fidelity.py`): against the mesh, as it was
chosen, and against the truth. Rows go to benchmarks/results/clouds.json.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh

from benchmarks.store import Store
from benchmarks.training.ttt_sources import scanned
from realsim.core.geometry import transform
from realsim.export.contact.fidelity import measure
from realsim.export.contact.probe import Reference
from realsim.export.unite import united
from realsim.pipeline import reconstruct
from trainer import terrain as terrains

ROOT = Path(__file__).resolve().parents[2]
SEED = 0


def row(name: str, folder: Path) -> dict[str, Any]:
    """One terrain, scanned and reconstructed in an empty folder."""
    found = reconstruct(scanned(terrains.named(name), folder, SEED), folder / "scene")
    exact: Any = trimesh.load(folder / "walk" / "truth" / "mesh.ply", process=False)
    vertices = transform(found.aligned.T_sim_world, np.asarray(exact.vertices, float))
    truth = Reference(*united(vertices, np.asarray(exact.faces, np.int32))[:2])
    off = 1000 * truth.distance(found.mesh.vertices[np.unique(found.mesh.seen)])
    spec = mujoco.MjSpec.from_file(str(found.scene.folder / "scene.xml"))
    against = measure(spec, truth, found.aligned.ground_z).figures
    own = found.scene.contact
    return {
        "terrain": name,
        "chosen": own["representation"],
        "geoms": sum(own["geoms"].values()),
        "own_p95_mm": own["p95_mm"],
        "own_leaks": own["leaks"],
        "mesh_median_mm": round(float(np.median(off)), 2),
        "mesh_p95_mm": round(float(np.percentile(off, 95)), 2),
        **{k: against[k] for k in ("median_mm", "p95_mm", "phantom_over_gaps_cm2", "leaks")},
        **{k: against["sides"][k] for k in ("rays", "stopped", "through", "early")},
        "heights_off": round(against["drop"]["phantom_share"] + against["drop"]["missing_share"], 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="*", default=list(terrains.TESTS), help="test terrains; all if not given")
    names = parser.parse_args().names
    store = Store(ROOT / "benchmarks" / "results" / "clouds.json", ("terrain",))
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            made = row(name, Path(folder))
        store.add(made)
        print("  ".join(f"{key} {value}" for key, value in made.items()), flush=True)


if __name__ == "__main__":
    main()
