"""The building blocks of reports: numbers, plots, pictures, the packed 3D view, collision triangles."""

import base64
import json
import re
import zlib
from pathlib import Path
from xml.etree import ElementTree

import cv2
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.core.geometry import error_grid
from realsim.core.meshes import simplify
from realsim.report import page, raster, svg, viewer3d
from realsim.report.collision import collision_triangles, sharp_edges
from realsim.synth.solids import box as box_solid


@given(st.floats(-1e5, 1e5), st.floats(1e-3, 1e5))
def test_ticks_lie_inside_and_are_few(low: float, size: float) -> None:
    values = svg.ticks(low, low + size)
    assert 2 <= len(values) <= 11
    assert all(low - 1e-6 * size <= v <= low + size + 1e-6 * size for v in values)
    texts = [t for _, t in svg.labelled(values)]
    assert len(set(texts)) == len(texts)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.0, "1"), (0.00123, "0.00123"), (1234.5, "1234"), (-0.5, "−0.5"), (float("nan"), "–")],
)
def test_numbers_read_well(value: float, text: str) -> None:
    assert svg.number(value) == text


def test_axes_map_data_to_the_corners_of_the_plot() -> None:
    axes = svg.Axes((2.0, 4.0), (-1.0, 1.0))
    x0, y0, x1, y1 = axes.box
    assert (axes.px(2.0), axes.px(4.0), axes.py(-1.0), axes.py(1.0)) == (x0, x1, y1, y0)
    equal = svg.Axes((0.0, 4.0), (0.0, 1.0), equal=True)
    assert equal.px(1.0) - equal.px(0.0) == pytest.approx(equal.py(0.0) - equal.py(1.0))


def test_plots_are_xml_and_escape_names() -> None:
    x = np.arange(5.0)
    y = np.array([0, 1, np.nan, 3, 4])
    pictures = [
        svg.line([svg.Series("a <b>", x, y), svg.Series("c", x, -x)], x_label="t", y_label="q"),
        svg.stacked([("one", 1.0), ("two", 2.5)], unit="s"),
        svg.Axes((0, 1), (0, 2))
        .bar(1, 0.4)
        .whisker(1, 0.2, 0.6)
        .span(0, 1, vertical=True)
        .rule(1, text="<")
        .svg("map"),
    ]
    for picture in pictures:
        ElementTree.fromstring(f"<div>{picture}</div>")
    assert "a &lt;b&gt;" in pictures[0]
    assert "nan" not in "".join(pictures)


def test_png_is_lossless(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (13, 29, 4), np.uint8)
    data = base64.b64decode(raster.png_uri(image).partition(",")[2])
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cv2.cvtColor(read, cv2.COLOR_BGRA2RGBA), image)


def test_colour_map_ends_and_holes() -> None:
    rgba = raster.colorize([[0.0, 1.0, np.nan, 7.0]], 0.0, 1.0)
    assert tuple(rgba[0, 0, :3]) == raster.HEIGHT[0]
    assert tuple(rgba[0, 1, :3]) == tuple(rgba[0, 3, :3]) == raster.HEIGHT[-1]
    assert rgba[0, :, 3].tolist() == [255, 255, 0, 255]


def test_viewer_packs_what_it_is_given() -> None:
    """Read back as viewer.js does: every corner of every triangle has its place and colour."""
    rng = np.random.default_rng(1)
    V, C = rng.uniform(-2, 3, (50, 3)), rng.integers(0, 256, (50, 3), np.uint8)
    F = rng.integers(0, 50, (20, 3))
    html = viewer3d.viewer([viewer3d.Layer("</script>", V, F, C), viewer3d.Layer("nothing", np.zeros((0, 3)), [])])
    (layer,) = json.loads(re.findall(r'json">(.*?)</script>', html)[0])

    def unpacked(name: str, width: int) -> np.ndarray:
        planes = np.frombuffer(zlib.decompress(base64.b64decode(layer[name])), np.uint8).reshape(width, -1)
        return np.array([sum(int(b) << 8 * k for k, b in enumerate(column)) for column in planes.T])

    cells = []
    for back in unpacked("cells", 4):
        cells.append(len(set(cells)) - back)
    places, colors = (
        unpacked(name, width).reshape(3, -1).T.cumsum(0) % 256**width
        for name, width in (("vertices", 2), ("colors", 1))
    )
    np.testing.assert_allclose(layer["low"] + places[cells] / 65535 * layer["size"], V[F.ravel()], atol=1e-4)
    np.testing.assert_array_equal(colors[cells], C[F.ravel()])
    assert layer["name"] == "</script>"


