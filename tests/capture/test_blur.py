"""Widths of edges: laws that hold for any picture, and what becomes of a capture whose pictures are all smeared."""

import cv2
import numpy as np
import pytest

from realsim.capture.blur import SMEARED, edge_width
from realsim.capture.survey import Look, blurred, smeared


def picture(seed: int = 0, low: float = 40, high: float = 210) -> np.ndarray:
    """(240, 320) overlapping rectangles and discs with sensor noise: edges of all directions, one pixel wide."""
    rng = np.random.default_rng(seed)
    image = np.full((240, 320), 128, np.float32)
    for _ in range(60):
        x, y, size, angle = rng.integers(0, 320), rng.integers(0, 240), rng.integers(8, 50), rng.uniform(0, 180)
        box = cv2.boxPoints(((float(x), float(y)), (float(size), float(size) / 2), angle))
        cv2.fillPoly(image, [box.astype(np.int32)], float(rng.uniform(low, high)))
    return np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)


def along(length: int, degrees: float) -> np.ndarray:
    """Kernel of a smear over so many pixels."""
    t = np.linspace(-length / 2, length / 2, 50)
    x, y = t * np.cos(np.radians(degrees)), t * np.sin(np.radians(degrees))
    half = length // 2 + 1
    kernel, _, _ = np.histogram2d(y, x, np.arange(-half - 0.5, half + 1))
    return kernel / kernel.sum()


def test_sharp_edges_are_a_pixel_or_two_wide() -> None:
    width = edge_width(picture())
    assert width is not None
    assert 1 <= width < 2.5


@pytest.mark.parametrize("degrees", [0, 45, 90, 135, 20])
def test_a_smear_widens_edges_whatever_its_direction(degrees: float) -> None:
    widths = [edge_width(cv2.filter2D(picture(), -1, along(n, degrees))) for n in (3, 7, 15)]
    assert all(w is not None for w in widths)
    assert widths == sorted(widths)  # type: ignore[type-var]
    assert widths[1] > 3  # type: ignore[operator]
    assert widths[2] > SMEARED + 1  # type: ignore[operator]


def test_exposure_and_content_hardly_matter() -> None:
    full = edge_width(picture())
    assert edge_width((picture() * 0.5).astype(np.uint8)) == pytest.approx(full, rel=0.25)
    assert edge_width(picture(seed=1)) == pytest.approx(full, rel=0.25)


def test_a_plain_wall_has_no_edges() -> None:
    noise = np.random.default_rng(0).normal(120, 3, (240, 320))
    assert edge_width(noise.astype(np.uint8)) is None


def test_a_large_picture_is_judged_by_its_middle() -> None:
    large = np.zeros((1000, 1200), np.uint8)
    large[380:620, 440:760] = picture()
    assert edge_width(large) == pytest.approx(edge_width(picture()), rel=0.25)


def looks(widths: list[float | None], sharpness: list[float]) -> list[Look]:
    thumbnail = np.zeros((24, 32), np.float32)
    return [
        Look(f"f{k}", 1.0, (0.5, 2.0), 1.0, s, str(k), thumbnail, ((4, 4), (4, 4)), w)
        for k, (w, s) in enumerate(zip(widths, sharpness, strict=True))
    ]


def test_a_capture_that_is_blurred_throughout_is_told() -> None:
    said = smeared(looks([7.0, 6.0, 8.0, 2.0], [1.0] * 4))
    assert said is not None
    assert "3 of 4 pictures" in said
    assert smeared(looks([2.0, 2.0, 8.0], [1.0] * 3)) is None
    assert smeared(looks([None, None], [1.0] * 2)) is None


def test_a_picture_with_sharp_edges_is_not_dropped_for_its_plain_content() -> None:
    shares = [1.0, 1.0, 0.1, 1.0, 1.0]
    assert [d.name for d in blurred(looks([2.0, 2.0, 9.0, 2.0, 2.0], shares))] == ["f2"]
    assert [d.name for d in blurred(looks([2.0, 2.0, None, 2.0, 2.0], shares))] == ["f2"]
    assert blurred(looks([2.0] * 5, shares)) == []
