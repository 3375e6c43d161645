"""A tag, a sheet or a measured length in view set the scale: rendered frames whose depth is off by a known factor."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from realsim.core.errors import ScaleError
from realsim.core.types import Frame, Intrinsics, Pointmaps, PointView
from realsim.scale import to_metric
from realsim.scale.config import ScaleConfig
from realsim.synth.camera import look_at

CAMERA = Intrinsics(640, 480, 610.0, 610.0, 318.0, 243.0)
TEXELS = {"tag": 1500.0, "a4": 2000.0, "letter": 40 / 0.0254, "nothing": 1500.0}
"""Texels a metre of the rendered floor, of which each thing has a whole number."""


def floor_with(thing: str) -> np.ndarray:
    """A gray floor of 2.4 x 2.4 m, its middle at the origin, with a thing of known size on it."""
    rng = np.random.default_rng(3)
    texels = TEXELS[thing]
    coarse = cv2.resize(
        rng.uniform(70, 130, (150, 150)).astype(np.float32), (3600, 3600), interpolation=cv2.INTER_CUBIC
    )
    image = np.clip(coarse, 40, 150).astype(np.uint8)
    middle = image.shape[0] // 2
    if thing == "tag":
        side = round(0.16 * texels)
        book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        border = round(0.02 * texels)
        tag = np.pad(cv2.aruco.generateImageMarker(book, 7, side), border, constant_values=240)
        h = tag.shape[0] // 2
        image[middle - h : middle - h + tag.shape[0], middle - h : middle - h + tag.shape[0]] = tag
    elif thing != "nothing":
        w, h = (round(v * texels / 2) for v in ((0.297, 0.210) if thing == "a4" else (0.2794, 0.2159)))
        image[middle - h : middle + h, middle - w : middle + w] = 235
    return image


def capture(thing: str, off: float, count: int = 16, units: float = 1.0) -> Pointmaps:
    """Frames about the thing; depth is `off` times the truth with the noise of a RealSense, as are the pointmaps."""
    texture = floor_with(thing)
    frames, views, poses = [], [], []
    K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    pitch, half = 1 / TEXELS[thing], texture.shape[0] / 2
    to_floor = np.array([[pitch, 0, -half * pitch], [0, -pitch, half * pitch], [0, 0, 1]])
    for i in range(count):
        rng = np.random.default_rng([1, i])
        turn = 2 * np.pi * i / count
        away = rng.uniform(0.7, 1.1)
        eye = np.array([away * np.cos(turn), away * np.sin(turn), rng.uniform(0.7, 1.2)])
        T = look_at(eye, np.zeros(3))
        R, t = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        H = K @ np.column_stack([R[:, 0], R[:, 1], t]) @ to_floor
        fine = np.diag([3.0, 3.0, 1.0]) @ H  # three times as fine, then averaged: pixels have an area
        shown = cv2.warpPerspective(texture, fine, (1920, 1440), flags=cv2.INTER_AREA, borderValue=100)
        gray = cv2.GaussianBlur(cv2.resize(shown, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
        gray = np.clip(gray + rng.normal(0, 2, gray.shape), 0, 255).astype(np.uint8)
        rays = CAMERA.rays().astype(float)
        z = -T[2, 3] / (rays @ T[2, :3])
        depth = (z * off + rng.normal(0, 0.002, z.shape) * z**2).astype(np.float32)
        rgb = np.repeat(gray[..., None], 3, 2)
        frames.append(Frame(f"f{i}", CAMERA, lambda d=depth: d, lambda c=rgb: c))
        points = (rays * (depth / units)[..., None]).astype(np.float32)
        views.append(PointView(points, np.ones(z.shape, np.float32), np.ones(z.shape, bool)))
        T[:3, 3] *= off / units
        poses.append(T)
    return Pointmaps(tuple(frames), np.stack(poses), lambda i: views[i], "made", False)


CONFIGS = {"tag": ScaleConfig(tag_size=0.16), "a4": ScaleConfig(sheet="a4"), "letter": ScaleConfig(sheet="letter")}


@pytest.mark.parametrize(("thing", "off", "units"), [("tag", 0.993, 1.0), ("a4", 1.008, 1.0), ("tag", 1.0, 3.0)])
def test_a_thing_of_known_size_sets_the_scale(thing, off, units):
    scale = to_metric(capture(thing, off, units=units), replace(CONFIGS[thing], bootstrap=200)).scale
    assert scale.value == pytest.approx(units / off, rel=0.002)
    assert scale.ci90[0] < units / off < scale.ci90[1] or abs(scale.value * off / units - 1) < 0.001
    assert "in 1" in scale.method


def test_a_known_length_sets_the_scale():
    points = capture("a4", 0.992)
    T = points.T_world_camera.copy()
    names = []
    # Two marks on the floor, each picked in another frame to half a pixel.
    for i, corner in ((2, [-0.4, 0.3, 0]), (9, [0.4, -0.3, 0])):
        eye = T[i][:3, 3] / 0.992
        seen = T[i][:3, :3].T @ (np.array(corner) - eye)
        u, v = seen[:2] / seen[2] * 610 + (318, 243)
        names.append(f"f{i}:{round(2 * u) / 2},{round(2 * v) / 2}")
    scale = to_metric(points, ScaleConfig(known_length=(names[0], names[1], 1.0), bootstrap=200)).scale
    assert scale.value == pytest.approx(1 / 0.992, rel=0.002)
    assert scale.method == "a known length of 1 m"


def test_depth_that_disagrees_is_named():
    scale = to_metric(capture("tag", 0.96), replace(CONFIGS["tag"], bootstrap=200)).scale
    assert any("sensor depth says" in w for w in scale.warnings)


@pytest.mark.parametrize("config", [ScaleConfig(tag_size=0.16), ScaleConfig(sheet="letter")])
def test_what_is_not_there_is_refused(config):
    with pytest.raises(ScaleError, match="not seen"):
        to_metric(capture("nothing" if config.tag_size else "tag", 1.0, count=4), config)


@pytest.mark.parametrize(
    "options",
    [
        {"known_length": ("f1", "f2:3,4", 1.0)},
        {"known_length": ("f1:1,2", "f2:3,4", 0.0)},
        {"tag_size": 16.0},
        {"tag_size": 0.1, "sheet": "a4"},
    ],
)
def test_options_that_cannot_be(options):
    with pytest.raises(ValueError, match=r"known_length|tag_size"):
        ScaleConfig(**options)


def test_a_frame_that_is_not_there():
    with pytest.raises(ScaleError, match="no such frame"):
        to_metric(capture("tag", 1.0, count=3), ScaleConfig(known_length=("x:1,2", "f1:3,4", 1.0)))
