"""A network as an ONNX graph: what torch does for one call of it, written down operation by operation.

torch's own exporter takes six seconds of a processor for a perceptron, and as long to import.
"""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from trainer.errors import TrainerError

OPSET, IR = 18, 8
"""What runtimes have read since 2023."""


def _conv(x: Any, w: Any, b: Any = None, stride: Any = 1, padding: Any = 0, dilation: Any = 1, groups: int = 1) -> Any:
    stride, padding, dilation = (list(torch.nn.modules.utils._pair(v)) for v in (stride, padding, dilation))
    return "Conv", [x, w, b], {"strides": stride, "pads": padding * 2, "dilations": dilation, "group": groups}


def _same(kind: str) -> Any:
    return lambda *inputs, inplace=False: (kind, [*inputs], {})


OPERATIONS: dict[str, Callable[..., tuple[str, list[Any], dict[str, Any]]]] = {
    "linear": lambda x, w, b=None: ("Gemm", [x, w, b], {"transB": 1}),
    "conv2d": _conv,
    "flatten": lambda x, start_dim: ("Flatten", [x], {"axis": start_dim}),
    "cat": lambda parts, dim: ("Concat", [*parts], {"axis": dim}),
    "clamp": lambda x, low, high: ("Clip", [x, low, high], {}),
    "elu": lambda x, alpha=1.0, inplace=False: ("Elu", [x], {"alpha": alpha}),
    "float": lambda x: ("Identity", [x], {}),
    **{name: _same(name.title()) for name in ("add", "sub", "mul", "div", "relu", "tanh", "sigmoid", "exp")},
}
"""name in torch -> its arguments as (operation of ONNX, inputs, attributes)."""


def written(network: nn.Module, inputs: Mapping[str, Tensor | None], output: str) -> Any:
    """The `onnx.ModelProto` of a network whose inputs (N, ...) and output have names, for any N.

    Raises:
        TrainerError: the network does something that `OPERATIONS` does not have.
    """
    from onnx import TensorProto, helper

    with torch.no_grad(), _Follower(network, inputs) as seen:
        result = network(*inputs.values())
    seen.nodes.append(helper.make_node("Identity", [seen.name(result)], [output]))

    def shaped(name: str, value: Tensor) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *value.shape[1:]])

    given = [shaped(name, value) for name, value in inputs.items() if value is not None]
    graph = helper.make_graph(seen.nodes, "policy", given, [shaped(output, result)], seen.constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)


class _Follower(TorchFunctionMode):
    """Writes a node for every operation on what comes from the inputs; all else is constant."""

    def __init__(self, network: nn.Module, inputs: Mapping[str, Tensor | None]) -> None:
        super().__init__()
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.kept: dict[int, tuple[str, Any]] = {}  # a tensor that is gone would give its number to another one
        self.own = {id(value): name for name, value in network.state_dict(keep_vars=True).items()}
        self.kept |= {id(value): (name, value) for name, value in inputs.items() if value is not None}
        self.known = set(self.kept)

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        flat = [
            part for arg in (*args, *kwargs.values()) for part in (arg if isinstance(arg, tuple | list) else (arg,))
        ]
        if isinstance(result, Tensor) and any(id(arg) in self.known for arg in flat):
            self._note(func.__name__, args, kwargs, result)
        return result

    def _note(self, name: str, args: Any, kwargs: Any, result: Tensor) -> None:
        from onnx import helper

        try:
            kind, inputs, attributes = OPERATIONS[name](*args, **kwargs)
        except (KeyError, TypeError) as error:
            raise TrainerError(
                "the policy cannot be written as ONNX",
                expected=f"the operations {', '.join(sorted(OPERATIONS))}",
                found=f"{name}, with {len(args)} arguments{''.join(f', {k}' for k in kwargs)}",
                hint="add it to OPERATIONS of trainer/ppo/graph.py",
            ) from error
        given = ["" if value is None else self.name(value) for value in inputs]
        self.kept[id(result)] = (f"{name}_{len(self.nodes)}", result)
        self.known.add(id(result))
        self.nodes.append(helper.make_node(kind, given, [self.name(result)], **attributes))

    def name(self, value: Any) -> str:
        """Of a tensor; whatever does not come from the inputs becomes a constant."""
        from onnx import numpy_helper

        if id(value) not in self.kept:
            name = self.own.get(id(value), f"constant_{len(self.constants)}")
            numbers = torch.as_tensor(value, dtype=torch.float32).detach().cpu().numpy()
            self.constants.append(numpy_helper.from_array(numbers, name))
            self.kept[id(value)] = (name, value)
        return self.kept[id(value)][0]
