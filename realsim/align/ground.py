"""Selects the ground plane, with its uncertainty and the evidence against it."""

from dataclasses import dataclass

import numpy as np

from realsim.align.cloud import Cloud
from realsim.align.planes import Plane, find_planes, plane_axes, plane_weights
from realsim.core.errors import AlignError
from realsim.core.statistics import resampled
from realsim.core.types import F64, Gravity

BELOW = 0.04
"""Metres under a plane beyond which a point counts as lying below it."""
HINT_DEG = 25.0
"""The ground lies within this angle of a direction up that the source gives."""
LEVEL_COS = float(np.cos(np.radians(HINT_DEG)))
FITS = 0.25
"""Share of the best ground's score that a ground level to an axis of the file has for that axis to be believed. Checked
on made slabs of 5 to 300 mm in five orientations (70 of 70 upright); a bare slab in an upside-down file fails."""
SIDEWAYS = 0.35
"""Factor on the likelihood of a ground for which the camera was held sideways or upside down."""
DOUBTFUL, IMPLAUSIBLE = 0.2, 0.05
"""Share of its extent that a ground keeps as its score: below the one it is warned of, below the other refused."""
RIVAL = 0.6
"""A plane that scores this share of the best one is a rival worth a word."""
STAGE = 2.5
"""m²: a level plane above the ground that is larger than platforms are might be a ground of its own."""
HIGHEST_STAGE = 1.5
"""Metres above the ground beyond which a level plane is a table or a ceiling, not a ground."""
BLOCK, FEW_BLOCKS = 1.0, 6
"""Metres of a block of ground whose points share their errors, and how few say little about themselves."""


@dataclass(frozen=True)
class Ground:
    """The chosen plane and what was thought about it."""

    plane: Plane
    gravity: Gravity
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]
    candidates: tuple[dict[str, float], ...]
    """Figures of all candidates, the chosen one first, JSON-able."""


def find_ground(cloud: Cloud, seed: int, up_world: F64 | None = None) -> Ground:
    """Choose the ground among the cloud's planes.

    A candidate scores by its extent, times how far the rest of the scene lies above it, times how plausible the
    cameras' height over it and their roll about it are. `up_world`, where the source knows it, rules out the rest.

    Raises:
        AlignError: no plane can be the ground, or two inclined planes could both be.
    """
    planes = [q for p in find_planes(cloud, seed) for q in _sides(p, cloud)]
    if not planes:
        raise AlignError(
            "no ground is visible",
            expected="a flat surface of at least 0.3 m² below the cameras",
            found=f"no plane of that size in {len(cloud)} voxels",
            hint="capture the floor around the terrain too",
        )
    assumptions: list[str] = []
    guess: list[str] = []
    hint = up_world
    if hint is None and not cloud.held:
        hint, assumption, guess = _scan_up(planes, cloud)
        assumptions.append(assumption)
    scored = sorted(((_score(p, cloud, hint), p) for p in planes), key=lambda s: -s[0]["score"])
    best, plane = scored[0]
    if best["plausibility"] < IMPLAUSIBLE:
        raise AlignError(
            "no ground is visible",
            expected="a large plane with the cameras above it and the rest of the scene on it",
            found="; ".join(_described(figures) for figures, _ in scored[:4]),
            hint="capture the floor around the terrain too, not only from straight above",
        )
    warnings = guess + _rivals(scored, cloud, up_world is not None)
    warnings += _upside_down(plane, cloud)
    if best["plausibility"] < DOUBTFUL:
        warnings.append(f"the ground is doubtful, it may be a wall: {_described(best)}")
    sigma = tilt_sigma_deg(cloud, plane, seed)
    gravity = Gravity(
        normal_world=plane.normal,
        offset_world=plane.offset,
        tilt_sigma_deg=sigma,
        inlier_rms_m=plane.rms,
        inliers=int(plane.inliers.sum()),
        method="largest level plane below the cameras" if cloud.held else "largest level plane of the scan",
    )
    return Ground(plane, gravity, tuple(assumptions), tuple(warnings), tuple(figures for figures, _ in scored))


def _sides(plane: Plane, cloud: Cloud) -> list[Plane]:
    """The plane as it was seen; both its sides where the cloud does not know."""
    flipped = Plane(-plane.normal, -plane.offset, plane.inliers, plane.rms, plane.area)
    return [plane] if cloud.oriented else [plane, flipped]


