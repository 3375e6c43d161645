"""The file that ships, read back as a state of training: its weights are the only ones that are kept.

`export` notes in the file which of its tensors is which parameter of the network, so that

    python -m training.pointmap.train --out run --resume realsim/feedforward/onnx/realsim_pointmap.onnx

goes on from there. As a command it keeps the weights of such a file as a state:

    python -m training.pointmap.shipped pointmap.onnx --out start             for machines without onnx

 Weights that were stored in 8 bits come back rounded; the optimiser's moments are not there.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from realsim.core.errors import RealsimError
from training.pointmap import state as states
from training.pointmap.network import PointmapNet, Shape
from training.pointmap.state import State

KEY = "training"
"""Of the metadata."""
MAX_BYTES = 100 * 2**20


def describe(path: Path, state: State) -> None:
    """Note in a file as torch exported it (before its weights are stored smaller) what `load` needs.

    Exporting renames matrices and transposes them, and folds what is constant: tensors are found by their values, and
    what is not there any more is written down.
    """
    import onnx
    from onnx import numpy_helper

    model = onnx.load(str(path))
    by_value = {}
    for tensor in model.graph.initializer:
        array = numpy_helper.to_array(tensor)
        by_value[array.shape, array.tobytes()] = tensor.name
    where: dict[str, Any] = {}
    for name, parameter in state.net.state_dict().items():
        array = parameter.detach().cpu().numpy()
        turned = np.ascontiguousarray(array.T)
        if found := by_value.get((array.shape, array.tobytes())):
            where[name] = [found, False]
        elif found := by_value.get((turned.shape, turned.tobytes())):
            where[name] = [found, True]
        elif array.size <= 16:
            where[name] = array.tolist()
        else:
            raise RealsimError("a parameter is not in the exported graph", file=path, found=name)
    about = {
        "shape": asdict(state.net.shape), "step": state.step, "views": state.views,
        "minutes": round(state.minutes, 2), "parameters": where,
    }  # fmt: skip
    onnx.helper.set_model_props(model, {**{p.key: p.value for p in model.metadata_props}, KEY: json.dumps(about)})
    onnx.save(model, str(path))


def load(path: Path) -> State:
    """The state whose network a file holds.

    Raises:
        RealsimError: another model, or a damaged one.
    """
    import onnx
    from google.protobuf.message import DecodeError

    try:
        if path.stat().st_size > MAX_BYTES:
            raise RealsimError("too large for this network", file=path, expected=f"at most {MAX_BYTES} bytes")
        model = onnx.load(str(path), load_external_data=False)
    except (OSError, DecodeError) as error:
        raise RealsimError("cannot be read", file=path, found=str(error)) from error
    notes = {p.key: p.value for p in model.metadata_props}
    if KEY not in notes:
        raise RealsimError(
            "not a file of this training", file=path, expected="an ONNX file of training.pointmap.export"
        )
    try:
        about = json.loads(notes[KEY])
        net = PointmapNet(Shape(**{**about["shape"], "stem": tuple(about["shape"]["stem"])}))
        tensors = _tensors(model.graph)
        weights = {name: _weight(where, tensors) for name, where in about["parameters"].items()}
        net.load_state_dict(weights)
        return State(net, int(about["step"]), int(about["views"]), float(about["minutes"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise RealsimError("the file does not fit the network", file=path, found=str(error).splitlines()[0]) from error


def _weight(where: Any, tensors: dict[str, np.ndarray]) -> torch.Tensor:
    if not (isinstance(where, list) and where and isinstance(where[0], str)):
        return torch.tensor(where, dtype=torch.float32)
    name, turned = where
    array = tensors[name].T if turned else tensors[name]
    return torch.from_numpy(np.array(array, np.float32))


def _tensors(graph: Any) -> dict[str, np.ndarray]:
    """All weights by name, those that are stored smaller as the graph turns them back."""
    from onnx import numpy_helper

    found = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    for node in graph.node:
        if node.op_type == "Cast" and node.input[0] in found:
            found[node.output[0]] = found[node.input[0]].astype(np.float32)
        elif node.op_type == "DequantizeLinear" and node.input[0] in found:
            whole, scale = found[node.input[0]], found[node.input[1]]
            axis = next(a.i for a in node.attribute if a.name == "axis")
            shape = [-1 if k == axis else 1 for k in range(whole.ndim)]
            found[node.output[0]] = whole.astype(np.float32) * scale.reshape(shape)
    return found


def any_of(path: Path) -> State:
    """The state in a folder, or in a file that `export` wrote."""
    return load(path) if path.suffix == ".onnx" else states.load(path)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="an exported .onnx file")
    parser.add_argument("--out", type=Path, required=True)
    o = parser.parse_args()
    try:
        print(states.save(o.out, load(o.file)))
    except RealsimError as error:
        print(error.render(), file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
