"""Pieces of published models that no ONNX graph can hold, and the same mathematics without them."""

import contextlib
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

ROTARY = {"RoPE2D": "base", "cuRoPE2D": "base", "RotaryPositionEmbedding2D": "base_frequency"}
"""Class of a rotary embedding -> its attribute with the base of the frequencies. The first two are CroCo's and its
descendants' (DUSt3R, Pi3), the last is VGGT's and Depth Anything 3's."""


def replace_tables(model: torch.nn.Module) -> int:
    """Compute positions and their angles where a model looks them up.

    Rotary embeddings (`ROTARY`) keep a table of angles as long as the largest position (`int(positions.max())`), which
    is data, and a graph cannot depend on data. A `position_getter` keeps positions by size, and would keep the
    exporter's symbols.

    Returns:
        How many rotary embeddings were replaced.
    """
    for module in model.modules():
        if getattr(module, "position_getter", None) is not None:
            module.position_getter = grid_positions
    # One embedding may hang on every block: count it once.
    found = {id(m): m for m in model.modules() if hasattr(m, ROTARY.get(type(m).__name__, ""))}
    for module in found.values():
        module.forward = types.MethodType(_rope, module)
    return len(found)


def _rope(self: Any, tokens: Tensor, positions: Tensor) -> Tensor:
    """Rotate the halves of `tokens` (B, heads, n, D) by angles from rows and columns `positions` (B, n, 2)."""
    half = tokens.shape[-1] // 2
    base = getattr(self, ROTARY[type(self).__name__])
    rate = base ** (-torch.arange(0, half, 2, dtype=torch.float32, device=tokens.device) / half)
    out = []
    for k, part in enumerate(tokens.split(half, dim=-1)):
        angle = positions[:, None, :, k, None].to(torch.float32) * rate
        cos, sin = angle.cos().to(tokens.dtype), angle.sin().to(tokens.dtype)
        a, b = part.split(half // 2, dim=-1)
        out += [a * cos - b * sin, b * cos + a * sin]
    return torch.cat(out, dim=-1)


def grid_positions(batch: int, rows: int, columns: int, device: Any) -> Tensor:
    """(batch, rows * columns, 2) row and column of each patch, without `cartesian_prod` and without a cache."""
    y = torch.arange(rows, device=device)[:, None].expand(rows, columns)
    x = torch.arange(columns, device=device)[None, :].expand(rows, columns)
    return torch.stack([y, x], -1).reshape(1, rows * columns, 2).expand(batch, -1, -1)


def unit_rows(nine: Tensor) -> Tensor:
    """(B, 9) with each row of three normalised: what Pi3 hands to its SVD, which the host does instead."""
    return torch.nn.functional.normalize(nine.reshape(-1, 3, 3), dim=-1).reshape(-1, 9)


def replace_group_norm(model: torch.nn.Module) -> int:
    """Take the means of group normalisation axis by axis.

    onnxruntime sums a whole group in one float32. With the millions of values of a large map, the output of MoGe-2
    was off by half a percent.

    Returns:
        How many were replaced.
    """
    found = [m for m in model.modules() if isinstance(m, torch.nn.GroupNorm)]
    for module in found:
        module.forward = types.MethodType(_group_norm, module)
    return len(found)


def _group_norm(self: Any, x: Tensor) -> Tensor:
    """Normalise maps (B, C, H, W) in groups of channels."""
    grouped = x.reshape(x.shape[0], self.num_groups, -1, *x.shape[2:])

    def mean(values: Tensor) -> Tensor:
        return values.mean(4, keepdim=True).mean(3, keepdim=True).mean(2, keepdim=True)

    centred = grouped - mean(grouped)
    out = (centred / (mean(centred**2) + self.eps).sqrt()).reshape(x.shape)
    return out if self.weight is None else out * self.weight[:, None, None] + self.bias[:, None, None]


@contextlib.contextmanager
def head_by_head(model: torch.nn.Module) -> Iterator[None]:
    """While this lasts, attention in `model` goes through its heads one after the other.

    torch fuses `scaled_dot_product_attention`; an ONNX graph writes it out, with a (heads, tokens, tokens) matrix that
    needs gigabytes for eight views. One head at a time needs only its own share of that, and the result is the same.
    """
    fused = torch.nn.functional.scaled_dot_product_attention
    # Projects write `F.scaled_dot_product_attention`, or import the function by name into the module of their layer.
    places = {sys.modules[type(m).__module__] for m in model.modules()} | {torch.nn.functional}
    bound = [(place, name) for place in places for name, value in vars(place).items() if value is fused]

    def attention(query: Tensor, key: Tensor, value: Tensor, *args: Any, **options: Any) -> Tensor:
        mask = args[0] if args else options.get("attn_mask")
        if query.ndim != 4 or mask is not None:
            return fused(query, key, value, *args, **options)
        heads = zip(*(x.split(1, dim=1) for x in (query, key, value)), strict=True)
        return torch.cat([fused(*head, *args, **options) for head in heads], 1)

    try:
        for place, name in bound:
            setattr(place, name, attention)
        yield
    finally:
        for place, name in bound:
            setattr(place, name, fused)


class Wrapped(torch.nn.Module):
    """A function of tensors around a model, as a module."""

    def __init__(self, model: torch.nn.Module, run: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.model = model
        self.run = run

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """What `run(model, *inputs)` gives."""
        return self.run(self.model, *inputs)
