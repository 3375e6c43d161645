"""Batches of views with their truth, made on the device that trains: scenes, cameras, light, pictures, sensor depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from realsim.core.errors import RealsimError
from training.pointmap import cameras, rays, sensor
from training.pointmap.draw import Draw
from training.pointmap.layouts import Library
from training.pointmap.textures import Materials, materials, paint

OBJECTS, FLOOR, WALL, CEILING = 5, 5, 6, 7
"""Materials of a scene: the first OBJECTS are shared by its primitives, then the room's."""
WITHOUT_DEPTH = 0.5
"""Share of scenes whose depth input is empty."""
MAX_REUSE = 64
"""Looks at one rendered batch."""
CPU_RAYS, GPU_RAYS = 4096, 2**20
"""Rays at once: what fits into a CPU's second cache, or into a few gigabytes with 54 primitives a ray."""
Cast = Callable[[rays.Solids, Tensor, Tensor], tuple[Tensor, Tensor]]
"""`rays.nearest`, or the same compiled."""


@dataclass(frozen=True)
class Batch:
    """B scenes of V views."""

    images: Tensor
    """(B, V, 3, H, W) RGB 0..1."""
    sensor: Tensor
    """(B, V, H, W) a sensor's depth along z, metres; 0 where there is none."""
    depth: Tensor
    """(B, V, H, W) true depth along z, metres; 0 where a ray leaves the scene."""
    K: Tensor
    """(B, V, 3, 3) pixels."""
    T: Tensor
    """(B, V, 4, 4) camera to the first camera of the scene, metres."""

    def local_points(self) -> Tensor:
        """(B, V, H, W, 3) true points in each camera's frame, metres."""
        return cameras.rays(self.K, self.size) * self.depth[..., None]

    def first_points(self) -> Tensor:
        """(B, V, H, W, 3) true points in the frame of the scene's first camera, metres."""
        R, t = self.T[..., :3, :3], self.T[..., :3, 3]
        return torch.einsum("bvij,bvhwj->bvhwi", R, self.local_points()) + t[:, :, None, None]

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.depth.shape[-2], self.depth.shape[-1]

    def with_inputs(self, *, images: bool = True, depth: bool = True, calibrated: bool = True) -> Batch:
        """The same scenes with inputs left out."""
        return Batch(
            self.images if images else torch.zeros_like(self.images),
            self.sensor if depth else torch.zeros_like(self.sensor),
            self.depth,
            self.K,
            self.T,
        )


@dataclass(frozen=True)
class Rendered:
    """Views before a camera's own faults."""

    light: Tensor
    """(B, V, 3, H, W) linear."""
    depth: Tensor
    """(B, V, H, W) metres; 0 in the sky."""
    K: Tensor
    """(B, V, 3, 3) pixels."""
    T: Tensor
    """(B, V, 4, 4) camera to the first camera, metres."""


