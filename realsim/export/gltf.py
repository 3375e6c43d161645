"""A glTF 2.0 binary while it grows: arrays, meshes, nodes, animations."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64

COMPONENTS = {"<f4": 5126, "<u2": 5123, "<u4": 5125}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
# glTF's y points up, ours z: a node above all turns by -90 degrees about x (x y z w), what is below stays as it is.
Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]


class GltfFile:
    """A document and its buffer."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0
        tables = ("nodes", "meshes", "materials", "accessors", "bufferViews")
        self._document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "realsim"}, "scene": 0}
        self._document |= {"scenes": [{"nodes": []}]} | {name: [] for name in tables}
        self._channels: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []

    def array(self, values: NDArray[Any], kind: str, *, limits: bool = False, target: int | None = None) -> int:
        """Append an array; returns its accessor's index.

        Args:
            values: little-endian float32, uint32, or uint16 (then 65535 stands for 1); rows of a multiple of 4 bytes,
                as glTF's alignment needs.
            kind: SCALAR, VEC2, VEC3 or VEC4.
            limits: whether its least and largest values are written, which positions and times need.
            target: VERTEX_BUFFER or INDEX_BUFFER.
        """
        accessor = {
            "bufferView": self._view(values.tobytes(), target),
            "componentType": COMPONENTS[values.dtype.newbyteorder("<").str],
            "count": len(values),
            "type": kind,
        }
        if values.dtype.itemsize == 2:
            accessor["normalized"] = True
        if limits:
            accessor |= {"min": np.atleast_1d(values.min(0)).tolist(), "max": np.atleast_1d(values.max(0)).tolist()}
        return self._add("accessors", accessor)

    def mesh(
        self,
        name: str,
        vertices: F64,
        normals: F64,
        triangles: NDArray[Any],
        pbr: Mapping[str, Any],
        linear_rgba: NDArray[np.uint16] | None = None,
        texture: tuple[bytes, F64] | None = None,
    ) -> int:
        """A mesh of (V, 3) vertices, (V, 3) unit normals and (K, 3) triangles.

        Args:
            pbr: its material, as `pbrMetallicRoughness` of the specification.
            linear_rgba: (V, 4) colours of the vertices.
            texture: a PNG of the material's colour, and each vertex' place in it, (V, 2), v counted from the bottom.
        """
        attributes = {
            "POSITION": self.array(vertices.astype("<f4"), "VEC3", limits=True, target=VERTEX_BUFFER),
            "NORMAL": self.array(normals.astype("<f4"), "VEC3", target=VERTEX_BUFFER),
        }
        if linear_rgba is not None:
            attributes["COLOR_0"] = self.array(linear_rgba, "VEC4", target=VERTEX_BUFFER)
        look: dict[str, Any] = dict(pbr)
        if texture is not None:
            # glTF counts v from the image's top row.
            places = np.array([0.0, 1.0]) + texture[1] * [1.0, -1.0]
            attributes["TEXCOORD_0"] = self.array(places.astype("<f4"), "VEC2", target=VERTEX_BUFFER)
            look["baseColorTexture"] = {"index": self._image(texture[0])}
        material = {"name": name, "doubleSided": True, "pbrMetallicRoughness": look}
        primitive = {
            "attributes": attributes,
            "indices": self.array(triangles.astype("<u4").reshape(-1), "SCALAR", target=INDEX_BUFFER),
            "material": self._add("materials", material),
        }
        return self._add("meshes", {"name": name, "primitives": [primitive]})

    def node(self, name: str, parent: int | None = None, **fields: Any) -> int:
        """A node below `parent`, or at the top."""
        index = self._add("nodes", {"name": name} | fields)
        nodes = self._document["nodes"]
        above = self._document["scenes"][0]["nodes"] if parent is None else nodes[parent].setdefault("children", [])
        above.append(index)
        return index

    def move(self, node: int, clock: int, positions: F64, quaternions: F64) -> None:
        """Animate a node: (T, 3) metres and (T, 4) w x y z at the times of accessor `clock`."""
        xyzw = np.roll(quaternions, -1, axis=1)
        for path, values, kind in (("translation", positions, "VEC3"), ("rotation", xyzw, "VEC4")):
            output = self.array(values.astype("<f4"), kind)
            self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
            self._samplers.append({"input": clock, "output": output, "interpolation": "LINEAR"})

    def to_bytes(self) -> bytes:
        """The whole file."""
        document = self._document | {"buffers": [{"byteLength": self._length}]}
        if self._channels:
            document["animations"] = [{"name": "trial", "channels": self._channels, "samplers": self._samplers}]
        text = json.dumps(document, separators=(",", ":")).encode("ascii")
        text += b" " * (-len(text) % 4)
        data = b"".join(self._parts)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _image(self, png: bytes) -> int:
        """A texture from a PNG, kept in the buffer; returns its index."""
        self._document.setdefault("images", []).append({"bufferView": self._view(png), "mimeType": "image/png"})
        self._document.setdefault("textures", []).append({"source": len(self._document["images"]) - 1})
        return len(self._document["textures"]) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes to the buffer; returns the index of their view."""
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": len(data)}
        self._parts.append(data + b"\0" * (-len(data) % 4))
        self._length += len(self._parts[-1])
        return self._add("bufferViews", view | ({} if target is None else {"target": target}))

    def _add(self, table: str, entry: dict[str, Any]) -> int:
        self._document[table].append(entry)
        return len(self._document[table]) - 1


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
    rgba = None
    if colors is not None:
        opaque = np.full((len(colors), 1), 65535)
        rgba = np.concatenate([np.rint(65535 * linear_rgb(colors)), opaque], 1).astype("<u2")
    mesh = file.mesh("terrain", vertices, normals, triangles, pbr, rgba, texture)
    file.node("terrain", mesh=mesh, rotation=Z_UP_TO_Y_UP)
    return file.to_bytes()


def linear_rgb(colors: NDArray[np.uint8]) -> F64:
    """(V, 3) linear light in 0..1 of sRGB bytes, as cameras give them (IEC 61966-2-1)."""
    s = colors / 255.0
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
