"""A terrain as glTF 2.0 binary."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from realsim.export.gltf import Z_UP_TO_Y_UP, GltfFile


def glb_bytes(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    normals: NDArray[np.float64],
    colors: NDArray[np.uint8] | None = None,
    texture: tuple[bytes, NDArray[np.float64]] | None = None,
) -> bytes:
    """A triangle mesh as one glTF 2.0 node whose rotation turns our z up into glTF's y up.

    Args:
        vertices: (V, 3) metres. normals: (V, 3) unit. triangles: (K, 3). colors: (V, 3) sRGB, stored linear as the
            glTF specification (3.7.2.1) asks. texture: a PNG and (V, 2) places in it, v counted from the bottom row.
    """
    file = GltfFile()
    pbr = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    rgba = None if colors is None else _linear_rgba(colors)
    mesh = file.mesh("terrain", vertices, normals, triangles, pbr, rgba, texture)
    file.node("terrain", mesh=mesh, rotation=Z_UP_TO_Y_UP)
    return file.to_bytes()


def _linear_rgba(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """(V, 4) 16-bit linear RGBA of (V, 3) sRGB bytes (IEC 61966-2-1)."""
    s = colors / 255.0
    linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    return np.concatenate([np.rint(linear * 65535), np.full((len(s), 1), 65535)], 1).astype("<u2")
