"""The comparison of sources of points: in the page and in report.json when it was requested, absent otherwise."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.core import modes
from realsim.core.types import Mode
from realsim.report import write_report

from .scene import reconstruction


def test_the_card_shows_every_mode_and_why_one_failed(tmp_path: Path) -> None:
    plain = reconstruction(tmp_path)
    write_report(tmp_path, plain, picture=False)
    assert "Sources of points compared" not in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "report.json").read_text())["modes"] == []
    rows = (
        Mode("onnx", scale=3.2, scale_ci90=(0.99, 1.01), used=12, seen_m2=11.0, seconds=8.0),
        Mode("onnx+depth", "the model's poses contradict the depth & more"),
        Mode("rgbd", scale=1.0, scale_ci90=(0.99, 1.01), used=11, dropped=1, apart_m=0.0042, seconds=20.0),
    )
    write_report(tmp_path, replace(plain, modes=rows), picture=False)
    page = (tmp_path / "report.html").read_text()
    assert "Sources of points compared" in page
    assert "contradict the depth &amp; more" in page
    assert "4.2\u00a0mm" in page
    found = json.loads((tmp_path / "report.json").read_text())["modes"]
    assert [m["backend"] for m in found] == ["onnx", "onnx+depth", "rgbd"]
    assert found[0]["apart_m"] is None


def test_the_distance_of_two_surfaces_is_that_between_them(tmp_path: Path) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    mesh = replace(reconstruction(tmp_path).mesh, vertices=corners, triangles=faces, invented=np.zeros(2, bool))
    lifted = replace(mesh, vertices=corners + np.array([0, 0, 0.004]))
    assert modes._apart(mesh, mesh) < 1e-9
    assert modes._apart(lifted, mesh) == pytest.approx(0.004, abs=1e-4)


def test_what_is_compared() -> None:
    assert modes.others("onnx") == ("onnx+depth", "rgbd")
    assert modes.others("colmap") == ("onnx", "onnx+depth", "rgbd")
