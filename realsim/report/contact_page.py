"""report.html of `realsim contact`: whether a mesh's collision geometry can be used, shown and measured."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import write_text
from realsim.core.meshes import simplify
from realsim.core.types import SceneFiles
from realsim.report import page, raster, viewer3d
from realsim.report.collision import load
from realsim.report.contact import map_card, rows
from realsim.report.document import use_card
from realsim.report.layers import MESH_TRIANGLES, axes_layer, collision_layers, robot_layers
from realsim.report.marks import leaks_of, marks_layer
from realsim.report.viewer3d import Layer, viewer


def write_contact_page(folder: Path, files: SceneFiles) -> None:
    """Write `folder/report.html`, the same bytes for the same scene but for the date and the costs of a step.

    Args:
        folder: holds the exported scene.
        files: what `realsim.export.contact_mesh` returned, its verdict among `contact`.
    """
    c = files.contact
    verdict = c["verdict"]
    mended = files.contact["mended"]
    parts = ["<h4>Warnings</h4>", page.bullets(files.warnings), "<h4>Mended</h4>", page.bullets(mended)]
    body = [
        page.verdict(verdict["level"], verdict["headline"], verdict["reasons"], verdict["next"]),
        page.facts(
            [
                ("Error", f"{c['median_mm']:.1f} mm", "median"),
                ("95 % below", f"{c['p95_mm']:.1f} mm", "of the places that were touched"),
                ("Parts", str(sum(c["geoms"].values())), f"geoms, {c['representation']}"),
                ("Step", f"{c['step_cost_vs_plane']:.2f} x", "the time on a plane, G1 standing"),
            ]
        ),
        page.grid(
            page.card(
                "The mesh and its collision geometry (orange)",
                _view(folder, files),
                "Drag to turn, two fingers or the right button to move, pinch or wheel to zoom.",
                wide=True,
            )
        ),
        page.columns(
            [*map_card(files, [])], [page.card("Warnings and what was mended", "".join(parts)), use_card(folder)]
        ),
        page.folded("All figures", page.table(("figure", "value"), rows(c))),
    ]
    subtitle = f"ground {c['ground']}, collision geometry {c['representation']}"
    html = page.document(f"Contact of {c['mesh']}", subtitle, "".join(body), scripts=[viewer3d.script()])
    write_text(folder / "report.html", html)


def _view(folder: Path, files: SceneFiles) -> str:
    """The mesh in its colours (or by height), and what MuJoCo collides with."""
    import trimesh

    model, data = load(folder / files.scene_xml.name)
    mesh: Any = trimesh.load_mesh(folder / files.mesh_ply.name, process=False)
    z = np.asarray(mesh.vertices)[:, 2]
    colors = raster.colorize(z, float(z.min()), float(z.max()))[:, :3]
    if mesh.visual.kind == "vertex":
        colors = np.asarray(mesh.visual.vertex_colors)[:, :3]
    V, F, C = simplify(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32), colors, limit=MESH_TRIANGLES)
    layers = [Layer("mesh", V, F, C), *collision_layers(model), *robot_layers(model, data), axes_layer()]
    layers += marks_layer(leaks_of(files.contact))
    return viewer(layers, label="the mesh and its collision geometry in 3D", azimuth=float(model.vis.global_.azimuth))