def test_simplify_keeps_the_surface() -> None:
    n = 60
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    V = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel()
    F = np.vstack([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    V2, F2, C2 = simplify(V, F, np.full((n * n, 3), 200), 500)
    assert len(F2) <= 600
    assert C2.shape == (len(V2), 3)
    t = V2[F2]
    assert np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() / 2 == pytest.approx(
        1, abs=0.01
    )


def test_frustums_open_along_the_view() -> None:
    T = np.eye(4)
    T[:3, 3] = 1, 2, 3
    V, E = viewer3d.camera_frustums(T, 0.5, 0.4, 0.2)
    np.testing.assert_allclose(V[0], [1, 2, 3])
    np.testing.assert_allclose(V[1:, 2], 3.2)
    assert E.max() == 4


def test_collision_triangles_lie_where_rays_of_the_physics_hit(tmp_path: Path) -> None:
    heights = " ".join(f"{v:.3f}" for v in np.random.default_rng(0).random(12))
    path = tmp_path / "scene.xml"
    path.write_text(
        f"""<mujoco><asset><hfield name="h" nrow="3" ncol="4" size="1 0.5 0.3 0.1" elevation="{heights}"/></asset>
        <worldbody><geom type="hfield" hfield="h" pos="0.2 0 0"/>
        <geom type="box" pos="3 0 0" size="0.2 0.3 0.1" euler="0 0 30"/>
        <geom type="box" pos="6 0 0" size="1 1 1" contype="0" conaffinity="0"/>
        <geom type="plane" pos="0 0 -1" size="1 1 1"/></worldbody></mujoco>"""
    )
    V, F = collision_triangles(path)
    assert V[:, 0].max() < 4  # what is only seen is left out
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    t = V[F]
    up = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])[:, 2] > 1e-9
    hit = np.zeros(1, np.int32)
    for centre in t[up].mean(1):
        distance = mujoco.mj_ray(model, data, centre + np.array([0, 0, 2.0]), np.array([0, 0, -1.0]), None, 1, -1, hit)
        assert distance == pytest.approx(2.0, abs=2e-3)


def test_sharp_edges_of_a_box_are_its_twelve_edges() -> None:
    solid = box_solid("a", (1.0, 2.0, 3.0), "wood")
    edges = sharp_edges(solid.vertices, np.asarray(solid.triangles))
    assert len(edges) == 12
    lengths = np.linalg.norm(solid.vertices[edges[:, 0]] - solid.vertices[edges[:, 1]], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat([1.0, 2.0, 3.0], 4))


def test_pieces_escape_text() -> None:
    for piece in (
        page.table(["<a>"], [["<b>"]]),
        page.facts([("<a>", "<b>", "<c>")]),
        page.bullets(["<x>"]),
        page.code("a < b"),
        page.verdict("good", "<i>", ["<j>"]),
    ):
        assert not re.search(r"<(a|b|c|x|i|j)>", piece.replace("<b>&lt;b&gt;</b>", ""))


def test_the_contact_map_shows_the_worst_of_a_cell_from_above() -> None:
    x, y = np.meshgrid(np.arange(10) / 10, np.arange(5) / 10)
    error = np.zeros(x.size)
    error[-1] = 0.02  # largest x, largest y: upper right
    grid = error_grid(np.column_stack([x.ravel(), y.ravel(), error]))
    assert grid[0, -1] == 0.02
    assert np.nanmin(grid) == 0
