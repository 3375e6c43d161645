"""Finds a white sheet of paper in a picture, with its corners to a fraction of a pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

AREA = (4_000, 120_000)
"""Pixels that the sheet may cover."""


def find_sheet(picture: np.ndarray) -> np.ndarray | None:
    """(4, 2) corners of the white quadrilateral that fills its outline best, or None if there is none.

    White depends on the exposure, so several thresholds are tried; walls touch the border of the picture and are
    left out by that.

    Args:
        picture: (H, W, 3) BGR.
    """
    import cv2

    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    best, best_fill = None, 0.9
    for value in range(90, 200, 10):
        for saturation in (30, 45, 60):
            white = ((hsv[..., 2] > value) & (hsv[..., 1] < saturation)).astype(np.uint8)
            white = cv2.morphologyEx(white, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
            contours, _ = cv2.findContours(white, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for contour in contours:
                quad = _quad(contour, picture.shape[:2])
                if quad is None:
                    continue
                fill = _fill(white, quad)
                if fill > best_fill:
                    best, best_fill = _sharpened(contour.reshape(-1, 2).astype(float), quad), fill
    return best


def _quad(contour: Any, shape: tuple[int, int]) -> np.ndarray | None:
    import cv2

    x, y, w, h = cv2.boundingRect(contour)
    if not AREA[0] < cv2.contourArea(contour) < AREA[1] or min(x, y, shape[1] - x - w, shape[0] - y - h) < 2:
        return None
    for share in (0.02, 0.03, 0.04):
        quad = cv2.approxPolyDP(cv2.convexHull(contour), share * cv2.arcLength(contour, True), True)
        if len(quad) == 4:
            return quad.reshape(4, 2).astype(float)
    return None


def _fill(white: np.ndarray, quad: np.ndarray) -> float:
    """Intersection over union of the white region's filled outline and the quadrilateral, digits inside forgiven."""
    import cv2

    inside = cv2.fillConvexPoly(np.zeros_like(white), quad.round().astype(np.int32), 1)
    ring = cv2.dilate(inside, np.ones((13, 13), np.uint8)) - cv2.dilate(inside, np.ones((5, 5), np.uint8))
    closed = cv2.morphologyEx(white, cv2.MORPH_CLOSE, np.ones((21, 21), np.uint8))
    return float(closed[inside > 0].mean() - white[ring > 0].mean())


def _sharpened(outline: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Corners as intersections of lines fitted to the outline's middle parts."""
    import cv2

    lines = []
    for a, b in zip(quad, np.roll(quad, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        t = (outline - a) @ along / np.linalg.norm(b - a)
        off = np.abs((outline - a) @ np.array([-along[1], along[0]]))
        side = outline[(t > 0.1) & (t < 0.9) & (off < 6)]
        if len(side) < 20:
            return quad
        vx, vy, x, y = cv2.fitLine(side.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
        out = np.array([-vy, vx]) * np.sign(np.array([-vy, vx]) @ ((a + b) / 2 - quad.mean(0)))
        # The outline runs through the outermost white pixels' centres: the edge lies half a pixel outside.
        lines.append((np.array([x, y]) + 0.5 * out, np.array([vx, vy])))
    corners = []
    for (p, u), (q, v) in zip([lines[-1], *lines[:-1]], lines, strict=True):
        s, _ = np.linalg.solve(np.column_stack([u, -v]), q - p)
        corners.append(p + s * u)
    return np.array(corners, float)
