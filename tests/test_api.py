"""`import realsim as rs`: light, typed, text or Path, results that show themselves."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

import realsim as rs
from realsim.core.rays import heights
from tests.gap.truth import ARM, Truth, make_case
from tests.truths.solids import terrain

HEAVY = ("numpy", "scipy", "mujoco", "tyro", "rich", "open3d", "cv2", "torch", "trimesh")


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> rs.Scene:
    folder = tmp_path_factory.mktemp("api")
    mesh = terrain("stairs")
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(folder / "stairs.stl")
    config = rs.SceneConfig(contact_probes=200)
    return rs.contact(str(folder / "stairs.stl"), str(folder / "scene"), config)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("api") / "case"
    make_case(folder, ARM, Truth(), runs=3, seed=1, span=(1.0, 1.2))
    return folder


def test_the_import_loads_nothing_heavy() -> None:
    done = run(f"import realsim, sys; print([m for m in {HEAVY!r} if m in sys.modules])")
    assert done.stdout.strip() == "[]", done.stderr


def test_a_scene_that_was_edited_is_said(scene: rs.Scene, tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    shutil.copytree(scene.folder, folder)
    (folder / "mine.txt").write_text("came later")
    assert rs.load_scene(folder).edited == rs.export(folder, "obj", tmp_path / "out").edited == ()
    text = (folder / "scene.xml").read_text()
    (folder / "scene.xml").write_text(text.replace("</mujoco>", "<!-- higher --></mujoco>"))
    edited = rs.load_scene(folder)
    assert edited.edited == ("scene.xml",)
    assert any(w.startswith("scene.xml: changed since") for w in edited.warnings)
    written = rs.export(folder, "obj", tmp_path / "edited")
    assert written.edited == ("scene.xml",)
    assert json.loads((tmp_path / "edited" / "obj" / "export.json").read_text())["edited"] == ["scene.xml"]
    (folder / "scene.xml").write_text(text)
    (folder / "mesh.glb").unlink()
    assert rs.load_scene(folder).edited == ("mesh.glb",)


def test_every_name_is_there_and_no_module_takes_its_place() -> None:
    """A module that is imported later becomes an attribute of its package: none may have a function's name."""
    done = run(
        "import realsim as rs, realsim.export.formats, realsim.capture, realsim.gap, realsim.pipeline, types\n"
        "assert set(rs.__all__) <= set(dir(rs))\n"
        "print([n for n in rs.__all__ if isinstance(getattr(rs, n), types.ModuleType)])"
    )
    assert done.stdout.strip() == "[]", done.stderr
    with pytest.raises(AttributeError, match="no attribute 'reconstuct'"):
        rs.reconstuct  # noqa: B018


def test_a_scene_is_the_same_from_a_run_and_from_disk(scene: rs.Scene) -> None:
    again = rs.load_scene(str(scene.folder))
    assert again == scene
    assert again.contact.geoms > 0
    assert again.contact.median_mm < 5
    assert isinstance(again.model(), mujoco.MjModel)
    assert len(again.geometry().triangles) > 0
    assert len(repr(again)) < 200
    shown = again._repr_html_()
    assert "data:image/png;base64," in shown
    assert f"{again.contact.median_mm:.1f} mm median" in shown


def test_a_scene_with_a_report_has_its_verdict(scene: rs.Scene, tmp_path: Path) -> None:
    contact = json.loads((scene.folder / "contact.json").read_text())
    site = {"centroid": [0, 0, 0.1], "size": [1, 0.8, 0.1], "yaw": 0.5}
    report = {
        "contact": contact,
        "verdict": {"level": "bad", "headline": "Do not.", "reasons": ["<b>tilt</b>"], "next": ["walk closer"]},
        "scale": {"value": 1.01, "ci90": [1.0, 1.02]},
        "start": site,
        "goal": None,
        "frames": {"used": ["a", "b"], "dropped": [{"name": "c", "stage": "points", "reason": "blurred"}]},
        "warnings": [],
    }
    (tmp_path / "scene.xml").write_text("<mujoco/>")
    (tmp_path / "report.json").write_text(json.dumps(report))
    found = rs.load_scene(tmp_path)
    assert found.verdict is rs.SceneVerdict.BAD
    assert not found.verdict.usable
    assert found.next_steps == ("walk closer",)
    assert found.start is not None
    assert found.start.yaw == 0.5
    assert found.frames_dropped == {"c": "blurred"}
    assert str(found.scale) == "1.01 [1, 1.02]"
    assert "&lt;b&gt;tilt" in found._repr_html_()


