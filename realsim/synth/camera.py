"""A camera in a walking person's hands, and what a stereo depth sensor makes of true depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import F32, F64, Bool, Intrinsics

INTRINSICS = Intrinsics(640, 480, 615.0, 615.0, 318.5, 241.5)
"""Like a RealSense D435i's colour camera at 640x480, to which depth is aligned."""
STEREO_F_B = 19.25
"""Focal length times baseline of that sensor, pixels x metres."""

KINECT_DEPTH = Intrinsics(640, 480, 585.0, 585.0, 319.5, 239.5)
"""The depth camera of 7-Scenes, which is the only one that its page names."""


@dataclass(frozen=True)
class Rig:
    """A depth and a colour camera that look the same way."""

    depth: Intrinsics
    color: Intrinsics
    T_depth_color: F64
    """(4, 4) where the colour camera stands, depth camera's axes."""


def rig(sensor: str, width: int, rng: np.random.Generator) -> Rig:
    """The cameras of a sensor of `SynthConfig`, with images `width` pixels wide."""
    size = (width, width * 3 // 4)
    if sensor == "d435i":
        camera = INTRINSICS.resized(*size)
        return Rig(camera, camera, np.eye(4))
    # Of one Kinect to the next: focal length about 525, centre off by some pixels, 25 mm beside the depth camera.
    f, (cx, cy) = 525 * rng.uniform(0.99, 1.01), np.array([319.5, 239.5]) + rng.uniform(-8, 8, 2)
    color = Intrinsics(640, 480, f, f, cx, cy)
    T = make_T(exp_so3(rng.normal(0, 0.003, 3)), [rng.uniform(0.02, 0.028), rng.normal(0, 0.002), 0.0])
    return Rig(KINECT_DEPTH.resized(*size), color.resized(*size), T)


def drift(count: int, metres: float, rng: np.random.Generator) -> F64:
    """(count, 4, 4) motions by which a tracker's poses are off, camera's axes: smooth, `metres` and 0.3 degrees a
    centimetre RMS."""
    s = np.linspace(0, 1, count)
    wander = np.stack([_sway(rng, s, 1.0) for _ in range(6)], 1)
    wander /= np.maximum(np.sqrt((wander**2).sum(1).mean() / 2), 1e-9)
    turn = np.radians(30 * metres)
    return np.stack([make_T(exp_so3(turn * w[3:]), metres * w[:3]) for w in wander])


SWAY = (0.03, 0.03, 0.03, 0.05, 0.05, 0.04, 0.04)
"""Metres of the eye (3) and of the point looked at (3), and radians of roll, by which a hand sways."""


def follow_route(eyes: F64, aims: F64, count: int, rng: np.random.Generator, amplitudes: Sequence[float] = SWAY) -> F64:
    """(count, 4, 4) poses along a way (K, 3) with the points (K, 3) looked at; the hand sways a little."""
    from scipy.interpolate import PchipInterpolator

    at = np.r_[0, np.cumsum(np.linalg.norm(np.diff(eyes, axis=0), axis=1))]
    s = np.linspace(0, 1, count)
    eye, aim = (PchipInterpolator(at / at[-1], points)(s) for points in (eyes, aims))
    sway = np.stack([_sway(rng, s, a) for a in amplitudes], 1)
    return np.stack([look_at(eye[i] + sway[i, :3], aim[i] + sway[i, 3:6], sway[i, 6]) for i in range(count)])


def look_at(eye: F64, target: F64, roll: float = 0.0) -> F64:
    """(4, 4) pose of a camera at `eye` (3,) that looks at `target` (3,), OpenCV axes, world z up, roll in radians."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return make_T(np.column_stack([x, np.cross(z, x), z]) @ exp_so3([0, 0, roll]), eye)


def walk(bounds: F64, count: int, rng: np.random.Generator, *, both_sides: bool = False) -> F64:
    """(count, 4, 4) poses of a walk around the terrain, simulation frame.

    The first view stands behind the start platform and looks toward the goal; then the camera goes along the right
    side and, with `both_sides`, around the goal and back along the left one. The hand sways by a few centimetres and
    degrees, smoothly along the path whatever the number of frames.

    Args:
        bounds: (2, 3) of the terrain.
    """

    low, high = bounds
    length, height = high[0] - low[0], 1.12 + high[2]
    right = low[1] - 0.62
    eyes = [(low[0] - 0.75, 0.05, height + 0.1), (low[0] - 0.45, right + 0.25, height)]
    aims = [(low[0] + 0.35 * length, 0.0, -0.15), (low[0] + 0.25 * length, 0.0, -0.2)]
    along = np.linspace(0.05, 0.97, 7)
    eyes += [(low[0] + a * length, right, height) for a in along]
    aims += [(low[0] + min(a + 0.09, 1.0) * length, 0.0, -0.2) for a in along]
    eyes.append((high[0] + 0.55, right + 0.35, height))
    aims.append((high[0] - 0.3 * length, 0.0, -0.2))
    if both_sides:
        left = high[1] + 0.62
        eyes.append((high[0] + 0.55, left - 0.35, height))
        aims.append((high[0] - 0.3 * length, 0.0, -0.2))
        eyes += [(low[0] + a * length, left, height) for a in along[::-1]]
        aims += [(low[0] + max(a - 0.09, 0.0) * length, 0.0, -0.2) for a in along[::-1]]
    return follow_route(np.array(eyes), np.array(aims), count, rng, (0.03, 0.03, 0.035, 0.06, 0.05, 0.04, 0.05))


def _sway(rng: np.random.Generator, s: F64, amplitude: float) -> F64:
    """A smooth random function of the share of the path: a few sines of random phase."""
    cycles, phase = rng.uniform(3, 11, 4), rng.uniform(0, 2 * np.pi, 4)
    return amplitude / 2 * np.sin(2 * np.pi * np.outer(s, cycles) + phase).sum(1)


@dataclass(frozen=True)
class DepthSensor:
    """Errors of a stereo depth camera."""

    scale: float = 1.0
    """Measured over true depth (a calibration error)."""
    sigma: float = 0.0018
    """Range noise over depth squared, 1/m: noise is constant in disparity."""
    step: float = 1 / 32
    """Steps of disparity, pixels."""
    lateral: float = 0.45
    """Standard deviation of where a depth pixel really looks, pixels."""
    holes: float = 0.02
    """Share of the image lost in blobs."""
    near: float = 0.28
    far: float = 6.0

    def measure(self, depth: F32, rng: np.random.Generator) -> NDArray[np.uint16]:
        """(H, W) millimetres, 0 where nothing is measured, of true z depth (H, W) metres (infinite where empty)."""
        import cv2

        h, w = depth.shape
        true = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
        v, u = np.indices((h, w), np.float32)
        du, dv = (rng.normal(0, self.lateral, (2, h, w))).astype(np.float32)
        z: Any = cv2.remap(true, u + du, v + dv, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        kernel = np.ones((3, 3), np.uint8)
        high: Any = cv2.dilate(true, kernel)
        low: Any = cv2.erode(true, kernel)
        edge = (high - low) > 0.04 * low
        # A third of the pixels on an edge land between the near and the far surface.
        mix = rng.random(z.shape).astype(np.float32)
        z = np.where(edge & (rng.random(z.shape) < 0.3), low + mix * (np.minimum(high, 6) - low), z)
        noise = cv2.GaussianBlur(rng.standard_normal((h, w)).astype(np.float32), (0, 0), 0.8)
        disparity = STEREO_F_B / (z * self.scale) + noise / noise.std() * self.sigma * STEREO_F_B
        disparity = np.maximum(np.round(disparity / self.step), 1) * self.step
        out = STEREO_F_B / disparity
        lost = edge & (rng.random((h, w)) < 0.45) | _blobs(rng, h, w, self.holes) | (rng.random((h, w)) < 0.002)
        out = np.where(lost | (out < self.near) | (out > self.far), 0, out)
        return np.round(out * 1000).astype(np.uint16)

    def exact(self, depth: F32) -> NDArray[np.uint16]:
        """(H, W) millimetres with the scale error alone."""
        z = np.where(np.isfinite(depth) & (depth < self.far), depth * self.scale, 0)
        return np.round(z * 1000).astype(np.uint16)


def _blobs(rng: np.random.Generator, h: int, w: int, share: float) -> Bool:
    import cv2

    if share <= 0:
        return np.zeros((h, w), bool)
    field = cv2.GaussianBlur(rng.standard_normal((h, w)).astype(np.float32), (0, 0), 3.0)
    return np.asarray(field > np.quantile(field, 1 - share))