def _scan_up(planes: list[Plane], cloud: Cloud) -> tuple[F64, str, list[str]]:
    """(up, what was assumed, warnings) for a scan that does not say: an axis of the file, +z before +y, that fits.

    It fits if a plane that is level to it, roughly, scores nearly as a ground could at best; otherwise the best plane
    is level.
    """
    scores = [_score(p, cloud, None)["score"] for p in planes]
    best = max(scores)
    fitting = [
        (name, np.eye(3)[axis])
        for axis, name in ((2, "z"), (1, "y"))
        if any(p.normal[axis] > LEVEL_COS and s >= FITS * best for p, s in zip(planes, scores, strict=True))
    ]
    if not fitting:
        up = planes[int(np.argmax(scores))].normal
        numbers = " ".join(f"{v + 0.0:.2f}" for v in np.round(up, 2))
        return (
            up,
            "the scan gives no direction up and no axis of it fits: the most likely ground was taken as level",
            [
                f"up is a guess: {numbers} of the file was taken. Is that right? If not, turn the file until its z or "
                "y axis points up"
            ],
        )
    (name, up), *_ = fitting
    assumption = f"the scan gives no direction up: the file's +{name} was taken, roughly"
    level = max(s for p, s in zip(planes, scores, strict=True) if p.normal @ up > LEVEL_COS)
    if level == best:
        return up, assumption, []
    other = " ".join(f"{v + 0.0:.2f}" for v in np.round(planes[int(np.argmax(scores))].normal, 2))
    return (
        up,
        assumption,
        [f"the file's +{name} was taken as up, though {other} would suit the scene better: is that right?"],
    )


def _score(plane: Plane, cloud: Cloud, up: F64 | None) -> dict[str, float]:
    height = plane.height(cloud.points)
    if cloud.closed:
        height = height[cloud.normals @ plane.normal > -0.5]
    above = float(np.mean(height > -BELOW))
    figures = {"area_m2": plane.area, "share_above": above, "rms_m": plane.rms}
    score = plane.area * max(0.0, (above - 0.5) / 0.5) ** 2
    if len(cloud.cameras):
        figures["camera_height_m"] = float(np.median(plane.height(cloud.cameras[:, :3, 3])))
        score *= _plausible_height(figures["camera_height_m"])
        if up is None and cloud.held:
            score *= _plausible_hold(cloud.cameras[:, :3, :3], plane.normal, figures)
    if up is not None:
        angle = float(np.degrees(np.arccos(np.clip(plane.normal @ up / np.linalg.norm(up), -1, 1))))
        figures["angle_to_given_up_deg"] = angle
        score *= float(np.exp(-((angle / 10) ** 2))) if angle < HINT_DEG else 0.0
    figures["score"] = float(score)
    figures["plausibility"] = float(score / plane.area)
    return figures


def _plausible_hold(R: F64, normal: F64, figures: dict[str, float]) -> float:
    """How well a plane fits the way people hold cameras, 0..1: with a level horizon, not looking straight down.

    A wall that fills the view looks like a floor from above; what tells them apart is that a camera seldom looks
    straight down and that the side of the image stored as upper is mostly up.

    Args:
        R: (N, 3, 3) camera rotations.
        figures: the angles are added to it.
    """
    right, down, view = np.abs(R[:, :, 0] @ normal), R[:, :, 1] @ normal, R[:, :, 2] @ normal
    roll = float(min(np.mean(right), np.mean(np.abs(down))))  # sideways is as level as upright
    pitch, upright = float(np.mean(-view)), float(np.mean(-down))
    figures["camera_roll_deg"] = float(np.degrees(np.arcsin(min(1.0, roll))))
    figures["camera_pitch_down_deg"] = float(np.degrees(np.arcsin(np.clip(pitch, -1, 1))))
    figures["camera_upright"] = upright
    level = float(np.exp(-((roll / 0.35) ** 2)))
    steep = float(np.clip((1 - pitch) / 0.15, 0.1, 1.0))  # full up to 58 degrees down
    return level * steep * (1.0 if upright > 0.15 else SIDEWAYS)


def _plausible_height(height: float) -> float:
    """1 for a camera 0.2 to 2.5 m above the ground, falling off above; 0 below it."""
    if height <= 0.05:
        return 0.0
    return float(np.clip(height / 0.2, 0.1, 1.0) * np.clip(2.5 / height, 0.1, 1.0))


def _described(figures: dict[str, float]) -> str:
    text = f"a plane of {figures['area_m2']:.1f} m² with {100 * figures['share_above']:.0f} percent of the scene above"
    if "camera_height_m" in figures:
        text += f", cameras {figures['camera_height_m']:.2f} m over it"
    if "camera_pitch_down_deg" in figures:
        text += f" looking {figures['camera_pitch_down_deg']:.0f}° down at it"
    if "angle_to_given_up_deg" in figures:
        text += f", {figures['angle_to_given_up_deg']:.0f}° from the given direction up"
    return text


