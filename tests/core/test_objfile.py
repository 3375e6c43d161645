"""Wavefront OBJ by its specification: relative indices, groups, several objects, polygons."""

import numpy as np
import pytest

from realsim.core.objfile import parse_obj

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


def area(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_relative_indices_count_back_from_their_own_line() -> None:
    faces = "f -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n"
    moved = TETRAHEDRON.replace("v 0", "v 5").replace("v 1", "v 6")
    both = parse_obj(f"o a\n{TETRAHEDRON}{faces}g b\n{moved}{faces}".encode())
    positive = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\nf 5 7 6\nf 5 6 8\nf 5 8 7\nf 6 7 8\n"
    same = parse_obj((TETRAHEDRON + moved + positive).encode())
    np.testing.assert_array_equal(both.triangles, same.triangles)
    np.testing.assert_array_equal(both.vertices, same.vertices)


def test_normals_textures_tabs_comments_and_continued_lines() -> None:
    text = "# c\r\nmtllib x\nv\t0 0 0\r\nv 1 0 0 \nv 0 1 0\nvt 0 0\nvn 0 0 1\ns off\nf 1/1/1 2//1 \\\n3/1\nl 1 2\n"
    mesh = parse_obj(text.encode())
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2]])
    assert (mesh.faces, mesh.bad_faces) == (1, 0)


def test_a_polygon_with_a_dent_keeps_its_area() -> None:
    """An L of five unit squares' corners: a fan from any corner but one would leave it."""
    ring = [(1, 0), (3, 0), (3, 1), (2, 1), (2, 3), (1, 3)]
    lines = [f"v {x} {y} 0.5" for x, y in ring]
    for start in range(6):
        order = " ".join(str((start + k) % 6 + 1) for k in range(6))
        mesh = parse_obj("\n".join([*lines, f"f {order}"]).encode())
        assert area(mesh) == pytest.approx(4.0)
        a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all(), "faces the same way as the polygon"


def test_faces_that_cannot_be_read_are_counted() -> None:
    mesh = parse_obj((TETRAHEDRON + "f 1 2 3\nf 1 2 9\nf 1 x 3\nf 1 2\nf 0 1 2\nf -9 1 2\n").encode())
    assert (len(mesh.triangles), mesh.faces, mesh.bad_faces) == (1, 6, 5)


def test_colors_of_vertices() -> None:
    mesh = parse_obj(b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0.5\nf 1 2 3\n")
    np.testing.assert_array_equal(mesh.colors, [[255, 0, 0], [0, 255, 0], [0, 0, 128]])
    assert parse_obj(b"v 0 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").colors is None
    with pytest.raises(ValueError, match="coordinates"):
        parse_obj(b"v 0 0\n")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_before_the_text_and_indents_hide_no_vertex(encoding: str) -> None:
    text = "  " + TETRAHEDRON.replace("\n", "\n  ") + "f 1 3 2\n\tf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    np.testing.assert_array_equal(parse_obj(text.encode(encoding)).vertices[1], [1, 0, 0])
    assert area(parse_obj(text.encode(encoding))) == pytest.approx(1.5 + 3**0.5 / 2)
