"""Frames as the arrays that a model takes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import CaptureError, ModelError
from realsim.core.types import Frame
from realsim.feedforward.onnx.adapters import Call
from realsim.feedforward.onnx.preprocess import Grid, camera_matrices, depth_to_grid, make_grid, to_tensor
from realsim.feedforward.onnx.spec import Port, Spec

BYTES_A_PIXEL = 800
"""First guess of what a view costs in a run (tokens, attention, outputs). Too low is caught: a run that does not fit
is repeated with fewer views."""
TOKENS = (1200, 3600)
"""Fewest and most tokens a view that MoGe-2 is made for."""


@dataclass(frozen=True)
class Inputs:
    """Frames for a model; pictures are read when a run needs them."""

    frames: tuple[Frame, ...]
    spec: Spec
    grids: tuple[Grid, ...]
    """One a frame, all of one size."""
    with_depth: bool
    """Whether a model that can take sensor depth is given it."""

    @classmethod
    def of(cls, frames: Sequence[Frame], spec: Spec, *, with_depth: bool) -> Inputs:
        """Grids for all frames.

        Raises:
            CaptureError: a frame without colour.
            ModelError: the model needs poses and there are none; a picture shape that the model cannot be given.
        """
        colourless = [f.name for f in frames if f.read_color is None]
        if colourless:
            raise CaptureError(
                "a feed-forward model needs colour",
                found=f"{len(colourless)} frames without, {', '.join(colourless[:3])} among them",
                hint="use --backend rgbd",
            )
        if any(p.name == "poses" for p in spec.extra_inputs) and any(f.T_world_camera is None for f in frames):
            raise ModelError("the model takes poses, and the capture has none for all frames", hint="export it without")
        cameras = [f.color_intrinsics or f.intrinsics for f in frames]
        first = make_grid(cameras[0], spec)
        fixed = Spec(**{**vars(spec), "fixed_hw": (first.height, first.width)})
        return cls(tuple(frames), spec, tuple(make_grid(c, fixed) for c in cameras), with_depth)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the model's grid."""
        return self.grids[0].height, self.grids[0].width

    def call(self, views: Sequence[int], ran: int) -> Call:
        """Data for adapters about a run of these views."""
        h, w = self.size
        K = camera_matrices([self.grids[i] for i in views])
        return Call(len(views), ran, h, w, self.spec.pose, self.spec.conf, K)

    def feeds(self, views: Sequence[int]) -> dict[str, NDArray]:
        """Arrays by input name for a run of these views, in this order."""
        colors = [self.frames[i].read_color for i in views]
        shown = ((color(), self.grids[i]) for color, i in zip(colors, views, strict=True) if color is not None)
        images = np.stack([to_tensor(picture, grid, self.spec.norm) for picture, grid in shown])
        out = {self.spec.image.name: images[None] if self.spec.batched else images}
        for port in self.spec.extra_inputs:
            out[port.name] = self._extra(port, views)
        return out

    def _extra(self, port: Port, views: Sequence[int]) -> NDArray:
        if port.name == "num_tokens":
            h, w = self.size
            count = np.clip(h * w // self.spec.patch**2, *TOKENS)
            return np.asarray(count, np.int64).reshape([1] * len(port.shape))
        if port.name == "depths":
            values = np.stack([self._depth(i) for i in views])
        elif port.name == "intrinsics":
            values = camera_matrices([self.grids[i] for i in views])
        else:
            values = np.stack([np.asarray(self.frames[i].T_world_camera) for i in views])
        values = values.astype(np.float32)
        return values[None] if len(port.shape) == values.ndim + 1 else values

    def _depth(self, i: int) -> NDArray:
        frame = self.frames[i]
        if not self.with_depth:
            return np.zeros(self.size, np.float32)
        return depth_to_grid(frame.depth(), frame.intrinsics, self.grids[i])

    def views_in_memory(self) -> int:
        """Largest number of views per run, by the free memory."""
        h, w = self.size
        return max(2, int(0.6 * free_memory() / (h * w * BYTES_A_PIXEL)))


def free_memory() -> int:
    """Bytes that a process can have without swapping (Linux; elsewhere a guess of 4 GB)."""
    try:
        with open("/proc/meminfo") as file:
            lines = dict(line.split(":", 1) for line in file)
        return int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        pages = os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
        return max(pages * 4096 // 2, 4 * 2**30)
