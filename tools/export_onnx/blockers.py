"""Pieces of published models that no ONNX graph can hold, and the same mathematics without them."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def replace_rope(model: torch.nn.Module) -> int:
    """Give every rotary embedding of a model (RoPE2D as in CroCo: `base`, a table as long as the largest position) a
    forward without a table: its length is data (`int(positions.max())`), which a graph cannot know.

    Returns:
        How many were replaced.
    """
    # A rotary embedding may hang on every block: it is one object.
    found = {id(m): m for m in model.modules() if type(m).__name__ in ("RoPE2D", "cuRoPE2D") and hasattr(m, "base")}
    for module in found.values():
        module.forward = types.MethodType(_rope, module)
    return len(found)


def _rope(self: Any, tokens: Tensor, positions: Tensor) -> Tensor:
    """Rotate the halves of `tokens` (B, heads, n, D) by angles from rows and columns `positions` (B, n, 2)."""
    half = tokens.shape[-1] // 2
    rate = self.base ** (-torch.arange(0, half, 2, dtype=torch.float32, device=tokens.device) / half)
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


class Wrapped(torch.nn.Module):
    """A function of tensors around a model, as a module."""

    def __init__(self, model: torch.nn.Module, run: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.model = model
        self.run = run

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """What `run(model, *inputs)` gives."""
        return self.run(self.model, *inputs)
