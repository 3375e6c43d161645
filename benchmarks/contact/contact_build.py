"""How long the whole of `auto` takes on meshes of about 100k triangles: building, measuring, and choosing.

Terrains of `tests/truths/solids.py`, their triangles divided until there are as many, and a reconstruction decimated
towards as many, as far as its bound on the error allows (rows say how many there were). The same surface in more
triangles needs the same geoms, so that only what grows with triangles is timed; what grows with noise shows on the
reconstruction.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.types import TerrainMesh
from realsim.export.config import SceneConfig
from realsim.export.contact.choose import fit_contact
from tests.truths.solids import terrain

SUBDIVIDED = ("stakes", "wedges", "arch", "stairs")
CAPTURE = "mixed_a"
TRIANGLES = 100_000
Row = dict[str, Any]


def subdivided(name: str) -> TerrainMesh:
    """A generated terrain whose longest edges were halved until it has about TRIANGLES triangles."""
    import trimesh

    mesh = terrain(name)
    whole = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    edge = float(whole.edges_unique_length.max())
    while len(whole.faces) < TRIANGLES:
        edge *= 0.9
        whole = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.triangles, edge), process=False)
    faces = np.asarray(whole.faces, np.int32)
    return replace(mesh, vertices=np.asarray(whole.vertices), triangles=faces, invented=np.zeros(len(faces), bool))


def reconstructed(folder: Path) -> tuple[TerrainMesh, float]:
    """(mesh, z of the ground) of a capture with `--max-triangles TRIANGLES`, which counts measured triangles only."""
    from realsim.meshing.config import MeshConfig
    from realsim.pipeline import ReconstructConfig, reconstruct

    config = ReconstructConfig(mesh=MeshConfig(max_triangles=TRIANGLES))
    with tempfile.TemporaryDirectory() as out:
        found = reconstruct(folder / "capture", Path(out) / "scene", config)
    return found.mesh, found.aligned.ground_z


def timed(name: str, mesh: TerrainMesh, ground_z: float) -> Row:
    """Seconds of the clock and of the processor (all threads) that `auto` takes, in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return {"terrain": name, "triangles": len(mesh.triangles)} | pool.submit(_timed, mesh, ground_z).result()


def _timed(mesh: TerrainMesh, ground_z: float) -> Row:
    clock, processor = time.perf_counter(), time.process_time()
    fitted = fit_contact(mesh, ground_z, SceneConfig())
    return {
        "build_s_100k": round(time.perf_counter() - clock, 2),
        "cpu_seconds": round(time.process_time() - processor, 2),
        "chosen": fitted.contact.representation,
        "tried": [c["representation"] for c in fitted.summary["considered"]],
    }


def build_times(shared: Path) -> list[Row]:
    """One row a mesh; the reconstruction where its capture is found."""
    rows = [timed(name, subdivided(name), 0.0) for name in SUBDIVIDED]
    capture = shared / "captures" / CAPTURE
    if capture.is_dir():
        rows.append(timed(f"{CAPTURE} reconstructed", *reconstructed(capture)))
    return rows


def build_table(rows: list[Row]) -> list[str]:
    """A Markdown table of them."""
    head = ["| mesh | triangles | clock s | processor s | chosen |", "|---|---:|---:|---:|---|"]
    return head + [
        f"| {r['terrain']} | {r['triangles']} | {r['build_s_100k']} | {r['cpu_seconds']} | `{r['chosen']}` |"
        for r in rows
    ]
