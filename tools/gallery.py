"""Makes the pages of the site's gallery: each by a command, on data that anybody can make again.

    python tools/gallery.py [NAME ...]    # scene, contact, diagnosis; two CPU minutes in all

Writes docs/gallery/NAME.html. The page of a training is made on a GPU: `realsim training report RUN --out
docs/gallery/training.html`.
"""

import runpy
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import trimesh

import realsim as rs
from realsim.align.config import AlignConfig
from realsim.meshing.config import MeshConfig
from realsim.synth import SynthConfig, write_capture

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
MOST_BYTES = 700_000


def scene(work: Path) -> Path:
    """A rendered walk along a course of stakes; the surface is coarse, so that the page is small."""
    write_capture(work / "stakes", SynthConfig("stakes", frames=30, width=320, poses=True))
    config = rs.ReconstructConfig(
        align=AlignConfig(margin=0.4),
        mesh=MeshConfig(resolution=0.02, max_triangles=20_000, residual_views=3),
        scene=rs.SceneConfig(robot="g1"),
    )
    return rs.reconstruct(work / "stakes" / "capture", work / "scene", config).folder


def contact(work: Path) -> Path:
    """Stairs from a CAD program: of one step the top was lost."""
    steps = [trimesh.creation.box(bounds=[(0.3 * k, 0, 0), (0.3 * k + 0.3, 1, 0.12 * k)]) for k in (1, 2, 3, 4)]
    steps[2].update_faces(steps[2].face_normals[:, 2] < 0.5)
    trimesh.util.concatenate(steps).export(work / "stairs.stl")
    return rs.contact(work / "stairs.stl", work / "contact").folder


def diagnosis(work: Path) -> Path:
    """The arm of examples/03_diagnose.py, whose elbow has friction that its model does not know of."""
    found: rs.Diagnosis = runpy.run_path(str(ROOT / "examples" / "03_diagnose.py"))["found"]
    return found.folder


PAGES: dict[str, Callable[[Path], Path]] = {"scene": scene, "contact": contact, "diagnosis": diagnosis}
"""Name -> (working folder) -> folder of the result."""


def main() -> None:
    GALLERY.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PAGES:
        with TemporaryDirectory() as work:
            page = PAGES[name](Path(work)) / "report.html"
            size = page.stat().st_size
            print(f"{name}: {size / 1e3:.0f} kB", flush=True)
            if size > MOST_BYTES:
                raise SystemExit(f"{name} is larger than {MOST_BYTES / 1e3:.0f} kB")
            shutil.copy(page, GALLERY / f"{name}.html")


if __name__ == "__main__":
    main()
