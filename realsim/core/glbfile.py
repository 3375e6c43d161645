"""GLB files whose geometry trimesh reads wrongly or as zeros, without an error."""

import json
from pathlib import Path

from realsim.core.errors import RealsimError

LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
"""How extensions begin (glTF 2.0) that leave the places of vertices and triangles as they are read."""


def check_glb(data: bytes, path: Path) -> None:
    """Refuse what is packed, placed or scaled in a way that is not read; damaged files are the reader's matter."""
    try:
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        found = [name for name in document.get("extensionsRequired", []) if not name.startswith(LOOKS)]
        found += [name for name in document.get("extensionsUsed", []) if "instancing" in name and name not in found]
        accessors = document.get("accessors", [])
        places = {p["attributes"].get("POSITION") for mesh in document.get("meshes", []) for p in mesh["primitives"]}
        if any(accessors[k].get("normalized") for k in places if k is not None):
            found.append("vertices as shares of an integer's range (normalized)")
        if any("sparse" in accessor for accessor in accessors):
            found.append("sparse accessors")
    except (ValueError, TypeError, LookupError, AttributeError):
        return
    if found:
        raise RealsimError(
            "the file stores its geometry in a way that is not read",
            file=path,
            expected="a GLB without compression or instancing of its geometry",
            found=", ".join(found),
            hint="export it again without (in Blender: no compression), or as .ply or .obj",
        )
