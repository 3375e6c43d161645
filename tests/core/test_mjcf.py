"""MJCF that would run away, or reaches out of its folder, is refused before MuJoCo reads it."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from realsim.core.errors import GapError, RealsimError
from realsim.core.mjcf import check_mjcf
from realsim.gap import load_case

GEOM = '<geom size="1"/>'


def nested(levels: int, count: int) -> str:
    return f'<replicate count="{count}" offset="1 0 0">' * levels + GEOM + "</replicate>" * levels


def write(folder: Path, world: str = GEOM, asset: str = "", head: str = "", name: str = "model.xml") -> Path:
    path = folder / name
    path.write_text(f"<mujoco>{head}<asset>{asset}</asset><worldbody>{world}</worldbody></mujoco>")
    return path


BOMBS = {
    "one": {"world": nested(1, 100_000_000)},
    "six": {"world": nested(6, 30)},
    "composite": {"world": '<body><composite type="cable" count="90000000 1 1" size="1"/></body>'},
    "flex": {"world": '<flexcomp name="f" type="grid" count="4000 4000 4000" dim="3"/>'},
    "texture": {"asset": '<texture name="t" type="2d" builtin="checker" width="100000" height="100000"/>'},
    "field": {"asset": '<hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/>'},
    "text in a comment": {"world": f"<!-- a -- b -->{nested(5, 100)}"},
    "not a number": {"world": f'<replicate count="1e9">{GEOM}</replicate>'},
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_what_grows_is_counted_before(bomb: str, tmp_path: Path) -> None:
    path = write(tmp_path, **BOMBS[bomb])
    began = time.process_time()
    with pytest.raises(GapError, match="too large"):
        check_mjcf(path, tmp_path, GapError)
    assert time.process_time() - began < 1.0


def test_a_bomb_in_pieces(tmp_path: Path) -> None:
    """Files that include each other, each of them small."""
    write(tmp_path, world=nested(2, 100), name="inner.xml")
    (tmp_path / "outer.xml").write_text(
        f'<mujoco><worldbody><replicate count="100"><include file="inner.xml"/></replicate>{GEOM}</worldbody></mujoco>'
    )
    with pytest.raises(RealsimError, match="too large"):
        check_mjcf(tmp_path / "outer.xml", tmp_path)
    (tmp_path / "circle.xml").write_text('<mujoco><include file="circle.xml"/></mujoco>')
    with pytest.raises(RealsimError, match="include each other"):
        check_mjcf(tmp_path / "circle.xml", tmp_path)


def test_what_is_usual_passes(tmp_path: Path) -> None:
    texture = '<texture name="t" type="2d" builtin="checker" width="512" height="512"/>'
    path = write(tmp_path, world=f"<!-- feet -- and hands -->{nested(2, 20)}", asset=texture)
    assert check_mjcf(path, tmp_path) == path.read_text()
    urdf = tmp_path / "robot.urdf"
    urdf.write_text('<robot name="r"><link name="a"/><gazebo><plugin name="p" filename="lib.so"/></gazebo></robot>')
    check_mjcf(urdf)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<mujoco>",
        "<" * 100_000,
        "<a>" * 100_000,
        "<a>" * 30_000 + "</a>" * 30_000,
        "\0",
        "<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>",
    ],
)
def test_what_is_no_xml_is_an_error(text: str, tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(text)
    with pytest.raises(RealsimError, match="not plain XML"):
        check_mjcf(tmp_path / "model.xml", tmp_path)


@pytest.mark.parametrize("name", ["/etc/passwd", "../out/box.stl", "a/../../out/box.stl", "link.stl", "door/box.stl"])
@pytest.mark.parametrize("meshdir", ["", "meshes", "."])
@pytest.mark.parametrize("how", ["meshdir", "assetdir"])
def test_names_stay_in_the_folder(name: str, meshdir: str, how: str, tmp_path: Path) -> None:
    """Also through links in the folder of the meshes."""
    case, out = tmp_path / "case", tmp_path / "out"
    for folder in (case / "meshes", out):
        folder.mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(out / "box.stl")
    for folder in (case, case / "meshes"):
        (folder / "link.stl").symlink_to(out / "box.stl")
        (folder / "door").symlink_to(out)
    if meshdir == "meshes" and ".." in name:
        name = f"../{name}"
    head = f'<compiler {how}="{meshdir}"/>' if meshdir else ""
    path = write(case, asset=f'<mesh name="m" file="{name}"/>', head=head)
    with pytest.raises(RealsimError, match=r"leads out|absolute path"):
        check_mjcf(path, case)
    check_mjcf(path)  # of a model that somebody names on purpose


def test_meshes_beside_the_model_pass(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "meshes" / "box.stl")
    (tmp_path / "meshes" / "same.stl").symlink_to(tmp_path / "meshes" / "box.stl")
    for name in ("box.stl", "same.stl", "../meshes/box.stl"):
        head = '<compiler meshdir="meshes"/>'
        check_mjcf(write(tmp_path, asset=f'<mesh name="m" file="{name}"/>', head=head), tmp_path)


@pytest.mark.parametrize("case", ["replicate_bomb", "replicate_nested_6GB"])
def test_bombs_that_were_met(case: str, shared: Callable[[str], Path]) -> None:
    began = time.process_time()
    with pytest.raises(GapError, match="too large"):
        load_case(shared(f"cases/broken/{case}"))
    assert time.process_time() - began < 5.0
