"""Pictures to what a model eats, and pixels of the model back to those of the picture."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.types import F32, F64, U8, Intrinsics
from realsim.feedforward.onnx.spec import Spec

MAX_PIXELS = 255_000
"""Of a view (Pi3 was trained up to this size; the others take less)."""
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
NORMS: dict[str, tuple[Any, Any]] = {
    "identity": (0.0, 1.0),
    "imagenet": (IMAGENET_MEAN, IMAGENET_STD),
    "half": (0.5, 0.5),
}


@dataclass(frozen=True)
class Grid:
    """Where a picture lies on the model's pixel grid: x_model = sx (x + 1/2) - 1/2 + ox, and so for y."""

    width: int
    height: int
    sx: float
    sy: float
    ox: float
    oy: float
    source: Intrinsics
    """Camera of the picture."""

    @property
    def camera(self) -> Intrinsics:
        """The picture's camera on the model's grid."""
        k = self.source
        cx, cy = (k.cx + 0.5) * self.sx - 0.5 + self.ox, (k.cy + 0.5) * self.sy - 0.5 + self.oy
        return Intrinsics(self.width, self.height, k.fx * self.sx, k.fy * self.sy, cx, cy)

    @property
    def content(self) -> tuple[slice, slice]:
        """Rows and columns that show the picture; the rest is padding."""
        top, left = max(round(self.oy), 0), max(round(self.ox), 0)
        bottom = min(round(self.oy + self.sy * self.source.height), self.height)
        right = min(round(self.ox + self.sx * self.source.width), self.width)
        return slice(top, bottom), slice(left, right)


def make_grid(camera: Intrinsics, spec: Spec) -> Grid:
    """The model's pixel grid for pictures of one camera.

    Height and width are multiples of the patch, near the picture's own size, at most MAX_PIXELS, or the fixed size.
    `resize` stretches by the rest (below a patch), `pad_white` keeps the shape and fills up, `crop` keeps the shape
    and cuts the border.
    """
    h, w = spec.fixed_hw or _near(camera, spec.patch)
    sx, sy = w / camera.width, h / camera.height
    if spec.fit == "resize":
        return Grid(w, h, sx, sy, 0.0, 0.0, camera)
    s = min(sx, sy) if spec.fit == "pad_white" else max(sx, sy)
    # The picture is resampled to whole pixels: the scale follows from them, not the other way round.
    cw, ch = round(camera.width * s), round(camera.height * s)
    return Grid(w, h, cw / camera.width, ch / camera.height, float((w - cw) // 2), float((h - ch) // 2), camera)


def _near(camera: Intrinsics, patch: int) -> tuple[int, int]:
    s = min(1.0, (MAX_PIXELS / (camera.width * camera.height)) ** 0.5)
    h, w = (max(patch, patch * round(s * v / patch)) for v in (camera.height, camera.width))
    while h * w > MAX_PIXELS and max(h, w) > patch:
        h, w = (h - patch, w) if h >= w else (h, w - patch)
    return h, w


def to_tensor(color: U8, grid: Grid, norm: str) -> F32:
    """(3, H, W) float32 of a picture (h, w, 3) on the model's grid, normalised; what is padded is white."""
    import cv2

    cw, ch = round(grid.sx * grid.source.width), round(grid.sy * grid.source.height)
    if (cw, ch) != (color.shape[1], color.shape[0]):
        # Averaging over what a pixel covers keeps the picture's borders in place, as the grid says.
        color = np.asarray(cv2.resize(color, (cw, ch), interpolation=cv2.INTER_AREA), np.uint8)
    canvas = np.full((grid.height, grid.width, 3), 255, np.uint8)
    rows, columns = grid.content
    top, left = max(-round(grid.oy), 0), max(-round(grid.ox), 0)
    canvas[rows, columns] = color[top : top + rows.stop - rows.start, left : left + columns.stop - columns.start]
    mean, std = NORMS[norm]
    return np.ascontiguousarray(
        ((canvas / np.float32(255) - np.float32(mean)) / np.float32(std)).transpose(2, 0, 1), np.float32
    )


def depth_to_grid(depth: F32, camera: Intrinsics, grid: Grid) -> F32:
    """(H, W) sensor depth on the model's grid by nearest pixel, 0 where there is none."""
    target = grid.camera
    u = np.round((np.arange(grid.width) - target.cx) / target.fx * camera.fx + camera.cx).astype(int)
    v = np.round((np.arange(grid.height) - target.cy) / target.fy * camera.fy + camera.cy).astype(int)
    rows, columns = np.clip(v, 0, camera.height - 1), np.clip(u, 0, camera.width - 1)
    inside = ((v >= 0) & (v < camera.height))[:, None] & ((u >= 0) & (u < camera.width))[None]
    return np.where(inside, depth[np.ix_(rows, columns)], 0).astype(np.float32)


def grid_to_depth(values: F32, valid: np.ndarray, grid: Grid, camera: Intrinsics) -> tuple[F32, np.ndarray]:
    """Values of the model's grid (H, W) on the pixels of a depth camera: (h, w) and where they are valid.

    Bilinear where all four neighbours are valid; nothing is made up between near and far.
    """
    import cv2

    source = grid.camera
    u = ((np.arange(camera.width) - camera.cx) / camera.fx * source.fx + source.cx).astype(np.float32)
    v = ((np.arange(camera.height) - camera.cy) / camera.fy * source.fy + source.cy).astype(np.float32)
    x, y = np.meshgrid(u, v)
    zero = np.where(valid, values, 0).astype(np.float32)
    # A border pixel's half outside has no second neighbour: it repeats the first.
    out = cv2.remap(zero, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    full = cv2.remap(valid.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rows, columns = grid.content
    inside = (x > columns.start - 0.51) & (x < columns.stop - 0.49) & (y > rows.start - 0.51) & (y < rows.stop - 0.49)
    return np.asarray(out, np.float32), (np.asarray(full) > 0.999) & inside


def camera_matrices(grids: list[Grid]) -> F64:
    """(N, 3, 3)."""
    return np.stack([g.camera.K for g in grids])