def _rivals(scored: list[tuple[dict[str, float], Plane]], cloud: Cloud, up_known: bool) -> list[str]:
    """Words about planes that might have been the ground too.

    Raises:
        AlignError: a plane of another inclination is as good a ground, and nothing says which is level.
    """
    (best, ground), warnings = scored[0], []
    for figures, plane in scored[1:]:
        angle = float(np.degrees(np.arccos(np.clip(plane.normal @ ground.normal, -1, 1))))
        if angle < 4:
            step = float(np.median(ground.height(cloud.points[plane.inliers])))
            if 0 < step < HIGHEST_STAGE and plane.area > max(STAGE, 0.2 * ground.area):
                warnings.append(
                    f"two grounds: the lower level plane ({ground.area:.1f} m²) was taken as the ground, "
                    f"another of {plane.area:.1f} m² lies {100 * step:.0f} cm above it"
                )
            elif step < -BELOW:
                warnings.append(
                    f"two grounds: the level plane taken as the ground covers {ground.area:.1f} m², "
                    f"another of {plane.area:.1f} m² lies {-100 * step:.0f} cm below it"
                )
        elif figures["score"] > RIVAL * best["score"]:
            if not up_known and angle < 60 and figures["score"] > 0.8 * best["score"]:
                raise AlignError(
                    "two grounds: it is unclear which of them is level",
                    expected="one large plane below everything else",
                    found=f"{_described(best)}; and {_described(figures)}, inclined by {angle:.0f}° to the first",
                    hint="capture more of the level floor, or use a source that knows gravity",
                )
            warnings.append(f"another plane, inclined by {angle:.0f}°, might be the ground too: {_described(figures)}")
    return warnings


def _upside_down(plane: Plane, cloud: Cloud) -> list[str]:
    if not cloud.held:
        return []
    upright = -(cloud.cameras[:, :3, 1] @ plane.normal)
    share = float(np.mean(upright < -0.3))
    if share > 0.5:
        return [
            "the capture is upside down: the images' upper side points to the ground; the ground was taken from the "
            "geometry, which does not depend on how the camera was held"
        ]
    if share > 0:
        return [f"{100 * share:.0f} percent of the frames were taken with the camera upside down"]
    return []


def tilt_sigma_deg(cloud: Cloud, plane: Plane, seed: int, resamples: int = 200) -> float:
    """One standard deviation of the plane's tilt (both axes together), degrees.

    Two parts, added in squares. A bootstrap over blocks of ground of 1 m, since points near each other share errors
    (Künsch 1989, in the plane); with few blocks, at least what the residual over the extent allows. And half of what
    the better-seen and the worse-seen half of the ground disagree by: a sensor's own pattern bends all frames the same
    way, which no resampling shows, but it grows with distance.
    """
    points, w = cloud.points[plane.inliers], plane_weights(cloud)[plane.inliers]
    seen = cloud.weights[plane.inliers]
    uv, h = points @ plane_axes(plane.normal).T, plane.height(points)
    cells = np.floor(uv / BLOCK).astype(np.int64)
    _, block = np.unique(cells[:, 0] * 1_000_003 + cells[:, 1], return_inverse=True)
    blocks = int(block.max()) + 1
    centre = np.average(uv, axis=0, weights=w)
    # The normal equations of h = a + b u + c v, summed by block: a resample is then a 3x3 solve.
    A = np.column_stack([np.ones(len(uv)), uv - centre])
    columns = [A[:, i] * A[:, j] for i in range(3) for j in range(3)] + [A[:, i] * h for i in range(3)]
    products = w[:, None] * np.column_stack(columns)
    sums = np.stack([np.bincount(block, c, blocks) for c in products.T], axis=1)
    slopes = _slopes(resampled(np.asarray(sums, float), resamples, seed).sum(1))
    variance = float((slopes**2).sum(1).mean())
    if blocks < FEW_BLOCKS:
        extent = float(np.sqrt(np.linalg.eigvalsh(np.cov((uv - centre).T, aweights=w))[0]))
        variance = max(variance, (plane.rms / max(extent, 1e-3)) ** 2)
    better = seen > np.median(seen)
    if better.any():  # all of a scan is seen alike
        near, far = _slopes(np.stack([products[better].sum(0), products[~better].sum(0)]))
        variance += 0.25 * float(((near - far) ** 2).sum())
    return float(np.degrees(np.arctan(np.sqrt(variance))))


def _slopes(sums: F64) -> F64:
    """(R, 2) slopes that solve R stacked normal equations (R, 12)."""
    N, b = sums[:, :9].reshape(-1, 3, 3), sums[:, 9:]
    ridge = 1e-9 * np.trace(N.mean(0)) * np.eye(3)
    return np.linalg.solve(N + ridge, b[..., None])[:, 1:, 0]
