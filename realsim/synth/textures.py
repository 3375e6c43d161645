"""Materials as square colour tiles, made from noise; they repeat without a seam."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from realsim.core.types import F32

TILE_M = {"floor": 6.0, "wall": 4.0}
"""Metres that a tile covers, 1.2 where not given."""
_PIXELS = {"floor": 2048}
_MATERIALS = ("wood", "cardboard", "osb", "concrete", "foam", "painted", "floor", "wall")


def tile_size(material: str) -> float:
    """Metres that one tile of the material covers."""
    return TILE_M.get(material, 1.2)


@cache
def tile(material: str, seed: int) -> F32:
    """(P, P, 3) RGB 0..1 of a material of `_MATERIALS`; floors and walls differ with the seed."""
    rng = np.random.default_rng([seed, 2, _MATERIALS.index(material)])
    n = _PIXELS.get(material, 1024)
    return np.clip({"floor": _floor, "wall": _wall}.get(material, _small)(rng, n, material), 0, 1).astype(np.float32)


def noise(rng: np.random.Generator, n: int, low: float, high: float) -> F32:
    """(n, n) band-passed noise of zero mean and unit variance that repeats: waves of `low` to `high` cycles a tile."""
    across = np.arange(min(int(high), n // 2) + 1)  # waves that the band has: the transforms need no others
    k = np.hypot(fft.fftfreq(n)[:, None] * n, across)
    spectrum = fft.fft(fft.rfft(rng.standard_normal((n, n)).astype(np.float32))[:, : len(across)], axis=0)
    spectrum *= (((k >= low) & (k <= high)) / np.maximum(k, 1)).astype(np.float32)
    out = fft.irfft(fft.ifft(spectrum, axis=0, overwrite_x=True), n)
    return out / out.std()


def _mix(base: tuple[float, float, float], *layers: NDArray) -> F32:
    """A base colour with grey layers added to it."""
    return np.asarray(base, np.float32) + np.asarray(sum(layers), np.float32)[..., None]


def _small(rng: np.random.Generator, n: int, material: str) -> NDArray:
    v = np.arange(n) / n
    if material == "wood":
        # Boards 12 cm wide; the grain is noise stretched along u.
        grain = np.repeat(noise(rng, n, 2, 300)[:, : n // 16], 16, axis=1)
        shade = rng.uniform(-0.05, 0.05, 10)[(v * 10).astype(int)][:, None]
        gap = -0.28 * ((v * 10) % 1 < 0.03)[:, None]
        return _mix((0.60, 0.46, 0.31), 0.05 * grain, 0.03 * noise(rng, n, 1, 12), shade + gap + np.zeros((1, n)))
    if material == "cardboard":
        return _prints(_mix((0.64, 0.50, 0.36), 0.02 * noise(rng, n, 2, 200)), rng)
    if material == "osb":
        chips = np.sign(noise(rng, n, 20, 60)) * 0.10 + np.sign(noise(rng, n, 30, 90)) * 0.06
        return _mix((0.63, 0.52, 0.34), chips, 0.03 * noise(rng, n, 60, 400))
    if material == "concrete":
        holes = -0.22 * (noise(rng, n, 30, 120) > 2.2)
        return _mix((0.54, 0.54, 0.53), 0.04 * noise(rng, n, 1, 30), 0.03 * noise(rng, n, 80, 400), holes)
    if material == "foam":
        hue = rng.uniform(0.15, 0.7, 3)
        return _mix(tuple(hue), 0.10 * noise(rng, n, 60, 300), 0.03 * noise(rng, n, 1, 8))
    hue = rng.uniform(0.25, 0.75, 3)
    return _prints(_mix(tuple(hue), 0.012 * noise(rng, n, 1, 40)), rng)


def _prints(image: NDArray, rng: np.random.Generator) -> NDArray:
    """Blocks of short dark marks, as on a printed box, and a strip of tape."""
    n = len(image)
    for _ in range(14):
        x, y = rng.integers(0, n - 140, 2)
        for row in range(rng.integers(3, 6)):
            at = x
            while at < x + 110:
                w = int(rng.integers(5, 20))
                image[y + row * 16 : y + row * 16 + 8, at : at + w] *= 0.35
                at += w + int(rng.integers(4, 10))
    y = int(rng.integers(200, n - 200))
    image[y : y + 52] = image[y : y + 52] * 0.75 + 0.2
    return image


def _floor(rng: np.random.Generator, n: int, material: str) -> NDArray:
    """Stone tiles of 0.5 m with joints, stains, specks, and strips of coloured tape."""
    u = np.arange(n) / n * 12 % 1
    joint = (np.abs(u - 0.5) > 0.492).astype(float)
    shade = np.kron(rng.uniform(-0.035, 0.035, (12, 12)), np.ones((n // 12 + 1, n // 12 + 1)))[:n, :n]
    stains, specks = 0.05 * noise(rng, n, 2, 60), -0.16 * (noise(rng, n, 150, 700) > 2.3)
    image = _mix((0.50, 0.50, 0.49), shade, stains, 0.02 * noise(rng, n, 200, 1000), specks)
    image *= 1 - 0.45 * np.maximum(joint[:, None], joint[None, :])[..., None]
    import cv2

    colors = ((0.82, 0.74, 0.20), (0.16, 0.34, 0.66), (0.82, 0.82, 0.80), (0.15, 0.15, 0.17))
    picture = np.ascontiguousarray(image)
    for i in range(26):
        a = rng.uniform(100, len(image) - 100, 2)
        angle, length = rng.uniform(0, np.pi), rng.uniform(40, 130)
        b = a + length * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(picture, a.astype(int).tolist(), b.astype(int).tolist(), colors[i % 4], int(rng.integers(8, 16)))
    return picture


def _wall(rng: np.random.Generator, n: int, material: str) -> NDArray:
    """Painted wall with a few posters, so that it is not featureless."""
    image = _mix((0.72, 0.71, 0.67), 0.012 * noise(rng, n, 1, 30), 0.008 * noise(rng, n, 100, 400))
    for _ in range(7):
        x, y = rng.integers(0, n - 220, 2)
        w, h = rng.integers(90, 200, 2)
        image[y : y + h, x : x + w] = rng.uniform(0.2, 0.8, 3) + 0.15 * noise(rng, n, 8, 90)[:h, :w, None]
    return image
