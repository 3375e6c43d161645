"""The main job end to end on a small rendered capture: right, repeatable, interruptible, and honest about its input."""

import contextlib
import io
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realsim.synth.capture  # noqa: F401  (its annotations name a class that is patched below)
from realsim import pipeline
from realsim.cli.command_line import main
from realsim.core.errors import RealsimError
from realsim.export.config import SceneConfig
from realsim.meshing.config import MeshConfig
from realsim.pipeline import ReconstructConfig, peak_memory_mb, reconstruct
from realsim.synth.config import SynthConfig

FRAMES = 12
SMALL = ("--resolution", "0.03", "--contact-probes", "300", "--robot", "quadruped")


@dataclass(frozen=True)
class Demo:
    """What `realsim demo` wrote and printed."""

    capture: Path
    scene: Path
    said: dict[str, Any]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> ReconstructConfig:
    scene, mesh = SceneConfig(contact_probes=300, robot="quadruped"), MeshConfig(resolution=0.03)
    return ReconstructConfig(cache=tmp_path_factory.mktemp("cache"), scene=scene, mesh=mesh)


@pytest.fixture(scope="module")
def demo(config: ReconstructConfig, tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """In pictures of half the width, from a sensor whose scale is 0.8 percent off."""
    out = tmp_path_factory.mktemp("demo")
    small = partial(ReconstructConfig, mesh=config.mesh, cache=config.cache)
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.setattr(
            sys.modules[SynthConfig.__module__], "SynthConfig", partial(SynthConfig, width=320, depth_scale=1.008)
        )
        patch.setattr(sys.modules[SceneConfig.__module__], "SceneConfig", partial(SceneConfig, contact_probes=300))
        patch.setattr(pipeline, "ReconstructConfig", small)
        options = ["--frames", str(FRAMES), "--with-poses", "--robot", "quadruped"]
        assert main(["demo", "--out", str(out), *options, "--json"]) == 0
    return Demo(out / "frames" / "capture", out / "scene", json.loads(printed.getvalue()))


@pytest.mark.slow
def test_the_scene_is_right(demo: Demo) -> None:
    errors = demo.said["errors"]
    assert errors["scale_error"] < 0.003  # the sensor's own 0.8 percent was recovered from the poses
    assert errors["tilt_deg"] < 0.3
    assert abs(errors["yaw_deg"]) < 0.5
    assert errors["origin_mm"] < 10
    assert errors["f_score_2cm"] > 0.95


def test_the_report_has_what_others_rely_on(demo: Demo) -> None:
    report = json.loads((demo.scene / "report.json").read_text())
    T = np.array(report["T_sim_world"])
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert set(report["scale"]) >= {"value", "ci90", "per_frame_spread", "method"}
    assert report["scale"]["ci90"][0] <= 1 <= report["scale"]["ci90"][1]
    assert set(report["gravity"]) >= {"normal_world", "tilt_sigma_deg", "inlier_rms_m"}
    assert np.allclose(report["start"]["centroid"], 0, atol=1e-6)
    assert report["goal"]["centroid"][0] > 1
    assert abs(report["goal"]["centroid"][1]) < 1e-6
    assert report["frames"]["used"] == FRAMES or len(report["frames"]["used"]) == FRAMES
    assert {s["name"] for s in report["stages"]} >= {"capture", "points", "scale", "align", "mesh", "export"}
    page = (demo.scene / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


def test_a_rerun_reuses_finished_stages_and_writes_the_same_bytes(
    demo: Demo, config: ReconstructConfig, tmp_path: Path
) -> None:
    again = reconstruct(demo.capture, tmp_path / "scene", config)
    assert {s.name for s in again.stages if s.reused} == {"points", "align", "mesh", "export"}
    files = sorted(p.relative_to(demo.scene) for p in demo.scene.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(again.scene.folder) for p in again.scene.folder.rglob("*") if p.is_file())
    for name in files:
        if name.name not in ("report.json", "report.html"):
            assert (demo.scene / name).read_bytes() == (again.scene.folder / name).read_bytes(), name


def test_an_interrupt_leaves_nothing_half_written(
    demo: Demo,
    config: ReconstructConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline.report, "write_report", stop)
    arguments = ["reconstruct", str(demo.capture), "--out", str(tmp_path / "scene"), "--cache", str(config.cache)]
    arguments += SMALL
    assert main(arguments) == 130
    assert list(tmp_path.iterdir()) == []
    assert "nothing half-written is left; finished stages are kept and reused" in capsys.readouterr().err


def test_a_full_disk_is_said_and_leaves_nothing(
    demo: Demo,
    config: ReconstructConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import errno

    from realsim.core import files

    real = files.os.fdopen

    def full(handle: int, mode: str) -> object:
        real(handle, mode).close()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fdopen", full)
    with pytest.raises(RealsimError, match="free some space"):
        reconstruct(demo.capture, tmp_path / "scene", config)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_not_touched(demo: Demo, config: ReconstructConfig, tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "precious").write_text("x")
    with pytest.raises(RealsimError, match="--overwrite"):
        reconstruct(demo.capture, tmp_path / "scene", config)
    assert (tmp_path / "scene" / "precious").read_text() == "x"


def test_a_damaged_frame_is_dropped_named_and_the_rest_goes_on(
    demo: Demo, config: ReconstructConfig, tmp_path: Path
) -> None:
    shutil.copytree(demo.capture, tmp_path / "capture")
    victim = sorted((tmp_path / "capture" / "depth").iterdir())[7]
    victim.write_bytes(victim.read_bytes()[:200])
    read = pipeline.capture.read(tmp_path / "capture", config.capture)
    assert len(read) == FRAMES - 1
    assert [d.name for d in read.dropped] == [victim.stem]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems' figure is getrusage's")
def test_peak_memory_is_this_process_s_own() -> None:
    ballast = np.ones(30_000_000)  # 240 MB, more than the child will need
    code = "from realsim.pipeline import peak_memory_mb; print(peak_memory_mb())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert peak_memory_mb() > ballast.nbytes / 1e6
    assert 5 < float(done.stdout) < ballast.nbytes / 1e6
