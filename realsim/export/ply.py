"""PLY, binary little-endian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def ply_bytes(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], colors: NDArray[np.uint8] | None = None
) -> bytes:
    """A triangle mesh as PLY: (V, 3) metres as float32, (K, 3) indices, (V, 3) RGB; simulation frame, z up."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    fields: list[tuple[str, str, tuple[int, ...]]] = [("xyz", "<f4", (3,))]
    if colors is not None:
        header += [f"property uchar {c}" for c in ("red", "green", "blue")]
        fields.append(("rgb", "u1", (3,)))
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.zeros(len(vertices), fields)
    rows["xyz"] = vertices
    if colors is not None:
        rows["rgb"] = colors
    faces = np.zeros(len(triangles), [("n", "u1"), ("v", "<i4", (3,))])
    faces["n"], faces["v"] = 3, triangles
    return "\n".join(header).encode("ascii") + rows.tobytes() + faces.tobytes()