def test_what_is_no_scene_says_so(tmp_path: Path) -> None:
    with pytest.raises(rs.RealsimError, match="not a scene folder"):
        rs.load_scene(tmp_path)
    (tmp_path / "scene.xml").write_text("<mujoco/>")
    (tmp_path / "report.json").write_text('{"contact": {}}')
    with pytest.raises(rs.RealsimError, match="cannot be read"):
        rs.load_scene(tmp_path)


def test_heights_from_above_are_those_of_the_surface() -> None:
    roof = np.array([[[0, 0, 0], [2, 0, 0], [2, 1, 1]], [[0, 0, 0], [2, 1, 1], [0, 1, 1]]], float)
    grid = heights(roof.reshape(-1, 3), np.arange(6).reshape(2, 3), (0, 0), (2, 1), 0.02)
    assert grid.shape == (50, 100)
    np.testing.assert_allclose(grid, np.repeat((np.arange(50)[:, None] + 0.5) * 0.02, 100, axis=1), atol=1e-5)


def test_export_takes_a_scene_or_a_folder_and_keeps_what_is_there(scene: rs.Scene, tmp_path: Path) -> None:
    first = rs.export(scene, ["obj", "mjcf"], str(tmp_path))
    assert all(path.is_file() for files in first.values() for path in files)
    with pytest.raises(rs.RealsimError, match="not empty"):
        rs.export(str(scene.folder), "obj", tmp_path)
    with pytest.raises(rs.RealsimError, match="no format given"):
        rs.export(scene, [], tmp_path)
    assert rs.export(scene.folder, "obj", tmp_path, overwrite=True) == {"obj": first["obj"]}
    (tmp_path / "stl").mkdir()
    (tmp_path / "stl" / "mine.txt").write_text("precious")
    with pytest.raises(rs.RealsimError, match="did not write"):
        rs.export(scene, ["stl"], tmp_path, overwrite=True)
    assert (tmp_path / "stl" / "mine.txt").read_text() == "precious"


def test_all_formats_that_can_be_written(scene: rs.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)  # as if it were not installed
    written = rs.export(scene, out=tmp_path)
    assert set(written.skipped) == {"terrain"}
    assert 'pip install "realsim[recon]"' in written.skipped["terrain"]
    assert {"mjcf", "urdf", "heightmap"} <= set(written)
    assert not (tmp_path / "terrain").exists()
    with pytest.raises(rs.RealsimError, match="manifold3d"):
        rs.export(scene, "terrain", tmp_path)


