"""Mesh files that trimesh reads wrongly, in part or as zeros without an error, or not for a few bytes too many."""

import json
from pathlib import Path

from realsim.core.errors import RealsimError

LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
"""How extensions begin (glTF 2.0) that leave the places of vertices and triangles as they are read."""
FAN = 6
"""Mode of a primitive of glTF 2.0 that is a triangle fan."""


def check_packing(data: bytes, path: Path) -> None:
    """Refuse a GLB or PLY that stores its triangles in a way that is not read; damaged files are the reader's matter.

    Args:
        data: of the file; of a PLY its header is enough.
    """
    found: list[str] = []
    if data.startswith(b"ply") and b"element tristrips" in data[: data.find(b"end_header")]:
        found = ["triangles in strips (tristrips)"]
    elif data.startswith(b"glTF"):
        found = _packed_glb(data)
    if found:
        raise RealsimError(
            "the file stores its geometry in a way that is not read",
            file=path,
            expected="plain triangles, without compression or instancing",
            found=", ".join(found),
            hint="export it again without (in Blender: no compression), or as .stl or .obj",
        )


def _packed_glb(data: bytes) -> list[str]:
    try:
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        found = [name for name in document.get("extensionsRequired", []) if not name.startswith(LOOKS)]
        found += [name for name in document.get("extensionsUsed", []) if "instancing" in name and name not in found]
        accessors = document.get("accessors", [])
        primitives = [p for mesh in document.get("meshes", []) for p in mesh["primitives"]]
        places = {p["attributes"].get("POSITION") for p in primitives}
        if any(accessors[k].get("normalized") for k in places if k is not None):
            found.append("vertices as shares of an integer's range (normalized)")
        if any("sparse" in accessor for accessor in accessors):
            found.append("sparse accessors")
        if any(p.get("mode") == FAN for p in primitives):
            found.append("triangle fans")
    except (ValueError, TypeError, LookupError, AttributeError):
        return []
    return found


def plain_stl(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """(an STL without what a program appended to its last triangle, a sentence about that).

    Where as many bytes follow as more triangles have, the count in the header is in doubt: those stay, to be refused.
    In text, the bytes of the count are letters, which make billions.
    """
    count = int.from_bytes(data[80:84], "little")
    more = len(data) - 84 - 50 * count
    if not count or more <= 0 or more % 50 == 0:
        return data, ()
    return data[:-more], (f"{more} bytes after the {count} triangles that the header counts were not read",)
