"""Functions as CUDA graphs: one launch instead of hundreds of small ones, for which the GPU waits."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from trainer.errors import TrainerError

T = TypeVar("T")

_SIZES = (32, 128, 512, 2048)
"""Numbers of rows for which functions are captured, beside that of all worlds."""


@dataclass
class _Captured:
    graph: Any
    inputs: list[Tensor]
    outputs: Any


class Graph(Generic[T]):
    """A function that, in use, is captured after its first calls and only replayed from then on.

    They run it as it is, so that kernels are loaded and algorithms chosen, which a capture cannot do. The function
    keeps what it changes where it is (`copy_`, `index_copy_`, ...), its shapes depend on no data, it waits for nothing
    and changes nothing but tensors. What it returns is overwritten by the next call. An argument that lies elsewhere
    than at the capture is copied there.

    Args:
        function: of tensors, and of integers given by name: each set of these has a graph of its own.
        generator: of its random numbers.
        use: whether there are graphs at all; otherwise the function is simply called.
        calls: how many run as they are. A function of what another one returns has one more than that: what it is
            given then lies where it will lie from then on.
    """

    def __init__(self, function: Callable[..., T], generator: torch.Generator, use: bool, calls: int = 1) -> None:
        self.function, self.generator, self.use, self.calls = function, generator, use, calls
        self._called: Counter[tuple[int, ...]] = Counter()
        self._captured: dict[tuple[int, ...], _Captured] = {}
        self._place: dict[str, Any] = {}
        """Memory and stream of the captures: those of this function share them, as only one runs at a time."""

    def __call__(self, *inputs: Any, **sizes: int) -> T:
        key = tuple(sizes.values())
        self._called[key] += 1
        if not self.use or self._called[key] <= self.calls:
            return self.function(*inputs, **sizes)
        if key not in self._captured:
            self._captured[key] = self._capture(inputs, sizes)
        captured = self._captured[key]
        for there, here in zip(captured.inputs, _tensors(inputs), strict=True):
            if there.data_ptr() != here.data_ptr():
                there.copy_(here)
        captured.graph.replay()
        return captured.outputs

    def _capture(self, inputs: tuple[Any, ...], sizes: dict[str, int]) -> _Captured:
        device = self.generator.device
        if not self._place:
            self._place = {"pool": torch.cuda.graph_pool_handle(), "stream": torch.cuda.Stream(device)}
        graph = torch.cuda.CUDAGraph()
        graph.register_generator_state(self.generator.graphsafe_get_state())  # refuses a subclass; the state is shared
        try:
            # Other threads, such as that which watches over NCCL, may go on meanwhile.
            with torch.cuda.device(device), torch.cuda.graph(graph, capture_error_mode="thread_local", **self._place):
                outputs = self.function(*inputs, **sizes)
        except RuntimeError as error:
            if "out of memory" in str(error).lower():
                raise  # who asked can try again with fewer worlds
            raise TrainerError(
                f"{self.function.__qualname__} cannot be made a CUDA graph",
                found=str(error).partition("\n")[0],
                hint="train with --no-graphs",
            ) from error
        return _Captured(graph, list(_tensors(inputs)), outputs)


def room(count: int, most: int) -> int:
    """The smallest number of rows with a graph of its own that holds `count` of `most`."""
    return next((size for size in _SIZES if count <= size < most), most)


def places(mask: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Where a mask (N,) is true, in order, without waiting for how often.

    Returns:
        (size,) the first places; if there are fewer, the last one is repeated. (size,) which of them, from 0: a row
        that repeats another has its number.
    """
    until = mask.cumsum(0)
    rows = torch.minimum(torch.arange(size, device=mask.device), until[-1] - 1).clamp_min(0)
    return torch.searchsorted(until, rows + 1).clamp_max(len(mask) - 1), rows


def _tensors(x: Any) -> Iterator[Tensor]:
    if isinstance(x, Tensor):
        yield x
    elif isinstance(x, tuple):
        for part in x:
            yield from _tensors(part)
    elif is_dataclass(x):
        for f in fields(x):
            yield from _tensors(getattr(x, f.name))