def test_a_case_by_text_and_a_diagnosis_that_is_written(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(repr(rs.load_case(case))) < 200
    assert len(repr(rs.load_case(case).runs[0])) < 200
    assert rs.load_case(str(case)).joint_names == rs.load_case(case).joint_names
    config = rs.DiagnoseConfig(effects=("viscous_friction",), max_causes=1, bootstrap=20, report=False)
    seen: list[float] = []
    found = rs.diagnose(str(case), tmp_path / "out", config, progress=lambda what, share: seen.append(share))
    assert seen
    assert isinstance(found.verdict, rs.GapVerdict)
    assert rs.load_diagnosis(str(tmp_path / "out")) == found
    shown = rs.load_case(case)._repr_html_()
    assert shown.count("<polyline") == len(rs.load_case(case).joint_names)
    assert "nan" not in shown
    assert rs.diagnose(rs.load_case(case), config=config).verdict is found.verdict
    spec = mujoco.MjSpec.from_string(ARM)
    rs.apply_patch(spec, found)
    spec.compile()
    assert found.sentence.split()[0] in found._repr_html_()


def made_diagnosis() -> dict[str, object]:
    parameter = {"value": 0.25, "unit": "N m", "ci90": [0.2, 0.3]}
    cause = {"effect": "coulomb_friction", "joints": ["elbow"], "parameters": {"friction": parameter}}
    return {
        "verdict": "identified", "sentence": "elbow: <friction>", "causes": [cause], "equivalent": [[cause]],
        "where": [{"signal": "joint_pos", "joint": "elbow", "phase": "slow", "share": 0.5}],
        "shrinkage": {"fraction": 0.9, "ci90": [None, 0.95], "runs": ["5"], "unseen": True},
        "unexplained_share": 0.1, "patch": {}, "health": {"warnings": ["late"]},
    }  # fmt: skip


def test_a_diagnosis_shows_itself_in_one_line_and_in_a_notebook() -> None:
    from realsim.results import Diagnosis

    found = Diagnosis.of(made_diagnosis())
    assert repr(found) == "Diagnosis(identified, causes: coulomb_friction at elbow: friction 0.25 [0.2, 0.3] N m)"
    assert np.isnan(found.shrinkage.low)
    shown = found._repr_html_()
    assert "<svg" in shown
    assert "&lt;friction&gt;" in shown
    with pytest.raises(rs.RealsimError, match="not a diagnosis"):
        Diagnosis.of({**made_diagnosis(), "verdict": "certain"})
    with pytest.raises(rs.RealsimError, match="verdict identified, but no cause"):
        Diagnosis.of({**made_diagnosis(), "causes": []})
    assert Diagnosis.of({**made_diagnosis(), "verdict": "no_gap", "causes": []}).causes == ()


@pytest.mark.parametrize("change", [{"scales": None}, {"settings": [3]}, {"settings": "x"}])
def test_a_damaged_patch_is_refused(change: dict[str, object]) -> None:
    import mujoco

    spec = mujoco.MjSpec.from_string("<mujoco><worldbody/></mujoco>")
    setting = {"effect": "viscous_friction", "place": ["swing"], "coordinates": {"added": 0.1}}
    patch = {"format": "realsim.gap.patch/2", "settings": [setting], "scales": {"torque_range": {}}}
    with pytest.raises(rs.RealsimError, match="patch"):
        rs.apply_patch(spec, patch | change)


CORE_ONLY = """
import sys
from importlib.machinery import PathFinder
from realsim.core.errors import EXTRA_OF

search = PathFinder.find_spec
PathFinder.find_spec = lambda name, *rest: None if name.partition(".")[0] in EXTRA_OF else search(name, *rest)
"""


@pytest.fixture
def bare() -> Callable[[str], subprocess.CompletedProcess[str]]:
    """Runs Python as where nothing but the core is installed."""
    return lambda code: run(CORE_ONLY + code)


OF_EXTRAS = {
    "inspect nowhere": "recon",
    "reconstruct nowhere": "recon",
    "contact nowhere.stl": "recon",
    "synth": "recon",
    "demo": "recon",
    "model inspect nowhere.onnx": "recon",
    "view nowhere": "viewer",
    "play flat --policy nowhere.pt": "train",
}


def test_what_needs_an_extra_says_how_to_install_it(bare: Callable[[str], subprocess.CompletedProcess[str]]) -> None:
    done = bare(
        f"""
import contextlib, io
from realsim.cli.command_line import main
for command, extra in {OF_EXTRAS!r}.items():
    with contextlib.redirect_stderr(io.StringIO()) as said:
        assert main(command.split()) == 2, command
    assert f'pip install "realsim[{{extra}}]"' in said.getvalue(), said.getvalue()
"""
    )
    assert done.returncode == 0, done.stderr


def test_diagnosis_and_scenes_need_the_core_alone(
    bare: Callable[[str], subprocess.CompletedProcess[str]], case: Path, scene: rs.Scene, tmp_path: Path
) -> None:
    done = bare(
        f"""
import realsim as rs
from realsim.cli.command_line import main
config = rs.DiagnoseConfig(effects=("viscous_friction",), max_causes=1, bootstrap=20)
found = rs.diagnose({str(case)!r}, {str(tmp_path / "out")!r}, config)
assert found.page is not None
scene = rs.load_scene({str(scene.folder)!r})
assert "<img" in scene._repr_html_()
assert scene.geometry().boxes or scene.geometry().convex
written = rs.export(scene, out={str(tmp_path / "formats")!r})
print(sorted(written.skipped))
assert main(["--help"]) == 0 and main(["export", "--help"]) == 0
"""
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "['heightmap', 'terrain', 'usd']"
