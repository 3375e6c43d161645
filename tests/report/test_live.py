"""The live viewer starts, serves a page, and stops."""

import socket
import urllib.error
import urllib.request
from pathlib import Path

import pytest
import trimesh

import realsim as rs
from realsim.core.errors import RealsimError
from realsim.report import write_report
from realsim.report.live import check_port, view

from .scene import reconstruction


def test_viewer_serves_and_stops(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    result = reconstruction(tmp_path)
    for name in ("mesh.ply", "mesh.glb"):
        trimesh.Trimesh(result.mesh.vertices, result.mesh.triangles, process=False).export(tmp_path / name)
    write_report(tmp_path, result, picture=False)
    server = view(tmp_path, 18431, wait=False)
    url = f"http://127.0.0.1:{server.get_port()}"
    try:
        with urllib.request.urlopen(url, timeout=120) as answer:
            assert b"<html" in answer.read()
    finally:
        server.stop()
    with pytest.raises((urllib.error.URLError, ConnectionError)):
        urllib.request.urlopen(url, timeout=120)


def test_viewer_shows_a_scene_of_a_mesh(tmp_path: Path) -> None:
    """`realsim contact` writes no report.json: there are no cameras and no platforms to show."""
    pytest.importorskip("viser")
    trimesh.creation.box((1.0, 0.6, 0.2)).export(tmp_path / "box.stl")
    rs.contact(tmp_path / "box.stl", tmp_path / "out", rs.SceneConfig(contact_probes=100))
    server = view(tmp_path / "out", 18432, wait=False)
    server.stop()


def test_viewer_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(RealsimError, match="no scene here"):
        view(tmp_path, wait=False)


def test_a_port_that_cannot_be_used_is_refused_before_anything_is_served() -> None:
    for port in (-3, 99_999_999):
        with pytest.raises(RealsimError, match="port"):
            view(Path("scene"), port)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        with pytest.raises(RealsimError, match="port"):
            check_port(taken)
        assert check_port(taken, taken=True) == taken
    assert check_port(0) > 0
