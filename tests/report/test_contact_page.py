"""The page of `realsim contact`: verdict, figures, both surfaces, and nothing from elsewhere."""

from pathlib import Path

import numpy as np
import trimesh

import realsim as rs
from tests.pages import read


def test_page_says_what_the_measure_found(tmp_path: Path) -> None:
    floor = trimesh.creation.box((1.2, 0.8, 0.02), trimesh.transformations.translation_matrix((0, 0, -0.01)))
    step = trimesh.creation.box((0.3, 0.4, 0.1), trimesh.transformations.translation_matrix((0.2, 0, 0.05)))
    mesh = trimesh.util.concatenate([floor, step])
    mesh.visual = trimesh.visual.ColorVisuals(vertex_colors=np.full((len(mesh.vertices), 4), 200, np.uint8))
    mesh.export(tmp_path / "step <&>.ply")
    scene = rs.contact(tmp_path / "step <&>.ply", tmp_path / "out", rs.SceneConfig(contact_probes=200))
    page = (tmp_path / "out" / "report.html").read_text()
    text = read(page)
    assert "step <&>.ply" in text
    assert scene.verdict == "good"
    assert "The contact geometry meets every limit." in text
    for word in ("mesh", "collision", "heights off by more than 2 cm", "scene.xml", "contact.json"):
        assert word in text or word in page
    assert "report.json" not in text
