"""From a capture on disk and a model in a file to a metric scene, and the sources of points side by side."""

import json
from pathlib import Path

import numpy as np
import pytest

from realsim import capture
from realsim.capture.config import CaptureConfig
from realsim.cli.command_line import main
from realsim.core.types import Reconstruction
from realsim.export.config import SceneConfig
from realsim.feedforward import onnx as onnx_backend
from realsim.feedforward.config import OnnxConfig, PointsConfig
from realsim.feedforward.onnx.preprocess import make_grid, to_tensor
from realsim.feedforward.onnx.spec import Port, Spec
from realsim.meshing.config import MeshConfig
from realsim.pipeline import ReconstructConfig, reconstruct
from realsim.synth.capture import SynthCapture, write_capture
from realsim.synth.config import SynthConfig
from realsim.synth.errors import compare
from realsim.synth.render import Renderer
from realsim.synth.terrain import make_terrain

pytest.importorskip("onnx", reason="models for these tests are made with onnx (extra dev)")
from tests.truths.simulated_model import Answers, Shape, write_model

CAPTURE = SynthConfig("boxes", 9, depth_scale=1.006, seed=3, width=320)
UNIT = 0.31
SIZE = (238, 322)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SynthCapture:
    return write_capture(tmp_path_factory.mktemp("synth") / "a", CAPTURE)


@pytest.fixture(scope="module")
def model(made: SynthCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that knows this capture: true shape and poses in an arbitrary unit, and a wrong claim of metres."""
    frames = capture.read(made.capture, CaptureConfig()).frames
    spec = Spec("pointmap", Port("images", (1, "N", 3, *SIZE), ""), {}, fixed_hw=SIZE)
    grid = make_grid(frames[0].intrinsics, spec)
    truth = json.loads((made.truth / "truth.json").read_text())
    poses = np.array(truth["T_sim_camera"])
    renderer = Renderer(make_terrain(CAPTURE.terrain, CAPTURE.seed).solids, grid.camera, 0)
    depth = np.stack([renderer.depth(T) for T in poses]).astype(float)
    conf = np.where(depth < 6, 0.9, 0.05)
    poses[:, :3, 3] *= UNIT
    pictures = [to_tensor(f.color(), grid, "identity") for f in frames]
    means = np.stack([p.mean((1, 2)) for p in pictures])
    K = np.tile(grid.camera.K, (len(frames), 1, 1))
    told = Answers(means, UNIT * np.minimum(depth, 20), K, poses, conf, metric_scale=1.3 / UNIT)
    return write_model(tmp_path_factory.mktemp("model") / "m.onnx", told, Shape("pointmap", scale="factor"))


@pytest.fixture(scope="module")
def scene(made: SynthCapture, model: Path, tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    config = ReconstructConfig(
        points=PointsConfig(backend="onnx", onnx=OnnxConfig(model=model)),
        mesh=MeshConfig(resolution=0.04),
        scene=SceneConfig(contact="hfield", contact_probes=100),
        compare=True,
        cache=tmp_path_factory.mktemp("cache"),
    )
    return reconstruct(made.capture, tmp_path_factory.mktemp("out") / "scene", config)


@pytest.mark.slow  # three meshes of a capture, each with poses of its own: half a minute
def test_the_paper_s_way_gives_a_metric_scene(scene: Reconstruction, made: SynthCapture) -> None:
    estimate = scene.aligned.metric.scale
    assert abs(estimate.value * UNIT / CAPTURE.depth_scale - 1) < 0.003
    assert estimate.ci90[0] < 1 / UNIT < estimate.ci90[1]  # the sensor's own 0.6 percent is within what is said
    errors = compare(scene.scene.folder, made.truth)
    assert abs(errors["scale_error"] - 0.006) < 0.003  # which no method without metric poses can see
    assert errors["tilt_deg"] < 0.5
    assert errors["f_score_2cm"] > 0.9
    assert scene.points.backend == "onnx"
    assert any("claims" in w and "+29 percent" in w for w in scene.warnings)


@pytest.mark.slow
def test_the_report_compares_the_sources_of_points(scene: Reconstruction) -> None:
    report = json.loads((scene.scene.folder / "report.json").read_text())
    assert [m["backend"] for m in report["modes"]] == ["onnx", "onnx+depth", "rgbd"]
    assert all(m["error"] is None for m in report["modes"])
    assert report["modes"][0]["apart_m"] is None
    for mode in report["modes"][1:]:
        assert mode["apart_m"] < 0.02
        assert mode["used"] >= 8
    assert report["points"]["metric_claim"] == pytest.approx(1.3 / UNIT, rel=1e-3)
    assert report["points"]["statistics"]["contract"]["kind"] == ["pointmap", "metadata"]
    assert report["points"]["statistics"]["provider"] == "cpu"
    assert "Sources of points compared" in (scene.scene.folder / "report.html").read_text()


def test_an_installation_without_the_model_that_ships(
    made: SynthCapture, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnx_backend, "SHIPPED", made.capture / "gone.onnx")
    assert main(["reconstruct", str(made.capture), "--out", str(tmp_path / "s"), "--backend", "onnx"]) == 2
    assert "--model" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
