"""Contact from the side and from above, with columns alone (`boxes`, as it was) and as `auto` chooses now.

    python -m benchmarks.contact.sides [--names corridor room] [--large]

The synthetic rooms of `tests/truths/rooms.py`; with --large, `auto` on the rooms of tests/truths/scanned_rooms.py, each
in a process of its own, with what it took. Rows go to benchmarks/results/sides.json. Rays and heights are those of
`realsim/export/contact/fidelity.py`; `benchmarks/scenes/real_captures.py` has them of real captures.
"""

import argparse
import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.store import Store
from realsim.core.types import TerrainMesh
from realsim.export.any_mesh import contact_verdict
from realsim.export.config import SceneConfig
from realsim.export.contact.choose import fit_contact
from tests.truths.rooms import ROOMS
from tests.truths.scanned_rooms import LARGE

ROOT = Path(__file__).resolve().parents[2]


def _row(name: str, mesh: TerrainMesh, contact: str) -> dict[str, Any]:
    fitted = fit_contact(mesh, 0.0, SceneConfig(contact=contact))
    s = fitted.summary
    return {
        "scene": name,
        "contact": contact,
        "chosen": s["representation"],
        "p95_mm": s["p95_mm"],
        "heights_off": round(fitted.fidelity.off[0], 4),
        **{k: s["sides"][k] for k in ("rays", "stopped", "through", "early", "balls", "balls_through")},
        "leaks": s["leaks"],
        "geoms": sum(s["geoms"].values()),
        "step_cost_vs_plane": s["step_cost_vs_plane"],
        "steps_per_second": s["steps_per_second"],
        "verdict": contact_verdict(s | {"hidden_cm2": 0.0}, SceneConfig().contact_tolerance)["level"],
    }


def large(name: str) -> dict[str, Any]:
    """A room at its real size, with seconds of the processor and gigabytes at most, reading the mesh included."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_used, name, LARGE[name]()).result()


def _used(name: str, mesh: TerrainMesh) -> dict[str, Any]:
    row = _row(name, mesh, "auto")
    used = resource.getrusage(resource.RUSAGE_SELF)
    took = {"cpu_s": round(used.ru_utime + used.ru_stime, 1), "peak_gb": round(used.ru_maxrss / 1e6, 2)}
    return row | {"triangles": len(mesh.triangles)} | took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="*", help="scenes; all if not given")
    parser.add_argument("--large", action="store_true", help="only the rooms at their real size")
    args = parser.parse_args()
    store = Store(ROOT / "benchmarks" / "results" / "sides.json", ("scene", "contact"))
    for name in args.names or (LARGE if args.large else ROOMS):
        for contact in ("auto",) if name in LARGE else ("boxes", "auto"):
            row = store.add(large(name) if name in LARGE else _row(name, ROOMS[name](), contact))
            print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
