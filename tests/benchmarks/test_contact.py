"""The contact benchmark keeps what it could not finish, and divides triangles without moving the surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.contact.contact_build import TRIANGLES, subdivided
from benchmarks.contact.meshes import generated, limited, line, save, summary
from benchmarks.store import Store
from realsim.core.files import read_json
from tests.truths.solids import terrain


def test_a_row_that_takes_too_long_says_so_and_is_kept(tmp_path: Path) -> None:
    row = limited(1, generated("stairs"), "sdf", None)
    assert row["unfinished"].startswith("stopped after 1 s of processor time")
    assert row["unfinished"] in line(row)
    assert any(row["unfinished"] in text for text in summary([row]))
    build = [{"terrain": "stairs", "build_s_100k": 1.0}]
    store = Store(tmp_path / "a.json", ("terrain", "representation"))
    store.add(row)
    missing = save(store, ["stairs"], build)
    kept = read_json(tmp_path / "a.json")
    assert "sdf" not in missing.get("stairs", [])
    assert (kept["rows"][0]["unfinished"], kept["build_s_100k"]) == (row["unfinished"], build)


@pytest.mark.parametrize("name", ["stairs", "arch"])
def test_subdivided_terrains_are_the_same_surface(name: str) -> None:
    coarse, fine = terrain(name), subdivided(name)
    assert TRIANGLES <= len(fine.triangles) < 2 * TRIANGLES
    assert area(fine.vertices[fine.triangles]) == pytest.approx(area(coarse.vertices[coarse.triangles]), rel=1e-9)
    np.testing.assert_allclose(
        [fine.vertices.min(0), fine.vertices.max(0)], [coarse.vertices.min(0), coarse.vertices.max(0)]
    )


def area(corners: np.ndarray) -> float:
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(edges, axis=1).sum() / 2)
