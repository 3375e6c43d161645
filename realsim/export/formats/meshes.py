"""The scanned surface alone: GLB, OBJ, STL, PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from realsim.core.files import write_bytes
from realsim.core.meshes import across, ply_bytes
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.glb import glb_bytes
from realsim.export.visual import bake, obj_bytes, vertex_normals


def glb(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """glTF 2.0 binary with a texture where the scan has colour; y up as glTF has it, by the node's rotation.

    Vertex colours alone are grey in programs that show a material's texture only (Blender as it opens).
    """
    normals = vertex_normals(scene.vertices, scene.triangles)
    path = folder / "terrain.glb"
    if scene.colors is None:
        write_bytes(path, glb_bytes(scene.vertices, scene.triangles, normals))
        return [path]
    image, uv = bake(scene.vertices, scene.triangles, scene.colors)
    corners = scene.triangles.ravel()
    own = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    write_bytes(path, glb_bytes(scene.vertices[corners], own, normals[corners], texture=(image, uv.reshape(-1, 2))))
    return [path]


def obj(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Wavefront OBJ, z up, with a material and a texture where the scan has colour."""
    files = drawn(scene, "terrain")
    for name, data in files.items():
        write_bytes(folder / name, data)
    return [folder / name for name in files]


def drawn(scene: SceneOnDisk, name: str) -> dict[str, bytes]:
    """File name -> content of the scanned surface as OBJ, with a material and a texture where the scan has colour."""
    normals = vertex_normals(scene.vertices, scene.triangles)
    if scene.colors is None:
        return {f"{name}.obj": obj_bytes(scene.vertices, scene.triangles, normals)}
    image, uv = bake(scene.vertices, scene.triangles, scene.colors)
    head = f"mtllib {name}.mtl\nusemtl scan\n".encode()
    return {
        f"{name}.obj": head + obj_bytes(scene.vertices, scene.triangles, normals, uv),
        f"{name}.mtl": f"newmtl scan\nKd 1 1 1\nmap_Kd {name}.png\n".encode(),
        f"{name}.png": image,
    }


def stl(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Binary STL, metres, z up; the format has no colour."""
    path = folder / "terrain.stl"
    write_bytes(path, stl_bytes(scene.vertices, scene.triangles))
    return [path]


def ply(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Binary PLY with vertex colours, z up."""
    path = folder / "terrain.ply"
    write_bytes(path, ply_bytes(scene.vertices, scene.triangles, scene.colors))
    return [path]


def stl_bytes(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """(V, 3) and (K, 3) as binary STL."""
    normal = across(vertices, triangles)
    rows = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
    rows["corners"] = vertices[triangles]
    return b"realsim, metres, z up".ljust(80, b"\0") + np.uint32(len(triangles)).tobytes() + rows.tobytes()
