"""The mesh as MuJoCo draws it: OBJ with a texture. MuJoCo knows no vertex colours, so they are baked."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError
from realsim.core.meshes import vertex_normals
from realsim.core.types import F64

TILE = 4  # texels a side that each triangle gets
I32 = NDArray[np.int32]


def obj_bytes(vertices: F64, triangles: I32, normals: F64, uv: F64 | None = None) -> bytes:
    """Wavefront OBJ, metres to 10 micrometres. `uv` is (K, 3, 2), a texture coordinate for each triangle corner."""
    index = triangles + 1
    parts = ["# metres, z up\n", _rows("v %.5f %.5f %.5f", vertices), _rows("vn %.3f %.3f %.3f", normals)]
    if uv is None:
        parts.append(_rows("f %d//%d %d//%d %d//%d", np.repeat(index, 2, 1)))
    else:
        corner = np.arange(1, 3 * len(triangles) + 1).reshape(-1, 3)
        parts.append(_rows("vt %.6f %.6f", uv.reshape(-1, 2)))
        parts.append(_rows("f %d/%d/%d %d/%d/%d %d/%d/%d", np.stack([index, corner, index], 2).reshape(-1, 9)))
    return "".join(parts).encode("ascii")


def textured_obj(name: str, vertices: F64, triangles: I32, colors: NDArray[np.uint8] | None) -> dict[str, bytes]:
    """File name -> content of a mesh as OBJ, and of its texture where there is colour."""
    normals = vertex_normals(vertices, triangles)
    if colors is None:
        return {f"{name}.obj": obj_bytes(vertices, triangles, normals)}
    image, uv = bake(vertices, triangles, colors)
    return {f"{name}.obj": obj_bytes(vertices, triangles, normals, uv), f"{name}.png": image}


def _rows(line: str, table: NDArray) -> str:
    """Every row of a table through one printf pattern, in a single formatting call (much faster than a loop)."""
    return (line + "\n") * len(table) % tuple(table.ravel().tolist())


def bake(vertices: F64, triangles: I32, colors: NDArray[np.uint8]) -> tuple[bytes, F64]:
    """Vertex colours as a texture of one small tile a triangle: (PNG bytes, (K, 3, 2) texture coordinates).

    A triangle's corners lie on the centres of three corner texels of its tile, and the tile holds the linear
    interpolation of its vertex colours continued over the whole square, so that bilinear filtering never sees a
    neighbour. Tiles are laid out in the order of the triangles' places in the world, so that coarse mipmaps average
    what lies close together.
    """
    count = len(triangles)
    side = int(np.ceil(np.sqrt(count)))
    order = np.argsort(_morton(vertices[triangles].mean(1)), kind="stable")
    tile = np.empty(count, np.int64)
    tile[order] = np.arange(count)
    row, column = np.divmod(tile, side)
    a, b, c = (colors[triangles[:, k]].astype(np.float32) for k in range(3))
    step = np.arange(TILE, dtype=np.float32) / (TILE - 1)
    u, v = step[None, None, :, None], step[None, :, None, None]
    texels = a[:, None, None] + u * (b - a)[:, None, None] + v * (c - a)[:, None, None]
    tiles = np.zeros((side, side, TILE, TILE, 3), np.uint8)
    tiles[row, column] = np.clip(np.rint(texels), 0, 255)
    image = tiles.transpose(0, 2, 1, 3, 4).reshape(side * TILE, side * TILE, 3)
    corner = np.array([[0, 0], [TILE - 1, 0], [0, TILE - 1]]) + 0.5
    pixel = np.stack([column, row], 1)[:, None, :] * TILE + corner
    uv = pixel / (side * TILE)
    uv[..., 1] = 1 - uv[..., 1]  # OBJ counts v from the image's bottom row
    return png_bytes(image[..., ::-1]), uv


def png_bytes(image: NDArray[Any]) -> bytes:
    """PNG of an image (H, W) or, in OpenCV's order, (H, W, 3)."""
    import cv2

    ok, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not ok:
        raise ExportError("a picture could not be encoded", found=f"{image.shape[1]} x {image.shape[0]} pixels")
    return data.tobytes()


def _morton(points: F64) -> NDArray[np.int64]:
    """(M,) positions along a z-order curve over x and y."""
    lower = points[:, :2].min(0)
    span = float((points[:, :2] - lower).max()) or 1.0
    q = ((points[:, :2] - lower) / span * 65535).astype(np.int64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        q = (q | q << shift) & mask
    return q[:, 0] | q[:, 1] << 1
