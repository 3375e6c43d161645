"""Rays into a terrain: true depth, and a colour picture with texture, two lamps and soft shadows."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T, transform
from realsim.core.rays import raycasting_scene
from realsim.core.types import F32, F64, U8, Intrinsics
from realsim.synth.solids import Solid
from realsim.synth.textures import tile, tile_size

# A pixel's samples, in pixels about its centre, and for each a pattern of places on a ceiling light, in metres about
# its middle: neighbouring samples see other places, so that shadows have soft borders.
_SAMPLES = ((-0.25, -0.25), (0.25, 0.25))
_LAMP = np.array([[-0.35, -0.2, 0], [0.35, -0.2, 0], [-0.35, 0.2, 0], [0.35, 0.2, 0]])


class Renderer:
    """Casts rays (Embree, through Open3D) at solids in the simulation frame."""

    def __init__(self, solids: tuple[Solid, ...], intrinsics: Intrinsics, seed: int, lamps: F64 | None = None) -> None:
        """
        Args:
            lamps: (L, 3) middles of the ceiling lights, of which the nearest two light a point; None: two above the
                first solid.
        """
        from realsim.core.open3d import o3d

        self._tensor: Any = o3d.core.Tensor
        self.intrinsics = intrinsics
        self.seed = seed
        self.solids = solids
        counts = np.cumsum([0] + [len(s.vertices) for s in solids])
        V = np.vstack([s.vertices for s in solids])
        F = np.vstack([s.triangles + o for s, o in zip(solids, counts[:-1], strict=True)])
        self._scene = raycasting_scene(V, F)
        self._owner = np.repeat(np.arange(len(solids)), [len(s.triangles) for s in solids])
        self._normals = np.vstack([s.normals() for s in solids]).astype(np.float32)
        centre = V[F[self._owner == 0]].reshape(-1, 3).mean(0)
        self._lamps = centre + np.array([[1.2, 1.0, 2.5], [3.2, -1.4, 2.5]]) if lamps is None else lamps
        rng = np.random.default_rng([seed, 3])
        self._offsets = rng.uniform(0, 5, (len(solids), 2)).astype(np.float32)

    def depth(self, T_sim_camera: F64) -> F32:
        """(H, W) z depth in metres through the pixel centres, infinite where nothing is hit."""
        hit, _ = self._cast(self.intrinsics, T_sim_camera)
        # Ray directions have z = 1 in the camera, so the ray parameter is the depth along z.
        return hit["t_hit"].numpy()

    def color(self, T_sim_camera: F64) -> U8:
        """(H, W, 3) RGB, the mean of a few samples a pixel."""
        mean = sum(self._sample(T_sim_camera, i) for i in range(len(_SAMPLES))) / len(_SAMPLES)
        # sRGB-like tone curve: what is computed is linear light.
        return np.asarray((np.clip(mean, 0, 1) ** (1 / 2.2) * 255).round(), np.uint8)

    def _sample(self, T_sim_camera: F64, i: int) -> F32:
        """(H, W, 3) linear light at sample `i` of each pixel."""
        k, (du, dv) = self.intrinsics, _SAMPLES[i]
        hit, rays = self._cast(replace(k, cx=k.cx - du, cy=k.cy - dv), T_sim_camera)
        t = hit["t_hit"].numpy()
        seen = np.isfinite(t)
        triangle = np.where(seen, hit["primitive_ids"].numpy(), 0).astype(np.int64)
        points: Any = rays[..., :3] + np.where(seen, t, 0)[..., None] * rays[..., 3:]
        normals = self._normals[triangle]
        light: Any = self._albedo(points, normals, self._owner[triangle])
        light = light * self._light(points, normals, i)[..., None]
        light[~seen] = 0.02
        return light

    def visible(self, points: F64, normals: F64, T_sim_camera: F64) -> NDArray[np.bool_]:
        """(M,) which surface points (M, 3) the camera sees: inside the image, facing it, nothing in between."""
        eye = T_sim_camera[:3, 3]
        ok = self.intrinsics.pixels(transform(invert_T(T_sim_camera), points), near=0.2)[2]
        ok &= ((eye - points) * normals).sum(1) > 0
        rays = np.hstack([np.broadcast_to(eye, points[ok].shape), points[ok] - eye]).astype(np.float32)
        ok[ok] = ~self._scene.test_occlusions(rays, tnear=0.0, tfar=0.999).numpy()
        return ok

    def _cast(self, k: Intrinsics, T: F64) -> tuple[Any, F32]:
        d = k.rays() @ T[:3, :3].T.astype(np.float32)
        rays = np.concatenate([np.broadcast_to(T[:3, 3].astype(np.float32), d.shape), d], axis=-1)
        return self._scene.cast_rays(self._tensor(rays)), rays

    def _albedo(self, points: F32, normals: F32, owner: NDArray[np.int64]) -> F32:
        """Texture along the two axes of the solid that lie nearest to the face; linear light."""
        import cv2

        shape, points, normals, owner = points.shape, points.reshape(-1, 3), normals.reshape(-1, 3), owner.ravel()
        out = np.zeros_like(points)
        for i in np.unique(owner):
            solid, here = self.solids[i], np.flatnonzero(owner == i)
            R = solid.R.astype(np.float32)
            origin, offset = solid.texture_origin, self._offsets[i]
            if origin is None:
                p = points[here] @ R
            else:
                p, offset = (points[here] - origin.astype(np.float32)) @ R, np.zeros(2, np.float32)
            n = np.abs(normals[here] @ R)
            axis = n.argmax(1)
            uv = np.where(
                (axis == 0)[:, None], p[:, [1, 2]], np.where((axis == 1)[:, None], p[:, [0, 2]], p[:, [0, 1]])
            )
            picture = tile(solid.material, self.seed)
            at = ((uv + offset + 0.37 * axis[:, None]) / tile_size(solid.material) % 1) * len(picture)
            width = 4096
            pad = np.zeros((-len(at) % width, 2), np.float32)
            grid = np.vstack([at.astype(np.float32), pad]).reshape(-1, width, 2)
            sampled = cv2.remap(picture, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            out[here] = sampled.reshape(-1, 3)[: len(at)]
        return (out**2.2).reshape(shape)

    def _light(self, points: F32, normals: F32, i: int) -> F32:
        """Sky from above, and two ceiling lights with shadows: (H, W), linear."""
        total = 0.42 + 0.16 * normals[..., 2]
        h, w = points.shape[:2]
        place = ((np.arange(h) % 2)[:, None] * 2 + (np.arange(w) + np.arange(h)[:, None]) % 2 + i) % 4
        for lamp in self._nearest_lamps(points):
            source = lamp + _LAMP[place].astype(np.float32)
            start = points + 0.002 * normals
            ray = source - start
            distance = np.linalg.norm(ray, axis=-1)
            facing = np.maximum((ray * normals).sum(-1) / distance, 0)
            rays = np.concatenate([start, ray], axis=-1)
            lit = ~self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=0.98).numpy()
            total = total + 3.0 * facing * lit / (1 + distance**2 / 2)
        return total.astype(np.float32)

    def _nearest_lamps(self, points: F32) -> list[F32]:
        """The two lamps nearest to each point (H, W, 3), each (H, W, 3) or (3,)."""
        lamps = self._lamps.astype(np.float32)
        if len(lamps) <= 2:
            return list(lamps)
        away = np.stack([((points - lamp) ** 2).sum(-1) for lamp in lamps])
        order = np.argpartition(away, 1, axis=0)
        return [lamps[order[k]] for k in range(2)]
