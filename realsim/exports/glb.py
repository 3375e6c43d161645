"""glTF 2.0 binary."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT, UINT16, UINT32 = 5126, 5123, 5125
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
# glTF's y points up, ours z: the node turns by -90 degrees about x (x y z w), the numbers stay those of the mesh.
Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]


def glb_bytes(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    normals: NDArray[np.float64],
    colors: NDArray[np.uint8] | None = None,
) -> bytes:
    """A triangle mesh as one glTF 2.0 node whose rotation turns our z up into glTF's y up.

    Args:
        vertices: (V, 3) metres. normals: (V, 3) unit. triangles: (K, 3). colors: (V, 3) sRGB, stored linear as the
            glTF specification (3.7.2.1) asks.
    """
    parts = [
        (vertices.astype("<f4"), FLOAT, "VEC3", VERTEX_BUFFER),
        (normals.astype("<f4"), FLOAT, "VEC3", VERTEX_BUFFER),
        (triangles.astype("<u4").reshape(-1), UINT32, "SCALAR", INDEX_BUFFER),
    ]
    attributes = {"POSITION": 0, "NORMAL": 1}
    if colors is not None:
        attributes["COLOR_0"] = len(parts)
        parts.append((_linear_rgba(colors), UINT16, "VEC4", VERTEX_BUFFER))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    data = b""
    for array, component, kind, target in parts:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes, "target": target})
        accessor = {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind}
        accessors.append(accessor | ({"normalized": True} if component == UINT16 else {}))
        data += array.tobytes()  # every part is a multiple of four bytes long, as glTF's alignment needs
    accessors[0] |= {"min": parts[0][0].min(0).tolist(), "max": parts[0][0].max(0).tolist()}
    document = {
        "asset": {"version": "2.0", "generator": "realsim"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "terrain", "mesh": 0, "rotation": Z_UP_TO_Y_UP}],
        "meshes": [
            {"name": "terrain", "primitives": [{"attributes": attributes, "indices": 2, "material": 0, "mode": 4}]}
        ],
        "materials": [
            {
                "name": "scan",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9},
            }
        ],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return _container(document, data)


def _linear_rgba(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """(V, 4) 16-bit linear RGBA of (V, 3) sRGB bytes (IEC 61966-2-1)."""
    s = colors / 255.0
    linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    return np.concatenate([np.rint(linear * 65535), np.full((len(s), 1), 65535)], 1).astype("<u2")


def _container(document: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
