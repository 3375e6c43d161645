"""The notebooks run, cell by cell, and end with the truth that they made; so does the first example.

The other examples are run by tools/check_wheel.sh.
"""

import json
import runpy
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from realsim import pipeline
from realsim.export.config import SceneConfig
from realsim.meshing.config import MeshConfig
from realsim.pipeline import ReconstructConfig

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is known after the last cell of a notebook that ran in a folder of its own."""
    notebook = json.loads((EXAMPLES / "notebooks" / f"{name}.ipynb").read_text())
    assert all(not cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code")
    monkeypatch.chdir(place)
    known: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{name}.ipynb", "exec"), known)
    return known


@pytest.mark.slow
def test_contact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = run("contact", tmp_path, monkeypatch)
    assert known["scene"].verdict == "good"
    assert "<table>" in known["scene"]._repr_html_()
    assert list((tmp_path / "other").rglob("*.obj"))


def test_diagnose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = run("diagnose", tmp_path, monkeypatch)
    assert known["found"].causes[0].effect == "coulomb_friction"
    assert known["mended"].compile().dof_frictionloss[0] == pytest.approx(0.3, rel=0.15)
    assert "<table>" in known["found"]._repr_html_()


@pytest.mark.slow
def test_reconstruct(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More coarsely than a reader's own run. The example finds the stages of the notebook's capture made."""
    quick = SceneConfig(contact_probes=200, contact="hfield")
    coarse = partial(ReconstructConfig, mesh=MeshConfig(resolution=0.03), scene=quick)
    monkeypatch.setattr(pipeline, "ReconstructConfig", coarse)
    monkeypatch.setenv("REALSIM_CACHE", str(tmp_path / "cache"))
    known = run("reconstruct", tmp_path, monkeypatch)
    assert known["scene"].verdict.usable
    assert abs(known["off"]) < 15
    monkeypatch.setattr(sys, "argv", ["01_reconstruct.py", str(known["capture"])])
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    known = runpy.run_path(str(EXAMPLES / "01_reconstruct.py"))
    assert abs(known["data"].qpos[2] - known["z"] - 0.05) < 0.015
