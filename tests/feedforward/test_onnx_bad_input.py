"""What is wrong with a model is said: the file, what was expected, what was found, what to do. Never a traceback."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rooms
from analytic import UNIT, answers, room_frame, run

from realsim import feedforward, scale
from realsim.cli.command_line import main
from realsim.core.errors import CaptureError, ModelError, PoseError, RealsimError
from realsim.core.types import Frame, FrameSet
from realsim.feedforward import onnx as onnx_backend
from realsim.feedforward.config import OnnxConfig, PointsConfig
from realsim.feedforward.onnx import session
from realsim.feedforward.onnx.inspect import inspect_model
from realsim.feedforward.onnx.session import Model, OutOfMemory, open_model
from realsim.scale.config import ScaleConfig
from tests.truths.simulated_model import Shape, write_model

onnx: Any = pytest.importorskip("onnx", reason="models for these tests are made with onnx (extra dev)")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [room_frame(k, T) for k, T in enumerate(rooms.path(4, 0.15))]


@pytest.fixture
def good(frames: list[Frame], tmp_path: Path) -> Path:
    return write_model(tmp_path / "good.onnx", answers(frames, rooms.path(4, 0.15), Shape()), Shape())


def changed(path: Path, change: Callable[[Any], None]) -> Path:
    """The model with something done to it."""
    model = onnx.load(path)
    change(model)
    target = path.with_name("changed.onnx")
    onnx.save(model, target)
    return target


def message(error: pytest.ExceptionInfo[RealsimError]) -> str:
    assert error.value.file is not None or error.value.expected is not None
    return str(error.value)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "empty"),
        (b"hello, world\n" * 20, "not an ONNX file"),
        (b"PK\x03\x04" + bytes(100), "torch checkpoint"),
        (bytes(range(256)), "not an ONNX file"),
        (bytes(5_000_000), "not an ONNX file"),
    ],
)
def test_not_an_onnx_file(tmp_path: Path, content: bytes, found: str) -> None:
    (tmp_path / "x.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=found):
        open_model(tmp_path / "x.onnx")


def test_an_absent_file_and_a_cut_one(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model", "inspect", str(good), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fits"]
    assert main(["model", "inspect", str(good.with_name("absent.onnx"))]) == 2
    assert "absent.onnx" in capsys.readouterr().err
    cut = good.with_name("cut.onnx")
    cut.write_bytes(good.read_bytes()[:2000])
    assert main(["model", "inspect", str(cut)]) == 2
    assert "not an ONNX file" in capsys.readouterr().err


def test_no_model_given_and_none_installed(
    frames: list[Frame], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert feedforward.inputs(PointsConfig(backend="onnx")) == (onnx_backend.SHIPPED,)
    monkeypatch.setattr(onnx_backend, "SHIPPED", tmp_path / "gone.onnx")
    with pytest.raises(ModelError, match=r"--model"):
        feedforward.inputs(PointsConfig(backend="onnx"))
    with pytest.raises(ModelError, match=r"--model"):
        feedforward.solve(FrameSet(tuple(frames), Path("room"), "test"), PointsConfig(backend="onnx+depth"))


def test_wrong_inputs(good: Path) -> None:
    def rename(model: Any) -> None:
        model.graph.input[0].name = "pixels"
        model.graph.node[0].input[0] = "pixels"

    with pytest.raises(ModelError, match="no input for images") as error:
        open_model(changed(good, rename))
    assert "pixels float[1, N, 3, 84, 112]" in message(error)

    def more(model: Any) -> None:
        model.graph.input.append(onnx.helper.make_tensor_value_info("prompt", onnx.TensorProto.FLOAT, [1]))

    with pytest.raises(ModelError, match=r"does not know[\s\S]*prompt"):
        open_model(changed(good, more))


def test_wrong_outputs_name_the_closest_kind(good: Path) -> None:
    def rename(model: Any) -> None:
        del model.metadata_props[:]
        model.graph.node.append(onnx.helper.make_node("Identity", ["camera_poses"], ["whereabouts"]))
        model.graph.output[0].name = "whereabouts"

    with pytest.raises(ModelError, match="do not fit the contract") as error:
        open_model(changed(good, rename))
    assert "closest is the kind pointmap, which lacks pose" in message(error)
    assert "whereabouts" in message(error)
    with pytest.raises(ModelError, match=r"do not make a model of kind depth[\s\S]*depth_z"):
        open_model(changed(good, lambda m: onnx.helper.set_model_props(m, {"kind": "depth"})))


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("kind", "nerf", "did you mean|one of depth"),
        ("conf", "sigmoid", "exp1, log_error"),
        ("patch", "many", "whole number"),
        ("fixed_hw", "518", "height and width"),
        ("fixed_hw", "518,518", "contradicts itself"),
        ("pose", "euler", "c2w, pose_enc9"),
    ],
)
def test_metadata_that_the_contract_does_not_know(good: Path, key: str, value: str, text: str) -> None:
    def say(model: Any) -> None:
        for entry in model.metadata_props:
            if entry.key == key:
                entry.value = value

    with pytest.raises(RealsimError, match=text):
        open_model(changed(good, say))


def test_a_sidecar_speaks_for_a_file_without_metadata_and_guesses_are_told(good: Path) -> None:
    silent = changed(good, lambda m: m.ClearField("metadata_props"))
    guessed = open_model(silent)
    assert guessed.spec.kind == "pointmap"
    assert "kind pointmap" in guessed.warnings[0]
    assert "conf logit" in guessed.warnings[0]
    silent.with_suffix(".json").write_text('{"kind": "pointmap", "conf": "exp1", "norm": "half", "max_views": 7}')
    spec = open_model(silent).spec
    assert (spec.conf, spec.norm, spec.max_views, spec.origin["conf"]) == ("exp1", "half", 7, "sidecar")
    silent.with_suffix(".json").write_text("[1]")
    with pytest.raises(ModelError, match="sidecar"):
        open_model(silent)


def test_a_confidence_that_is_not_what_was_said(good: Path, frames: list[Frame]) -> None:
    def say(model: Any) -> None:
        next(e for e in model.metadata_props if e.key == "conf").value = "exp1"

    with pytest.raises(ModelError, match=r"numbers of 1 and more[\s\S]*logit"):
        run(frames, changed(good, lambda m: (say(m), _negate(m, "conf"))))


def _negate(model: Any, output: str) -> None:
    """The output with its sign turned."""
    for node in model.graph.node:
        node.output[:] = [f"{output}_plain" if name == output else name for name in node.output]
    model.graph.node.append(onnx.helper.make_node("Neg", [f"{output}_plain"], [output]))


def test_poses_that_are_no_rotations(frames: list[Frame], tmp_path: Path) -> None:
    told = answers(frames, rooms.path(4, 0.15), Shape())
    T = told.T_world_camera.copy()
    T[2, :3, :3] *= 1.5
    model = write_model(tmp_path / "m.onnx", replace(told, T_world_camera=T), Shape())
    with pytest.raises(ModelError, match=r"not rigid[\s\S]*pose_enc9"):
        run(frames, model)


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_a_focal_length_that_is_far_off_is_an_error(frames: list[Frame], tmp_path: Path, factor: float) -> None:
    said = answers(frames, rooms.path(4, 0.15), Shape())
    K = said.K.copy()
    K[:, :2, :2] *= factor
    path = write_model(tmp_path / "m.onnx", replace(said, K=K), Shape())
    with pytest.raises(ModelError, match="do not fit the camera") as error:
        run(frames, path)
    assert f"{factor:g} times" in message(error)


def test_axes_that_are_declared_dynamic_and_are_not(good: Path, frames: list[Frame]) -> None:
    """Frozen at two views inside: with another number onnxruntime refuses, or too few come out."""

    def freeze(model: Any) -> None:
        two = onnx.numpy_helper.from_array(np.int64([0, 1]), "two")
        model.graph.initializer.append(two)
        for node in model.graph.node:
            node.input[:] = ["id_two" if name == "id" else name for name in node.input]
        at = next(k for k, n in enumerate(model.graph.node) if n.output[0] == "id") + 1
        model.graph.node.insert(at, onnx.helper.make_node("Gather", ["id", "two"], ["id_two"]))

    lying = changed(good, freeze)
    with pytest.raises(ModelError, match=r"wrong shape[\s\S]*4 views[\s\S]*n_static"):
        run(frames, lying)
    found = inspect_model(lying)
    assert found.fits  # two views do run
    assert [t.seconds is not None for t in found.trials[:3]] == [False, True, False]
    assert "FAILS" in found.render()
    lying.with_suffix(".json").write_text('{"n_static": 2}')
    assert len(run(frames[:2], lying)) == 2


def test_external_weights(good: Path, frames: list[Frame]) -> None:
    target = good.with_name("split.onnx")
    onnx.save(onnx.load(good), target, save_as_external_data=True, location="split.data", size_threshold=1000)
    assert len(run(frames, target)) == 4
    assert [p.name for p in open_model(target).envelope.files] == ["split.onnx", "split.data"]
    (good.parent / "split.data").rename(good.parent / "elsewhere.data")
    with pytest.raises(ModelError, match=r"absent[\s\S]*split\.data"):
        open_model(target)


def test_external_weights_may_not_lie_outside(good: Path) -> None:
    def lead_out(model: Any) -> None:
        tensor = model.graph.initializer[0]
        tensor.data_location = onnx.TensorProto.EXTERNAL
        tensor.ClearField("raw_data")
        tensor.external_data.add(key="location", value="../../etc/passwd")

    with pytest.raises(RealsimError, match="leads out of its folder"):
        open_model(changed(good, lead_out))


def test_cut_external_weights(good: Path) -> None:
    target = good.with_name("split.onnx")
    onnx.save(onnx.load(good), target, save_as_external_data=True, location="split.data", size_threshold=1000)
    data = good.parent / "split.data"
    data.write_bytes(data.read_bytes()[:1000])
    with pytest.raises(ModelError, match="incomplete"):
        open_model(target)


def test_opset_and_format_from_the_future(good: Path) -> None:
    with pytest.raises(ModelError, match=r"newer than[\s\S]*opset 99[\s\S]*update onnxruntime"):
        open_model(changed(good, lambda m: setattr(m.opset_import[0], "version", 99)))
    with pytest.raises(ModelError, match=r"newer than[\s\S]*IR version 99"):
        open_model(changed(good, lambda m: setattr(m, "ir_version", 99)))


def test_a_provider_that_is_not_there(good: Path) -> None:
    assert open_model(good, "cpu").provider == open_model(good, "CPUExecutionProvider").provider == "cpu"
    with pytest.raises(ModelError, match=r"warp9 is not there[\s\S]*cpu"):
        open_model(good, "warp9")


def test_one_view_only(frames: list[Frame], good: Path, tmp_path: Path) -> None:
    maps = run(frames[:1], good)
    assert len(maps) == 1
    assert any("one view only" in w for w in maps.warnings)
    pair = write_model(tmp_path / "p.onnx", answers(frames, rooms.path(4, 0.15), Shape("pair")), Shape("pair"))
    with pytest.raises(CaptureError, match="one view only"):
        run(frames[:1], pair)


def test_frames_without_colour(frames: list[Frame], good: Path) -> None:
    with pytest.raises(CaptureError, match=r"needs colour[\s\S]*rgbd"):
        run([replace(f, read_color=None) for f in frames], good)


def and_elsewhere(frames: Sequence[Frame]) -> list[Frame]:
    """The frames, and two darker ones."""
    other = [replace(room_frame(k, T), name=f"other{k}") for k, T in enumerate(rooms.path(2, 0.15))]
    return [*frames, *(replace(f, read_color=darker(f)) for f in other)]


def darker(frame: Frame) -> Callable[[], Any]:
    color = frame.color()
    assert color is not None
    return lambda: (color // 3).astype(np.uint8)


def test_views_without_overlap_are_left_out_and_said(frames: list[Frame], tmp_path: Path) -> None:
    both = and_elsewhere(frames)
    told = answers(frames, rooms.path(4, 0.15), Shape())
    more = answers(both[4:], rooms.path(2, 0.15), Shape())
    T = np.concatenate([told.T_world_camera, more.T_world_camera])
    T[4:, 0, 3] += 40 * UNIT
    parts = {k: np.concatenate([getattr(told, k), getattr(more, k)]) for k in ("signatures", "depth", "K", "conf")}
    model = write_model(tmp_path / "m.onnx", replace(told, **parts, T_world_camera=T), Shape())
    maps = run(both, model)
    assert [f.name for f in maps.frames] == ["000", "001", "002", "003"]
    assert [d.name for d in maps.dropped] == ["other0", "other1"]
    assert "not glued" in maps.dropped[0].reason
    apart = told.T_world_camera.copy()
    apart[:, 0, 3] += 50 * np.arange(4)
    lone = write_model(tmp_path / "l.onnx", replace(told, T_world_camera=apart), Shape())
    with pytest.raises(PoseError, match="cannot be connected"):
        run(frames, lone)


def test_windows_that_do_not_agree_are_not_glued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = rooms.path(12, 0.08)
    many = [room_frame(k, T) for k, T in enumerate(poses)]
    model = write_model(tmp_path / "m.onnx", answers(many, poses, Shape()), Shape(max_views=7))
    rng, plain = np.random.default_rng(0), Model.run

    def garbled(self: Model, feeds: Any) -> Any:
        """The second window sees other shapes than the first."""
        out = plain(self, feeds)
        if garbled.calls:
            out["local_points"] = out["local_points"] * rng.uniform(0.3, 3, (*out["local_points"].shape[:-1], 1))
        garbled.calls += 1
        return out

    garbled.calls = 0
    monkeypatch.setattr(Model, "run", garbled)
    maps = run(many, model)
    assert [f.name for f in maps.frames] == [f"{k:03d}" for k in range(7)]
    assert len(maps.dropped) == 5


def test_nan_in_one_view_and_in_all(frames: list[Frame], tmp_path: Path) -> None:
    told = answers(frames, rooms.path(4, 0.15), Shape())
    depth, T = told.depth.copy(), told.T_world_camera.copy()
    depth[3, :70] = np.nan
    T[0, 1, 1] = np.nan
    maps = run(frames, write_model(tmp_path / "m.onnx", replace(told, depth=depth, T_world_camera=T), Shape()))
    assert {d.name: "NaN" in d.reason for d in maps.dropped} == {"000": True, "003": True}
    assert len(maps) == 2
    with pytest.raises(ModelError, match=r"no usable points[\s\S]*NaN"):
        run(frames, write_model(tmp_path / "n.onnx", replace(told, depth=depth * np.nan), Shape()))


def test_out_of_memory_is_retried_with_fewer_views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = rooms.path(12, 0.08)
    many = [room_frame(k, T) for k, T in enumerate(poses)]
    model = write_model(tmp_path / "m.onnx", answers(many, poses, Shape()), Shape())
    plain = Model.run
    limit = 7

    def tight(self: Model, feeds: Any) -> Any:
        if feeds["images"].shape[1] > limit:
            raise OutOfMemory("BFCArena: Failed to allocate memory")
        return plain(self, feeds)

    monkeypatch.setattr(Model, "run", tight)
    maps = run(many, model)
    assert len(maps) == 12
    assert "out of memory with 12 views per run: repeated with 6" in maps.warnings
    limit = 1
    with pytest.raises(ModelError, match=r"does not fit into memory[\s\S]*smaller"):
        run(many, model)


def test_onnxruntimes_own_word_for_out_of_memory(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def run(self, *_: object) -> None:
            raise RuntimeError(
                "[ONNXRuntimeError] : 6 : RUNTIME_EXCEPTION : Failed to allocate memory for buffer of 9 GB"
            )

    model = replace(open_model(good), session=Full())
    with pytest.raises(OutOfMemory):
        model.run({"images": np.zeros((1, 2, 3, 84, 112), np.float32)})


@pytest.mark.parametrize("claimed", [1.3, 1.02])
def test_a_claim_of_metres_that_the_sensor_contradicts(frames: list[Frame], tmp_path: Path, claimed: float) -> None:
    shape = Shape(scale="factor")
    told = replace(answers(frames, rooms.path(4, 0.15), shape), metric_scale=claimed / UNIT)
    maps = run(frames, write_model(tmp_path / "m.onnx", told, shape))
    assert maps.metric_claim is not None
    assert abs(maps.metric_claim * UNIT - claimed) < 1e-5
    metric = scale.to_metric(maps, ScaleConfig())
    assert abs(metric.scale.value * UNIT - 1) < 2e-3  # the claim is recorded, the sensor is believed
    assert any("claims" in w and "+30 percent" in w for w in metric.scale.warnings) == (claimed > 1.1)


def test_outputs_are_kept_by_content_of_model_and_pictures(
    frames: list[Frame], good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    plain = Model.run
    monkeypatch.setattr(Model, "run", lambda self, feeds: (calls.append(1), plain(self, feeds))[1])
    kept = tmp_path / "kept"
    first = run(frames, good, kept_in=kept)
    again = run(frames, good, kept_in=kept, min_confidence=0.3)
    assert len(calls) == 1
    np.testing.assert_array_equal(first.T_world_camera, again.T_world_camera)
    run(frames[:3], good, kept_in=kept)
    run(frames, changed(good, lambda m: setattr(m, "producer_name", "other")), kept_in=kept)
    assert len(calls) == 3
    for entry in kept.iterdir():
        entry.write_bytes(b"broken")
    run(frames, good, kept_in=kept)
    assert len(calls) == 4


SCRIPT = """
import sys
from pathlib import Path
from realsim.feedforward.onnx.inspect import inspect_model
print(inspect_model(Path(sys.argv[1])).fits)
assert "torch" not in sys.modules and "onnx" not in sys.modules, "a torch-free run imported it"
"""


def test_nothing_is_written_by_telemetry_and_torch_is_not_imported(good: Path, tmp_path: Path) -> None:
    """onnxruntime leaves a device id and a data base in the user's cache folder, unless it is told not to."""
    home = tmp_path / "home"
    home.mkdir()
    places = dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"), str(home))
    environment = {**os.environ, **places, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(good)],
        cwd=home,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.strip() == "True", done.stderr
    assert list(home.rglob("*")) == []


def test_the_runtime_is_imported_with_telemetry_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORT_DISABLE_TELEMETRY", "0")
    session.runtime()
    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"


def test_settings_are_checked() -> None:
    for wrong in ({"min_confidence": 1.0}, {"drop_least_sure": 100.0}, {"max_views": 0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            OnnxConfig(**wrong)