class Generator:
    """Batch `index` of a seed is the same whenever and in whatever order it is requested."""

    def __init__(
        self,
        library: Library,
        seed: int,
        device: torch.device | str = "cpu",
        *,
        samples: int = 2,
        compiled: bool = False,
    ) -> None:
        """
        Args:
            samples: rays a pixel and view: the first gives the truth, all of them the light, spread over the pixel and
                over the time that the shutter is open.
            compiled: fuse the intersection by torch.compile.
        """
        if samples < 1:
            raise RealsimError("a pixel needs a ray", expected="samples of 1 or more", found=str(samples))
        self.seed, self.device, self.samples, self.compiled = seed, torch.device(device), samples, compiled
        self._centre, self._half, self._R, self._there = (
            torch.from_numpy(a).to(self.device) for a in (library.centre, library.half, library.R, library.there)
        )
        self.chunk = GPU_RAYS if self.device.type == "cuda" else CPU_RAYS

    def batch(self, index: int, scenes: int, views: int, size: tuple[int, int]) -> Batch:
        """Views of random scenes.

        Args:
            size: (H, W) pixels.
        """
        return self.observe(self.render(index, scenes, views, size), index)

    @torch.no_grad()
    def render(self, index: int, scenes: int, views: int, size: tuple[int, int]) -> Rendered:
        """What is slow: light and depth, before any camera has looked at them."""
        draw = Draw.of(self.seed, index, self.device)
        K = cameras.intrinsics(draw, scenes, size)
        T, later = cameras.path(draw, scenes, views)
        light, depth = self._render(draw, self._world(draw, T), K, T, later, size)
        every = K[:, None].expand(-1, views, -1, -1).contiguous()
        return Rendered(light, depth, every, cameras.inverse(T[:, :1]) @ T)

    @torch.no_grad()
    def observe(self, made: Rendered, index: int, again: int = 0) -> Batch:
        """Pictures and sensor depth of what was rendered; each `again` is another exposure, noise and sensor."""
        draw = Draw.of(self.seed + 1_000_000, MAX_REUSE * index + again, self.device)
        images = sensor.picture(draw, made.light)
        measured = sensor.depth(draw, made.depth, made.K[:, 0, 0, 0])
        blind = draw.chance(WITHOUT_DEPTH, len(images), 1) | draw.chance(0.08, *images.shape[:2])
        return Batch(images, torch.where(blind[..., None, None], 0.0, measured), made.depth, made.K, made.T)

    def _world(self, draw: Draw, T: Tensor) -> _World:
        """Layouts picked, scaled, mirrored and thinned, in rooms that hold all cameras; nothing stands in a camera's
        way."""
        b, device = len(T), self.device
        pick = draw.below(len(self._centre), b)
        grow = draw.log_uniform(0.8, 1.25, b, 1, 1) * draw.log_uniform(0.9, 1.1, b, 1, 3)
        grow = grow * torch.where(draw.chance(0.5, b, 1, 1), grow.new_tensor([1.0, -1.0, 1.0]), 1.0)
        centre, R = self._centre[pick] * grow, self._R[pick]
        # Stretched axes would not be orthogonal: half extents take the scale along their own axis instead.
        half = self._half[pick] * (R.abs() * grow.abs()[..., None]).sum(2) / R.abs().sum(2)
        R = R * torch.where(grow[..., 1:2] < 0, grow.new_tensor([1.0, -1.0, 1.0]), 1.0)[..., None]
        there = self._there[pick] & ~draw.chance(0.06, b, centre.shape[1])
        eyes = T[..., :3, 3]
        inside = torch.einsum("bpij,bvpj->bvpi", R.transpose(-1, -2), eyes[:, :, None] - centre[:, None])
        there &= ~(inside.abs() < half[:, None] + 0.2).all(-1).any(1)
        roomy = eyes.abs().amax(1)[:, :2] + draw.log_uniform(0.3, 4.0, b, 2)
        tall = torch.maximum(eyes[..., 2].amax(1) + 0.3, draw.uniform(2.2, 4.0, b))
        outdoors = draw.chance(0.15, b)
        room = torch.cat([roomy.clamp(min=2.0), tall[:, None]], -1)
        room = torch.where(outdoors[:, None], room.new_tensor([60.0, 60.0, 60.0]), room)
        which = draw.below(OBJECTS, b, centre.shape[1])
        which = torch.where(draw.chance(0.3, b, 1), which[:, :1].expand_as(which), which)
        around = draw.uniform(-torch.pi, torch.pi, b)
        lamp = torch.stack([around.cos(), around.sin(), draw.uniform(0.7, 3.0, b)], -1)
        lamp = torch.nn.functional.normalize(lamp, dim=-1) * draw.log_uniform(2.0, 500.0, b, 1)
        return _World(
            rays.solids(centre, half, R, there, room), outdoors, materials(draw, b, CEILING + 1), which, lamp,
            spots=torch.stack([draw.normal(1.5, b, 2), draw.normal(1.5, b, 2), draw.uniform(1.0, 2.5, b, 2)], -1),
            powers=torch.stack(
                [draw.log_uniform(0.3, 3, b), *draw.log_uniform(0.02, 1.0, 2, b), draw.log_uniform(0.15, 1.5, b)], -1
            ),
            tints=(1 + draw.normal(0.1, b, 4, 3)).clamp(0.5, 1.5),
            offset=draw.uniform(0, 20, b, centre.shape[1] + 6, 3).to(device),
        )  # fmt: skip

    def _render(
        self, draw: Draw, world: _World, K: Tensor, T: Tensor, later: Tensor, size: tuple[int, int]
    ) -> tuple[Tensor, Tensor]:
        """Linear light (B, V, 3, H, W) and depth (B, V, H, W)."""
        (b, v), (h, w) = T.shape[:2], size
        total, depth = torch.zeros(b, v, h * w, 3, device=self.device), torch.zeros(b, v, h * w, device=self.device)
        for k in range(self.samples):
            time = 0.0 if k == 0 else k / self.samples
            shift = draw.uniform(-0.5, 0.5, b, 2) * (k > 0)
            d = cameras.rays(K, size, shift).reshape(b, h * w, 3)
            step = -(-h * w // max(1, -(-b * h * w // self.chunk)))  # chunks of one size: the compiler knows it then
            for i in range(v):
                R, origin = self._between(T[:, i], later[:, i], time)
                turned = d @ R.transpose(1, 2)
                for at in range(0, h * w, step):
                    part = slice(at, at + step)
                    light, t = self._light(world, origin[:, None], turned[:, part], 1 / K[:, 0, 0])
                    total[:, i, part] += light / self.samples
                    if k == 0:
                        depth[:, i, part] = t
        return total.transpose(2, 3).reshape(b, v, 3, h, w), depth.reshape(b, v, h, w)

    @staticmethod
    def _between(T: Tensor, later: Tensor, time: float) -> tuple[Tensor, Tensor]:
        """Rotation (B, 3, 3) and place (B, 3) a share of the way between two near poses."""
        M = torch.lerp(T, later, time)
        x = torch.nn.functional.normalize(M[:, :3, 0], dim=-1)
        y = M[:, :3, 1] - (x * M[:, :3, 1]).sum(-1, keepdim=True) * x
        y = torch.nn.functional.normalize(y, dim=-1)
        return torch.stack([x, y, torch.linalg.cross(x, y)], -1), M[:, :3, 3]

    def _light(self, world: _World, o: Tensor, d: Tensor, pixel: Tensor) -> tuple[Tensor, Tensor]:
        """Light (B, N, 3) that arrives along rays, and depth (B, N), 0 for the sky."""
        scene, first = world.solids, _compiled() if self.compiled else rays.nearest
        t, which = first(scene, o, d)
        t_room, face = rays.walls(scene, o, d)
        room = t_room < t
        t = torch.minimum(t, t_room)
        p = o + d * t[..., None]
        normal, local = rays.surface(scene, p, which)
        axis = torch.where(face < 2, 2, torch.where(face < 4, 0, 1))
        inward = torch.nn.functional.one_hot(axis, 3) * (1.0 - 2.0 * (face % 2))[..., None]
        normal = torch.where(room[..., None], inward, normal)
        rows = torch.arange(len(p), device=p.device)[:, None]
        slot = torch.where(room, face + scene.centre.shape[1], which)
        local = torch.where(room[..., None], p, local) + world.offset[rows, slot]
        own = torch.where(face == 0, FLOOR, torch.where(face == 1, CEILING, WALL))
        material = torch.where(room, own, world.which[rows, which])
        slant = (rays.dot(d, normal) / rays.length(d))[..., 0].abs()
        footprint = t * pixel[:, None] / slant.clamp(min=0.15)
        color, tilt, gloss = paint(world.materials, material, local, footprint)
        normal = rays.unit_length(normal + tilt)
        light = color * self._arriving(world, first, p, normal, d, gloss)
        sky = room & world.outdoors[:, None] & (face > 0)
        glow = (0.4 + 0.6 * rays.unit_length(d)[..., 2:].clamp(min=0)) * world.tints[:, None, 3]
        return torch.where(sky[..., None], 1.5 * glow, light), torch.where(sky, 0.0, t)

    @staticmethod
    def _arriving(world: _World, first: Cast, p: Tensor, n: Tensor, d: Tensor, gloss: Tensor) -> Tensor:
        """(B, N, 3) light on the surface: the lamp with its shadow and highlight, two spots, and from all around."""
        to_lamp = world.lamp[:, None] - p
        beam = rays.unit_length(to_lamp)
        hit, _ = first(world.solids, p + 2e-3 * n, to_lamp)
        lit = rays.dot(n, beam).clamp(min=0) * (hit > 1)[..., None]
        half = rays.unit_length(beam - rays.unit_length(d))
        shine = gloss[..., None] * rays.dot(n, half).clamp(min=0) ** 30 * (hit > 1)[..., None] * 4
        strength = (world.lamp.norm(dim=-1)[:, None, None] / rays.length(to_lamp)) ** 2
        total = world.powers[:, None, :1] * world.tints[:, None, 0] * (lit + shine) * strength.clamp(max=4)
        for k in range(2):
            way = world.spots[:, None, k] - p
            far = rays.length(way).clamp(min=0.2)
            facing = (rays.dot(n, way) / far).clamp(min=0)
            total = total + world.powers[:, None, 1 + k, None] * world.tints[:, None, 1 + k] * facing * 2 / far**2
        around = world.powers[:, None, 3:] * (0.6 + 0.4 * n[..., 2:]) * world.tints[:, None, 3]
        corner = (0.55 + 1.5 * p[..., 2:].clamp(min=0)).clamp(max=1)  # less of the sky is seen from near the ground
        return total + around * corner


@dataclass(frozen=True)
class _World:
    solids: rays.Solids
    outdoors: Tensor
    """(B,) whether the walls are sky."""
    materials: Materials
    which: Tensor
    """(B, P) material of each primitive."""
    lamp: Tensor
    """(B, 3) near or far away; the one light with shadows."""
    spots: Tensor
    """(B, 2, 3)."""
    powers: Tensor
    """(B, 4) of lamp, spots and surroundings."""
    tints: Tensor
    """(B, 4, 3)."""
    offset: Tensor
    """(B, P + 6, 3) where in its material each primitive and face of the room lies."""


@cache
def _compiled() -> Cast:
    torch._dynamo.config.recompile_limit = 64  # scenes and rays come in a few sizes; beyond it, it would give up
    return torch.compile(rays.nearest)
