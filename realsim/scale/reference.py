"""Metres from a thing of known size in view: a printed tag, a sheet of paper, or two points whose distance is known.

A tag or sheet tells each frame its own distance by how large it looks (planar pose from four corners, Collins and
Bartoli 2014); that distance over the one that the pointmap has there is the frame's ratio. Two points are looked up in
the pointmaps, and their distance in all frames that see them both.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from realsim.core.errors import ScaleError
from realsim.core.geometry import invert_T, transform
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F64, U8, Frame, Intrinsics, Pointmaps, PointView
from realsim.scale.config import SHEETS, ScaleConfig

FAMILIES = ("APRILTAG_36h11", "APRILTAG_25h9", "6X6_250", "5X5_250", "4X4_50")
SMALLEST = 24.0
"""Pixels of a mark's shortest side, below which an error of its corners is an error of a percent."""
FIT_PX = 1.0
"""Largest error of a corner under the pose that was found, for a sheet's corners to be those of such a rectangle."""
TILTED = 0.01
"""Relative change of the ratio from the middle of a mark to its side beyond which its surface is not as the pose says:
the other orientation of a sheet, or another thing. 10 degrees on a sheet a metre away are 0.025."""
SURFACE = 0.03
"""Relative difference of depth within which the pixels about a point belong to one surface."""
INSIDE = np.array([(x, y) for x in (-0.6, -0.3, 0.0, 0.3, 0.6) for y in (-0.6, -0.3, 0.0, 0.3, 0.6)])
"""Places within a mark, of half its sides, where distances are compared."""


@dataclass(frozen=True)
class Reference:
    """What a thing of known size says."""

    ratios: F64
    """(N,) metres per unit, NaN in frames where it is not seen."""
    name: str
    sigma: float
    """Relative standard error that all frames share."""


def measure(points: Pointmaps, config: ScaleConfig) -> Reference | None:
    """The reference that the options name, in all frames; None where they name none.

    Raises:
        ScaleError: it is seen nowhere, or a point has no depth.
    """
    if config.known_length is not None:
        return _length(points, *config.known_length)
    if config.tag_size is not None:
        side = config.tag_size
        return _marks(points, lambda image: ((c, (side, side)) for c in _tags(image)), f"a tag of {side:g} m")
    if config.sheet is not None:
        size = SHEETS[config.sheet]
        name = f"a sheet of {config.sheet.upper() if config.sheet == 'a4' else config.sheet}"
        return _marks(points, lambda image: _sheets(image, size), name)
    return None


Detect = Callable[[U8], Iterator[tuple[F64, tuple[float, float]]]]
"""Gray image -> corners (4, 2) in pixels, in order, and the sides in metres from the first to the second and on."""


def _marks(points: Pointmaps, detect: Detect, name: str) -> Reference:
    def of_frame(i: int) -> float:
        import cv2

        frame = points.frames[i]
        color = frame.color()
        if color is None:
            return float("nan")
        found = list(detect(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)))
        view = points.load(i) if found else None
        ratios = [r for corners, size in found if view and (r := _ratio(frame, view, corners, size)) is not None]
        return float(np.median(ratios)) if ratios else float("nan")

    ratios = np.array(list(track(in_order(of_frame, len(points)), name, len(points))))
    own = np.nanmedian(ratios) if np.isfinite(ratios).any() else np.nan
    ratios[~(np.abs(np.log(ratios / own)) < 0.1)] = np.nan  # something else that looks alike
    if not np.isfinite(ratios).any():
        raise ScaleError(
            f"{name} is not seen",
            expected=f"it flat, unfolded, and at least {SMALLEST:.0f} pixels wide in some frames",
            found=f"none in {len(points)} frames",
            hint="go nearer, or give --known-length",
        )
    return Reference(ratios, f"{name} in {np.isfinite(ratios).sum()} frames", 0.0005)


