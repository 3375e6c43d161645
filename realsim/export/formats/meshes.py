"""The scanned surface alone: GLB, OBJ, STL, PLY."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import write_files
from realsim.core.meshes import ply_bytes, vertex_normals
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.gltf import glb_bytes
from realsim.export.visual import bake, textured_obj


def glb(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """glTF 2.0 binary with a texture where the scan has colour; y up as glTF has it, by the node's rotation.

    Vertex colours alone are grey in programs that show a material's texture only (Blender as it opens).
    """
    normals = vertex_normals(scene.vertices, scene.triangles)
    if scene.colors is None:
        return write_files(folder, {"terrain.glb": glb_bytes(scene.vertices, scene.triangles, normals)})
    image, uv = bake(scene.vertices, scene.triangles, scene.colors)
    corners = scene.triangles.ravel()
    own = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    data = glb_bytes(scene.vertices[corners], own, normals[corners], texture=(image, uv.reshape(-1, 2)))
    return write_files(folder, {"terrain.glb": data})


def obj(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Wavefront OBJ, z up, with a material and a texture where the scan has colour."""
    return write_files(folder, drawn(scene, "terrain"))


def drawn(scene: SceneOnDisk, name: str) -> dict[str, bytes]:
    """File name -> content of the scanned surface as OBJ, with a material and a texture where the scan has colour."""
    files = textured_obj(name, scene.vertices, scene.triangles, scene.colors)
    if scene.colors is None:
        return files
    files[f"{name}.obj"] = f"mtllib {name}.mtl\nusemtl scan\n".encode() + files[f"{name}.obj"]
    return files | {f"{name}.mtl": f"newmtl scan\nKd 1 1 1\nmap_Kd {name}.png\n".encode()}


def stl(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Binary STL, metres, z up; the format has no colour."""
    return write_files(folder, {"terrain.stl": stl_bytes(scene.vertices, scene.triangles)})


def ply(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Binary PLY with vertex colours, z up."""
    return write_files(folder, {"terrain.ply": ply_bytes(scene.vertices, scene.triangles, scene.colors)})


def stl_bytes(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """(V, 3) and (K, 3) as binary STL."""
    import trimesh

    made: Any = trimesh.Trimesh(vertices, triangles, process=False).export(file_type="stl")
    return bytes(made)
