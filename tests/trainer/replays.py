"""CUDA graphs as far as a CPU can tell: operations are noted once and repeated on the same memory.

What a capture cannot hold is refused: waiting for the device, shapes that depend on data, numbers from the host. What
it would freeze (numbers of Python, tensors that are replaced) is frozen here too, and gives other results.
"""

from typing import ClassVar

import torch
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes
from torch.utils._pytree import tree_map

from trainer.graphs import Graph, _Captured, _tensors

WAITS = {"_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim", "is_nonzero", "equal", "bincount"}


def alias(tree):
    """The same memory in tensors that nobody else gives another shape."""
    return tree_map(lambda x: x.detach() if isinstance(x, torch.Tensor) else x, tree)


class Notes(TorchDispatchMode):
    """Notes operations while it is entered; `replay` repeats them, but for the first time: noting has done them."""

    running: ClassVar[list] = []

    def __init__(self):
        super().__init__()
        self.steps, self.numbers, self.fresh = [], [], True

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs, name = kwargs or {}, func._schema.name.removeprefix("aten::")
        self.refuse(func, name, args)
        given = alias((args, kwargs))
        out = func(*args, **kwargs)
        writes = any(a.alias_info and a.alias_info.is_write for a in func._schema.arguments)
        if writes and torch.Tag.inplace_view not in func.tags:
            self.steps.append((func, *given, ()))
        elif not any(r.alias_info for r in func._schema.returns):
            self.steps.append((func, *given, alias(out if isinstance(out, tuple) else (out,))))
        return out

    def refuse(self, func, name, args):
        assert name not in WAITS, f"{func} waits for the device"
        if name.startswith(("index", "_index")) and isinstance(args[1], list | tuple):
            assert not any(i is not None and i.dtype == torch.bool for i in args[1]), f"{func} by a mask waits"
        if name == "lift_fresh":
            assert args[0].ndim == 0, f"{func} copies from the host"
            self.numbers.append(args[0])
        # A number of the host is filled in by a kernel; elsewhere a GPU first copies it, and waits.
        elif name != "fill_":
            assert not any(a is n for a in _tensors(args) for n in self.numbers), f"{func} copies from the host"
        if name == "where":
            assert all(a.ndim for a in args), f"{func} copies its numbers from the host"

    def __enter__(self):
        Notes.running.append(self)
        return super().__enter__()

    def __exit__(self, *error):
        Notes.running.pop()
        return super().__exit__(*error)

    def replay(self):
        for func, args, kwargs, outputs in () if self.fresh else self.steps:
            again = func(*args, **kwargs)
            for there, here in zip(outputs, again if isinstance(again, tuple) else (again,), strict=False):
                there.copy_(here)
        self.fresh = False


def outside(owner, method):
    """An engine or ray caster launches kernels of its own: noted as one step, whatever it does on a CPU."""
    function = getattr(owner, method)

    def noted(*args, **kwargs):
        with _disable_current_modes():
            out = function(*args, **kwargs)
        for notes in Notes.running[-1:]:
            written = () if out is None else (out,)
            notes.steps.append((function, *alias((args, kwargs, written))))
        return out

    setattr(owner, method, noted)


def replayed(graph: Graph) -> None:
    """From now on the graph notes and repeats."""

    def capture(inputs, sizes):
        notes = Notes()
        with notes:
            outputs = graph.function(*inputs, **sizes)
        return _Captured(notes, list(_tensors(inputs)), outputs)

    graph.use, graph._capture = True, capture


def with_replays(env) -> None:
    """The environment with padded batches and noted steps."""
    for method in ("reset", "set_velocity", "set_params"):
        outside(env.physics, method)
    casters = {id(c): c for c in (env.probe.caster, getattr(env.camera, "caster", None)) if c is not None}
    for caster in casters.values():
        outside(caster, "cast")
    for graph in (env._acting, env._looking, env._restarting):
        replayed(graph)
