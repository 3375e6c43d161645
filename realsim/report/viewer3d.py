"""An interactive 3D view inside a page: layers of triangles, lines and points, drawn by `viewer.js` (WebGL 2).

Positions are quantised to 16 bits of the layer's longest side (a 5 m scene: 0.08 mm), colours to 8 bits. Vertices are
numbered as the cells first use them, so that neighbours in the file are neighbours in space: their differences, one
plane a byte, deflate to a quarter. The page has them as base64, so that the file opens from disk without a network.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from realsim.report.page import asset, esc


@dataclass(frozen=True)
class Layer:
    """Something that can be shown and hidden.

    Layers of the same name share one button. `kind` says what `cells` means: triangles (K, 3), line segments (K, 2), or
    points (`cells` is ignored).
    """

    name: str
    vertices: Any
    """(V, 3) metres, z up."""
    cells: Any = None
    """Indices into `vertices`."""
    colors: Any = None
    """(V, 3) uint8 RGB, or one RGB triple for all."""
    kind: Literal["triangles", "lines", "points"] = "triangles"
    visible: bool = True
    opacity: float = 1.0


def script() -> str:
    """The viewer's JavaScript; a page needs it once, after its body."""
    return asset("viewer.js")


def viewer(layers: Sequence[Layer], *, label: str = "3D view", azimuth: float = 68.0) -> str:
    """A piece of HTML that shows the layers, with a button for each; empty layers are left out.

    It opens looking in the direction `azimuth`, degrees from x to y.

    One finger or the left button turns, two fingers or the right button move, pinch or wheel zooms.
    """
    kept = [layer for layer in layers if len(np.asarray(layer.vertices)) and _cells(layer).size]
    data = json.dumps([_pack(layer) for layer in kept], separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<div class="viewer3d" role="img" aria-label="{esc(label)}" data-azimuth="{azimuth:g}">'
        f'<script type="application/json">{data}</script></div>'
    )


def camera_frustums(T: ArrayLike, half_width: float, half_height: float, length: float = 0.12) -> tuple[Any, Any]:
    """Line segments that draw cameras as small pyramids.

    Args:
        T: (N, 4, 4) camera to scene, OpenCV axes.
        half_width, half_height: tangents of half the field of view.
        length: metres from the eye to the drawn image.

    Returns:
        vertices (5 N, 3) and segments (8 N, 2).
    """
    T = np.asarray(T, float).reshape(-1, 4, 4)
    corners = np.array([[0, 0, 0], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float)
    corners *= np.array([half_width, half_height, 1.0]) * length
    V = np.einsum("nij,kj->nki", T[:, :3, :3], corners) + T[:, None, :3, 3]
    edges = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]])
    return V.reshape(-1, 3), (edges[None] + 5 * np.arange(len(T))[:, None, None]).reshape(-1, 2)


def _cells(layer: Layer) -> np.ndarray:
    if layer.kind == "points":
        return np.arange(len(np.asarray(layer.vertices)))
    return np.asarray(layer.cells if layer.cells is not None else [], np.int64)


def _pack(layer: Layer) -> dict[str, Any]:
    V = np.asarray(layer.vertices, float)
    cells = _cells(layer).ravel()
    used, first, where = np.unique(cells, return_index=True, return_inverse=True)
    order = np.argsort(first)
    V, number = V[used[order]], np.argsort(order)[where]
    low = V.min(0)
    size = max(float((V - low).max()), 1e-9)
    out: dict[str, Any] = {
        "name": layer.name,
        "kind": layer.kind,
        "visible": layer.visible,
        "opacity": layer.opacity,
        "low": [round(float(v), 6) for v in low],
        "size": round(size, 6),
        "vertices": _deflated(_steps(((V - low) / size * 65535).round()), 2),
        # How far back from the next new vertex: 0 is a new one.
        "cells": _deflated(np.maximum.accumulate(np.r_[-1, number[:-1]]) + 1 - number, 4),
    }
    colors = np.asarray((150, 156, 168) if layer.colors is None else layer.colors, np.uint8)
    if colors.ndim == 1:
        out["color"] = [int(c) for c in colors]
    else:
        out["colors"] = _deflated(_steps(colors[used[order]]), 1)
    return out


def _steps(rows: np.ndarray) -> np.ndarray:
    """Each row less the one before, column by column."""
    return np.diff(rows.astype(np.int64), axis=0, prepend=0).T.ravel()


def _deflated(values: np.ndarray, width: int) -> str:
    """Integers modulo 256^width, all their low bytes first."""
    planes = values.astype("<u4").view(np.uint8).reshape(-1, 4).T[:width]
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode()