def _ratio(frame: Frame, view: PointView, corners: F64, size: tuple[float, float]) -> float | None:
    """Metres per unit by one mark; None where it is too small, not such a rectangle, or has no depth."""
    import cv2

    camera = frame.color_intrinsics or frame.intrinsics
    sides = np.linalg.norm(np.roll(corners, -1, 0) - corners, axis=1)
    if sides.min() < SMALLEST:
        return None
    half = np.array(size) / 2
    model = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    flat = np.column_stack([model, np.zeros(4)])
    ok, turn, place = cv2.solvePnP(flat, corners, K, None, flags=cv2.SOLVEPNP_IPPE)
    if not ok:
        return None
    shown = cv2.projectPoints(flat, turn, place, K, None)[0][:, 0]
    if np.linalg.norm(shown - corners, axis=1).max() > FIT_PX:
        return None
    R = cv2.Rodrigues(turn)[0]
    inner = np.column_stack([INSIDE * half, np.zeros(len(INSIDE))]) @ R.T + place.ravel()
    inner += np.array([*frame.color_shift, 0.0])  # from the colour camera to the depth camera
    z = _looked_up(view, frame.intrinsics, inner[:, :2] / inner[:, 2:])
    known = z > 0
    if known.sum() < len(INSIDE) // 2:
        return None
    ratios = inner[known, 2] / z[known]
    middle = float(np.median(ratios))
    slopes = np.linalg.lstsq(np.column_stack([np.ones(len(ratios)), INSIDE[known]]), ratios, rcond=None)[0][1:]
    return middle if np.hypot(*slopes) < TILTED * middle else None


def _looked_up(view: PointView, camera: Intrinsics, xy: F64) -> F64:
    """(M,) z of a view's points at places (M, 2) on the plane z = 1, 0 where there are none."""
    height, width = view.mask.shape
    k = camera.resized(width, height)
    u, v = np.rint(xy * (k.fx, k.fy) + (k.cx, k.cy)).astype(int).T
    on = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    z = np.zeros(len(xy))
    z[on] = np.where(view.mask[v[on], u[on]], view.points[v[on], u[on], 2], 0)
    return z


def _tags(image: U8) -> Iterator[F64]:
    """Corners of printed tags of the usual families: found by OpenCV, whose corners lie a quarter of a pixel inside
    those that their black sides have."""
    import cv2

    for family in FAMILIES:
        book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{family}"))
        corners, _, _ = cv2.aruco.ArucoDetector(book).detectMarkers(image)
        if corners:
            exact = (_between_sides(np.asarray(c, float).reshape(4, 2), image) for c in corners)
            yield from (c for c in exact if c is not None)
            return


def _sheets(image: U8, size: tuple[float, float]) -> Iterator[tuple[F64, tuple[float, float]]]:
    """Light quadrilaterals as (corners, sides), each in both orientations: what is not the sheet has no such pose."""
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    block = max(image.shape[1] // 8 | 1, 3)
    lights = (
        cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1],
        cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, block, -10),
    )
    seen: list[F64] = []
    for light in lights:
        for contour in cv2.findContours(light, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
            corners = _quadrilateral(contour[:, 0].astype(float), image)
            if corners is None or any(np.abs(corners.mean(0) - c).max() < 3 for c in seen):
                continue
            seen.append(corners.mean(0))
            yield corners, size
            yield np.roll(corners, 1, 0), size


def _quadrilateral(contour: F64, image: U8) -> F64 | None:
    """(4, 2) corners, clockwise in the image, of a contour of four straight sides, to a fraction of a pixel."""
    import cv2

    length = cv2.arcLength(contour.astype(np.float32), True)
    if length < 4 * SMALLEST:
        return None
    rough = cv2.approxPolyDP(contour.astype(np.float32), 0.02 * length, True)[:, 0].astype(float)
    if len(rough) != 4 or not cv2.isContourConvex(rough.astype(np.float32)):
        return None
    edge = np.roll(rough, -1, 0) - rough
    if (edge[:, 0] * np.roll(edge, -1, 0)[:, 1] - edge[:, 1] * np.roll(edge, -1, 0)[:, 0]).sum() < 0:
        rough = rough[::-1]
    return _between_sides(rough, image)


def _between_sides(rough: F64, image: U8) -> F64 | None:
    """(4, 2) corners where the straight sides near rough ones meet; None where a side is no edge."""
    lines = []
    for a, b in zip(rough, np.roll(rough, -1, 0), strict=True):
        line = _edge_line(image, a, b)
        if line is None:
            return None
        lines.append(line)
    corners = [np.cross(lines[k - 1], lines[k]) for k in range(4)]
    return np.array([c[:2] / c[2] for c in corners]) if all(abs(c[2]) > 1e-9 for c in corners) else None


def _edge_line(image: U8, a: F64, b: F64) -> F64 | None:
    """The line (3,) along which the brightness across a side changes most, to a fraction of a pixel."""
    import cv2

    along = (b - a) / np.linalg.norm(b - a)
    across = np.array([-along[1], along[0]])
    steps = np.arange(-4, 4.01, 0.25)
    places = a + np.linspace(0.1, 0.9, 40)[:, None] * (b - a)
    at = places[:, None] + steps[:, None] * across
    x, y = np.moveaxis(at.astype(np.float32), 2, 0)
    profile = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR)
    slope = np.abs(np.diff(profile, axis=1))
    strength = slope.sum(1)
    if np.median(strength) < 15:
        return None
    middle = (slope**2 * (steps[1:] + steps[:-1]) / 2).sum(1) / np.maximum((slope**2).sum(1), 1e-9)
    on = places + middle[:, None] * across
    good = strength > 0.5 * np.median(strength)
    for _ in range(3):
        centre = on[good].mean(0)
        normal = np.linalg.svd(on[good] - centre)[2][1]
        off = np.abs((on - centre) @ normal)
        good = off < max(3 * float(np.median(off[good])), 0.2)
    return np.array([*normal, -normal @ centre]) if good.sum() >= 20 else None


