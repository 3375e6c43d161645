"""Selects the start and goal platforms: by rule, or as the user says."""

import numpy as np

from realsim.align.config import AlignConfig
from realsim.align.platforms import Face, oriented_extent
from realsim.core.errors import AlignError
from realsim.core.geometry import invert_T, make_T, outside_hull, transform
from realsim.core.types import F64, MetricScene, Scan

SLACK = 0.10
"""Metres outside a platform's outline that a point which asks for it may lie."""
ROOM = 0.35
"""Metres, the shortest side of a platform that a robot can start from: treads are 0.22 to 0.32 deep, a G1's foot 0.2 m
long and its stance as wide. What is narrower is stepped on, from the ground before it."""
Roles = tuple[int | None, int | None]
"""Indices of start and goal among the faces."""


def by_rule(faces: list[Face], near: F64) -> Roles:
    """Start and goal by the rule: the pair that is largest and furthest apart, see `pair_score`.

    The one nearer to `near` ((2,), first camera, sensor or origin in the plan of the levelled frame) is the start. A
    single platform is the start. A tread is none, measured or inferred, as a robot has hardly room on it: its flight
    begins at the ground. It ends at its last tread.
    """
    if len(faces) < 2:
        return (0, None) if faces else (None, None)
    pairs = [(i, j) for i in range(len(faces)) for j in range(i + 1, len(faces))]
    i, j = max(pairs, key=lambda p: pair_score(faces[p[0]], faces[p[1]]))
    first = np.linalg.norm(faces[i].centroid - near) <= np.linalg.norm(faces[j].centroid - near)
    start, goal = (i, j) if first else (j, i)
    if faces[goal].inferred:
        goal = max((k for k, face in enumerate(faces) if face.inferred), key=lambda k: faces[k].height)
    return (None if faces[start].inferred or oriented_extent(faces[start].outline)[1] < ROOM else start), goal


def pair_score(a: Face, b: Face) -> float:
    """The product of both areas, as seen, times the distance of the centroids: large and far apart.

    Not its root: then two chairs at both ends of a room would beat the platforms between them.
    """
    return float(min(a.seen, a.area) * min(b.seen, b.area) * np.linalg.norm(a.centroid - b.centroid))


def as_requested(
    faces: list[Face], rule: Roles, ahead: F64, source: MetricScene | Scan, config: AlignConfig, T_level_world: F64
) -> Roles:
    """The rule's roles, overruled by what `config` asks for.

    Where only one of the two is given, the other is the best partner for it by the same score.

    Raises:
        AlignError: a role is given twice, no platform lies there, or both are the same; the platforms are listed.
    """
    T_rule = simulation_frame(faces, rule, ahead)
    listed = described(faces, T_rule)
    chosen: dict[str, int] = {}
    for what, xy, pixel in (("start", config.start, config.start_pixel), ("goal", config.goal, config.goal_pixel)):
        if xy is not None and pixel is not None:
            raise AlignError(f"the {what} is given twice", expected="a point or a pixel", found="both")
        if xy is not None:
            where, place = transform(invert_T(T_rule), np.array([*xy, 0.0]))[:2], f"{xy[0]:g} {xy[1]:g}"
        elif pixel is not None:
            where = transform(T_level_world, _pixel_point(source, pixel, what))[:2]
            place = f"pixel {pixel[1]} {pixel[2]} of frame {pixel[0]}"
        else:
            continue
        distances = [float(outside_hull(face.outline, where[None])[0]) for face in faces]
        if not distances or min(distances) > SLACK:
            raise AlignError(
                f"no platform where the {what} was requested",
                expected=listed or "a capture with platforms: none was found in this one",
                found=f"{what} at {place}",
                hint="take X Y from the report of a run without --start and --goal, or name a pixel of a frame",
            )
        chosen[what] = int(np.argmin(distances))
    if not chosen:
        return rule
    if chosen.get("start") == chosen.get("goal"):
        raise AlignError("start and goal are the same platform", expected=f"two of: {listed}", found="one for both")
    start, goal = chosen.get("start"), chosen.get("goal")
    if start is None:
        start = _partner(faces, goal)
    if goal is None:
        goal = _partner(faces, start)
    return start, goal


def _partner(faces: list[Face], one: int | None) -> int | None:
    others = [k for k in range(len(faces)) if k != one]
    return max(others, key=lambda k: pair_score(faces[k], faces[one])) if others and one is not None else None


def simulation_frame(faces: list[Face], roles: Roles, ahead: F64) -> F64:
    """(4, 4) T_sim_level: origin on the start's top, x to the goal; without a start the levelled frame's origin,
    without a goal x along `ahead`, (2,) unit."""
    start, goal = roles
    origin, height, x = np.zeros(2), 0.0, ahead
    if start is not None:
        origin, height = faces[start].centroid, faces[start].height
    if goal is not None:
        x = faces[goal].centroid - origin
        x /= np.linalg.norm(x)
    R = np.array([[x[0], x[1], 0], [-x[1], x[0], 0], [0, 0, 1]])
    return make_T(R, -R @ [*origin, height])


def described(faces: list[Face], T_sim_level: F64) -> str:
    """The platforms in words, with where they are in a simulation frame."""
    parts = []
    for face in faces:
        x, y, _ = transform(T_sim_level, np.array([*face.centroid, face.height]))
        parts.append(f"a platform of {face.area:.2f} m², {face.height:.2f} m high, at {x:.2f} {y:.2f}")
    return "; ".join(parts)


def _pixel_point(source: MetricScene | Scan, pixel: tuple[str, int, int], what: str) -> F64:
    """(3,) world point that a pixel of a frame shows: of the colour image where there is one, else of the depth."""
    name, u, v = pixel
    if isinstance(source, Scan):
        raise AlignError(
            f"the {what} is given by a pixel, but a scan has no frames", file=source.source, hint=f"use --{what} X Y"
        )
    names = [frame.name for frame in source.frames]
    if name not in names:
        raise AlignError(
            f"the {what} is given by a pixel of a frame that is not used",
            expected=f"one of {', '.join(names[:8])}" + (", ..." if len(names) > 8 else ""),
            found=name,
        )
    i = names.index(name)
    frame, view = source.frames[i], source.load(i)
    camera = frame.color_intrinsics or frame.intrinsics
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        raise AlignError(
            f"the {what}'s pixel lies outside the image",
            expected=f"0 <= U < {camera.width}, 0 <= V < {camera.height}",
            found=f"{u} {v}",
        )
    # Both images look the same way from the same place, so a direction leads from one pixel grid to the other.
    height, width = view.mask.shape
    grid = frame.intrinsics.resized(width, height)
    column = (u - camera.cx) / camera.fx * grid.fx + grid.cx
    row = (v - camera.cy) / camera.fy * grid.fy + grid.cy
    rows, columns = np.nonzero(view.mask)
    distance = np.hypot(rows - row, columns - column)
    if not len(distance) or distance.min() > 5:
        raise AlignError(
            f"the {what}'s pixel shows nothing: no depth within 5 pixels", found=f"{u} {v} of frame {name}"
        )
    nearest = int(np.argmin(distance))
    return transform(source.T_world_camera[i], view.points[rows[nearest], columns[nearest]].astype(np.float64))
