"""The ground of a mesh: its own floor, else its lowest point; what a wrong one hides is counted."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from realsim.cli import command_line as cli
from realsim.core.errors import ExportError
from realsim.core.types import TerrainMesh
from realsim.export import contact_mesh
from realsim.export.config import SceneConfig
from realsim.export.ground import ground_level
from realsim.export.mend import mend
from tests.truths.solids import TERRAINS, block, terrain

CONFIG = SceneConfig(contact_probes=200)


def on_zero(*boxes: tuple[float, float, float, float, float, float]) -> Manifold:
    """The union of boxes (x, y, size x, size y, top, bottom)."""
    whole = Manifold()
    for box in boxes:
        whole += block(*box)
    return whole


def legs(height: float) -> list[tuple[float, float, float, float, float, float]]:
    return [(0.45 * a, 0.25 * b, 0.05, 0.05, height, 0.0) for a in (-1, 1) for b in (-1, 1)]


STAKES = [(0.4 * i - 1.0, 0.35 * j - 0.6, 0.17, 0.15, 0.15 + 0.02 * i, -0.01) for i in range(6) for j in range(4)]
WITHOUT = {
    "box": on_zero((0, 0, 0.6, 0.4, 0.3, 0)),
    "steps": on_zero(*[(0.3 * k, 0, 0.3, 0.8, 0.17 * (k + 1), 0) for k in range(4)]),
    "ball": Manifold.sphere(0.25, 64).translate([0, 0, 0.25]),
    "table": on_zero((0, 0, 1.0, 0.6, 0.75, 0.72), *legs(0.73)),
    "arch": block(0, 0, 0.7, 0.4, 0.32, 0) - Manifold.cylinder(1, 0.22, 0.22, 96, True).rotate([90, 0, 0]),
    "podium": on_zero((0, 0, 1, 1, 0.2, 0), (0, 0, 0.5, 0.5, 0.4, 0)),
    "pallet": on_zero((0, 0, 1.2, 0.8, 0.144, 0), (0, 0, 0.4, 0.4, 0.4, 0.1)),
    "platform": on_zero((0, 0, 2, 2, 0.3, 0)),
}
SLABS = {
    "2 cm": on_zero((0, 0, 3, 2, 0, -0.02), *STAKES),
    "10 cm": on_zero((0, 0, 3, 2, 0, -0.1), *STAKES),
}


def mended(solid: Manifold) -> TerrainMesh:
    mesh = solid.to_mesh64()
    return mend(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, np.int32)).terrain


def stl(path: Path, solid: Manifold) -> Path:
    mesh = solid.to_mesh64()
    trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts), process=False).export(path)
    return path


@pytest.mark.parametrize("name", WITHOUT)
@pytest.mark.parametrize("lift", [0.0, -1.3])
def test_what_has_no_floor_stands_on_its_lowest_point(name: str, lift: float) -> None:
    found = ground_level(mended(WITHOUT[name].translate([0.2, 0, lift])))
    assert found.z == pytest.approx(lift, abs=1e-6)
    assert "no floor of its own" in found.description


def test_a_box_without_a_bottom_too() -> None:
    mesh = mended(WITHOUT["box"])
    open_below = mesh.triangles[mesh.vertices[mesh.triangles][..., 2].max(1) > 0.01]
    assert ground_level(mend(mesh.vertices, open_below).terrain).z == pytest.approx(0.0, abs=1e-6)


def test_a_table_whose_legs_do_not_reach_the_rim_of_its_thin_top_stands_on_them() -> None:
    """Its rim lies at one level, as that of a floor does: all below it was lost."""
    table = on_zero((0, 0, 1.4, 0.9, 0.64, 0.632), *legs(0.635)).to_mesh64()
    made = mend(np.asarray(table.vert_properties)[:, :3], np.asarray(table.tri_verts)).terrain
    assert ground_level(made).z == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("name", TERRAINS)
def test_a_sheet_of_floor_is_the_ground_though_solids_reach_below(name: str) -> None:
    assert ground_level(terrain(name)).z == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", SLABS)
def test_a_slab_under_what_stands_on_it_is_a_floor(name: str) -> None:
    found = ground_level(mended(SLABS[name]))
    assert (found.z, found.slab) == (pytest.approx(0.0, abs=1e-6), True)
    assert f"slab of {name}" in found.description
    assert "--ground-z" in found.description


def test_a_noisy_scan_keeps_its_floor() -> None:
    rng = np.random.default_rng(0)
    vertices = np.column_stack([g.ravel() for g in np.meshgrid(np.arange(60) * 0.03, np.arange(50) * 0.03)])
    z = np.where((np.abs(vertices - 0.8) < 0.25).all(1), 0.3, 0.0) + rng.normal(0, 0.003, len(vertices))
    a = (np.arange(49)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 60], 1), np.stack([a + 1, a + 61, a + 60], 1)])
    mesh = mend(np.column_stack([vertices, z]), faces).terrain
    assert ground_level(mesh).z == pytest.approx(0.0, abs=0.005)


def test_the_scene_of_a_box_has_the_box(tmp_path: Path) -> None:
    files = contact_mesh(stl(tmp_path / "box.stl", WITHOUT["box"]), tmp_path, CONFIG)
    assert files.contact["geoms"] == {"plane": 1, "box": 1}
    assert (files.contact["hidden_cm2"], files.contact["missing_area_cm2"]) == (0, 0)
    assert files.contact["verdict"]["level"] == "good"


def test_what_a_wrong_ground_hides_is_missing(tmp_path: Path) -> None:
    """The sides of the first step: two of 0.3 m, the front and the back, 0.17 m high, but for the lowest 1.5 cm."""
    path = stl(tmp_path / "steps.stl", WITHOUT["steps"])
    (tmp_path / "out").mkdir()
    contact = contact_mesh(path, tmp_path / "out", CONFIG, ground_z=0.17).contact
    assert contact["hidden_cm2"] == pytest.approx(1e4 * 0.155 * (2 * 1.2 + 2 * 0.8), rel=0.03)
    assert contact["missing_area_cm2"] >= contact["hidden_cm2"]
    assert contact["verdict"]["level"] == "bad"
    for height in (0.3, 0.4, 99.0):
        with pytest.raises(ExportError, match="no part of the mesh rises"):
            contact_mesh(stl(tmp_path / "box.stl", WITHOUT["box"]), tmp_path / "out", CONFIG, ground_z=height)
    with pytest.raises(ExportError, match="unknown axis 'x'"):
        contact_mesh(path, tmp_path / "out", CONFIG, up="x")
    with pytest.raises(ExportError, match="not a number"):
        contact_mesh(path, tmp_path / "out", CONFIG, ground_z=float("nan"))


def test_pits_and_a_slabs_sides_are_not_missing(tmp_path: Path) -> None:
    dug = on_zero((0, 0, 3, 2, 0, -0.4)) - block(0.5, 0, 0.6, 0.6, 0.1, -0.2)
    (tmp_path / "pit").mkdir()
    pit = contact_mesh(stl(tmp_path / "pit.stl", dug), tmp_path / "pit", CONFIG, ground_z=0.0).contact
    # The sides of the slab are gone, since the ground was said to be a floor; those of the pit are there.
    assert pit["hidden_cm2"] == pytest.approx(1e4 * 10 * (0.4 - 0.015), rel=0.05)
    (tmp_path / "slab").mkdir()
    slab = contact_mesh(stl(tmp_path / "slab.stl", SLABS["2 cm"]), tmp_path / "slab", CONFIG).contact
    assert slab["hidden_cm2"] == 0


def test_strict_makes_do_not_use_an_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = stl(tmp_path / "steps.stl", WITHOUT["steps"])
    options = ["contact", str(path), "--contact-probes", "200", "--ground-z", "0.17", "--out"]
    assert cli.main([*options, str(tmp_path / "a"), "--strict"]) == 3
    shown = capsys.readouterr().out
    assert shown.startswith("Do not use: ")
    assert "  next     " in shown
    assert (tmp_path / "a" / "scene.xml").is_file()