def _length(points: Pointmaps, a: str, b: str, metres: float) -> Reference:
    """Two points, each named as FRAME:X,Y in pixels of its colour image, that lie `metres` apart."""
    (A, sigma_a), (B, sigma_b) = (_place(points, name) for name in (a, b))
    units = float(np.linalg.norm(A - B))
    if not units > 0:
        raise ScaleError("the two points of --known-length are one", found=f"{a} and {b}")
    sigma = float(np.hypot(sigma_a, sigma_b) / units)
    return Reference(np.full(len(points), metres / units), f"a known length of {metres:g} m", sigma)


def _place(points: Pointmaps, name: str) -> tuple[F64, float]:
    """Where a picked point lies in the world, units, and its standard error: half a pixel, and the frames' depth."""
    where, _, pixel = name.rpartition(":")
    frames = [f.name for f in points.frames]
    if where not in frames:
        raise ScaleError(
            "no such frame for --known-length",
            expected=f"FRAME:X,Y with a frame that is used ({', '.join(frames[:3])}, ...)",
            found=name,
        )
    i = frames.index(where)
    frame = points.frames[i]
    camera = frame.color_intrinsics or frame.intrinsics
    uv = np.array([float(word) for word in pixel.split(",")])
    ray = (uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    z = _near_surface(points.load(i), frame.intrinsics, ray)
    if z is None:
        raise ScaleError(
            "a point of --known-length has no depth",
            found=name,
            hint="pick it a few pixels inside the thing it belongs to, or in another frame",
        )
    way = points.T_world_camera[i][:3, :3] @ [*ray, 1.0]
    start = points.T_world_camera[i][:3, 3]
    depths = [z]
    for j in range(len(points)):
        # Other frames' depth of the same place, along the picked ray.
        seen = transform(invert_T(points.T_world_camera[j]), start + z * way)
        if j == i or seen[2] <= 0:
            continue
        other = _near_surface(points.load(j), points.frames[j].intrinsics, seen[:2] / seen[2])
        if other is not None and abs(other / seen[2] - 1) < SURFACE:
            depths.append(z * other / seen[2])
    middle = float(np.median(depths))
    spread = float(1.4826 * np.median(np.abs(np.array(depths) - middle))) if len(depths) > 2 else 0.01 * z
    return start + middle * way, float(np.hypot(spread / np.sqrt(len(depths)), 0.5 * z / camera.fx))


def _near_surface(view: PointView, camera: Intrinsics, xy: F64) -> float | None:
    """z of the nearer surface about a place on the plane z = 1: the edge of a thing belongs to the thing."""
    height, width = view.mask.shape
    k = camera.resized(width, height)
    u, v = np.rint(xy * (k.fx, k.fy) + (k.cx, k.cy)).astype(int)
    if not (3 <= u < width - 3 and 3 <= v < height - 3):
        return None
    window = (slice(v - 3, v + 4), slice(u - 3, u + 4))
    z = view.points[window][..., 2][view.mask[window]].astype(float)
    if len(z) < 10:
        return None
    near = float(np.percentile(z, 10))
    return float(np.median(z[np.abs(z / near - 1) < SURFACE]))
