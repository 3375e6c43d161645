"""A network in two parts computes what it computes whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from realsim.core.onnx_file import open_network, open_parts

POLICIES = sorted((Path(__file__).parents[2] / "trainer" / "policies").glob("*.onnx"))


@pytest.mark.parametrize("path", POLICIES, ids=lambda p: p.stem)
def test_what_the_images_alone_decide_is_computed_apart(path: Path) -> None:
    whole, (head, tail) = open_network(path), open_parts(path, "depth")
    rng = np.random.default_rng(0)
    vector, depth = (rng.uniform(size=(5, *i.shape[1:])).astype(np.float32) for i in whole.get_inputs())
    seen = head.run(None, {"depth": depth})
    names = [i.name for i in tail.get_inputs()]
    assert names[0] == "vector"
    assert "depth" not in names
    found = tail.run(None, dict(zip(names, [vector, *seen], strict=True)))[0]
    assert found == pytest.approx(whole.run(None, {"vector": vector, "depth": depth})[0], abs=1e-5)


def test_a_network_that_mixes_its_inputs_at_once_stays_whole(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")
    from onnx import TensorProto, helper

    a, b, out = (helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("a", "b", "out"))
    graph = helper.make_graph([helper.make_node("Add", ["a", "b"], ["out"])], "sum", [a, b], [out])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(tmp_path / "sum.onnx"))
    head, tail = open_parts(tmp_path / "sum.onnx", "b")
    assert head is None
    assert [i.name for i in tail.get_inputs()] == ["a", "b"]


def test_an_integer_where_a_node_has_texts_is_passed_over_as_onnxruntime_does(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")
    model = onnx.load(str(POLICIES[0]))
    node = model.graph.node[0].SerializeToString()
    damaged = onnx.NodeProto.FromString(node + b"\x28\x01\x08\x01")  # fields 5 (attributes) and 1 (inputs) as integers
    model.graph.node[0].CopyFrom(damaged)
    onnx.save(model, str(tmp_path / "odd.onnx"))
    head, tail = open_parts(tmp_path / "odd.onnx", "depth")
    assert head is not None
    assert "depth" not in [i.name for i in tail.get_inputs()]
