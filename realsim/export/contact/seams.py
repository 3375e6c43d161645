"""Seams between parts: neighbours are made to reach into each other.

Contacts are soft. What lands at 2 m/s sinks 2 cm into them, and its centre then lies inside a part, which pushes it out
through the nearest face. Where two parts only meet, that is the seam, on both sides: each pushes the thing into the
other, and it stays. A part that reaches beyond the seam pushes it up, as one solid would.

Nothing is added to the shape that all parts have together: a part grows only into what others fill.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from realsim.export.contact.base import Asset, ContactModel, Geom
from realsim.export.contact.outline import hull
from realsim.export.contact.polytope import Face, Polytope

F64 = NDArray[np.float64]
REACH = 0.02
"""Metres by which one part reaches into the next."""
FARTHER = 0.06
"""Metres tried first where a whole face is covered: capsules sink deeper into boxes than into convex meshes."""
GAP = 0.003
"""Metres between parts that still meet: outlines are simplified one by one."""
STICKS_OUT = 0.003
"""Metres by which what is grown may stand out at a rim; planes are fitted no more closely to a surface."""
FLUSH = 1e-5
"""Metres below a neighbour's far side at which a part ends that goes through all of it."""
NARROW = 0.004
"""Metres: a thinner strip of contact is no seam that anything gets into."""


def overlap(contact: ContactModel) -> ContactModel:
    """The same representation with parts that reach REACH into their neighbours wherever those are solid.

    First parts grow across whole faces that their neighbours cover, so that a box stays a box; for what is left of a
    seam, a part is added that spans it.
    """
    parts, others = parts_of(contact)
    near = _Neighbours(parts)
    for i in range(len(parts)):
        for before in parts[i].faces:
            face = parts[i].face_like(before)  # growing across one face makes those beside it longer
            grown = None if face is None else _grown(parts, near, i, face)
            if grown is not None:
                parts[i] = grown
                near.update(i, grown)
    added = list(_bridges(parts, near))
    geoms: list[Geom] = list(others)
    assets: list[Asset] = [a for a in contact.assets if a.points is None]
    named = [g.name for g in contact.geoms if g.type in ("box", "mesh") and not g.visible]
    for name, part in zip([*named, *(f"seam_{k}" for k in range(len(added)))], [*parts, *added], strict=True):
        geom, asset = part.part(name)
        geoms.append(geom)
        assets += [asset] if asset is not None else []
    return replace(
        contact, geoms=tuple(geoms), assets=tuple(assets), statistics=dict(contact.statistics) | {"seams": len(added)}
    )


@dataclass(frozen=True)
class Seam:
    """Where two parts only meet."""

    one: int
    other: int
    """Which of the parts."""
    at: F64
    """(3,) a place on the seam, metres."""


def open_seams(parts: list[Polytope]) -> list[Seam]:
    """Seams that no part spans, one for each pair of parts; slivers that nothing can stay in do not count."""
    near = _Neighbours(parts)
    found: dict[tuple[int, int], Seam] = {}
    for i, part in enumerate(parts):
        for face in part.faces:
            for cover in _covers(parts, near, i, face):
                pair = (min(i, cover.part), max(i, cover.part))
                if pair in found or _spanned(parts, near, part, face, cover):
                    continue
                if _bridge(part, face, cover) is not None:
                    found[pair] = Seam(*pair, face.lifted(cover.near).mean(0))
    return list(found.values())


def parts_of(contact: ContactModel) -> tuple[list[Polytope], list[Geom]]:
    """(convex parts of a representation, the geoms that are none: floor, height field)."""
    points = {a.name: a.points for a in contact.assets}
    parts, others = [], []
    for geom in contact.geoms:
        corners = points.get(geom.asset or "")
        if geom.type == "box" and not geom.visible:
            parts.append(Polytope.of_box(geom))
        elif geom.type == "mesh" and corners is not None:
            parts.append(Polytope(corners))
        else:
            others.append(geom)
    return parts, others


class _Neighbours:
    """Bounds of parts, to find those that may meet one."""

    def __init__(self, parts: list[Polytope]) -> None:
        self.lower = np.array([p.lower for p in parts])
        self.upper = np.array([p.upper for p in parts])

    def update(self, i: int, part: Polytope) -> None:
        self.lower[i], self.upper[i] = part.lower, part.upper

    def of(self, low: F64, high: F64, but: int = -1) -> NDArray[np.int64]:
        """Those that meet a box."""
        meets: NDArray[np.bool_] = np.asarray(((self.lower <= high) & (self.upper >= low)).all(1))
        if but >= 0:
            meets[but] = False
        return np.flatnonzero(meets)


@dataclass(frozen=True)
class _Cover:
    """What a neighbour covers of a face."""

    part: int
    near: F64
    """(K, 2) outline just outside the face."""
    far: F64
    """(K, 2) outline `reach` outside it, as far as the face goes."""
    reach: float
    """Metres: REACH, or as far as the neighbour goes."""


def _covers(parts: list[Polytope], near: _Neighbours, i: int, face: Face) -> Iterator[_Cover]:
    """Neighbours that go on where a face of part i ends."""
    beyond = face.corners + REACH * face.normal
    low, high = np.minimum(face.corners.min(0), beyond.min(0)), np.maximum(face.corners.max(0), beyond.max(0))
    outline = convex(face.flat(face.corners))
    for j in near.of(low, high, but=i):
        close = clip(outline, parts[j].section(face, GAP))
        if _width(close) > NARROW:
            reach = min(REACH, _thickness(parts[j], face) - FLUSH)
            yield _Cover(int(j), close, clip(outline, parts[j].section(face, reach)), reach)


def _thickness(part: Polytope, face: Face) -> float:
    """Metres from a face outward to where a part ends."""
    return float((part.points @ face.normal + face.offset).max())


def _grown(parts: list[Polytope], near: _Neighbours, i: int, face: Face) -> Polytope | None:
    """Part i, grown across one of its faces, if neighbours cover all of that and no part spans the seam yet."""
    from manifold3d import CrossSection, FillRule, JoinType

    covers = list(_covers(parts, near, i, face))
    open_ = [c for c in covers if not _spanned(parts, near, parts[i], face, c)]
    if not open_:
        return None
    whole = CrossSection([convex(face.flat(face.corners))], FillRule.NonZero)
    thickness = min(_thickness(parts[c.part], face) for c in covers) - FLUSH
    for reach in sorted({min(FARTHER, thickness), min(REACH, thickness)}, reverse=True):
        filled = CrossSection()
        for cover in covers:
            outline = clip(cover.near, parts[cover.part].section(face, reach))
            if len(outline) > 2:
                filled += CrossSection([outline], FillRule.NonZero)
        # What is left uncovered may be a thread along the rim.
        if (whole - filled).offset(-STICKS_OUT / 2, JoinType.Miter).area() <= 1e-9:
            return _with_face_moved(parts[i], face, reach)
    if parts[i].box is not None:
        return None
    # A neighbour whose own surface falls away from the seam (the other side of a ridge) is entered below that.
    for cover in open_:
        alone = (whole - CrossSection([cover.near], FillRule.NonZero)).offset(-STICKS_OUT / 2, JoinType.Miter)
        if alone.area() <= 1e-9 and _width(cover.far) > NARROW:
            return Polytope(_hull(np.concatenate([parts[i].points, face.lifted(cover.far, cover.reach)])))
    return None


def _with_face_moved(part: Polytope, face: Face, by: float) -> Polytope:
    if part.box is None:
        return Polytope(_hull(np.concatenate([part.points, face.corners + by * face.normal])))
    from realsim.core.geometry import quat_to_R

    axes = quat_to_R(part.box.quat).T
    k = int(np.abs(axes @ face.normal).argmax())
    size = np.array(part.box.size)
    size[k] += by / 2
    pos = np.array(part.box.pos) + by / 2 * face.normal
    return Polytope.of_box(replace(part.box, pos=tuple(pos.tolist()), size=tuple(size.tolist())))


def _bridges(parts: list[Polytope], near: _Neighbours) -> Iterator[Polytope]:
    """Parts across what is left of the seams."""
    made: list[Polytope] = []
    for i, part in enumerate(parts):
        for face in part.faces:
            for cover in _covers(parts, near, i, face):
                if _spanned(parts, near, part, face, cover):
                    continue
                bridge = _bridge(part, face, cover)
                if bridge is None or any(m.contains(bridge.points, GAP).all() for m in made):
                    continue
                made.append(bridge)
                yield bridge


def _bridge(part: Polytope, face: Face, cover: _Cover) -> Polytope | None:
    """The part that spans a seam: nowhere wider than the seam itself, so that it stays within both."""
    depth = min(REACH, -float((part.points @ face.normal + face.offset).min()) - FLUSH)
    inside = clip(cover.near, part.section(face, -depth))
    outside = clip(cover.near, cover.far)
    if _width(inside) <= NARROW or _width(outside) <= NARROW:
        return None
    rows = [face.lifted(inside, -depth), face.lifted(cover.near), face.lifted(outside, cover.reach)]
    return Polytope.of_points("", _hull(np.concatenate(rows)))


def _spanned(parts: list[Polytope], near: _Neighbours, part: Polytope, face: Face, cover: _Cover) -> bool:
    """Whether one part holds the seam and most of REACH on both sides of it."""
    deep = 0.75 * REACH
    inside, outside = clip(cover.near, part.section(face, -deep)), clip(cover.near, cover.far)
    ahead = 0.75 * cover.reach
    points = [face.lifted(outline, by) for outline, by in ((inside, -deep), (cover.near, 0.0), (outside, ahead))]
    core = np.concatenate(points)
    return any(parts[j].contains(core, GAP).all() for j in near.of(core.min(0) + GAP, core.max(0) - GAP))


def convex(points: F64) -> F64:
    """(M, 2) hull of points (N, 2), counter-clockwise; empty where they have no area."""
    return hull(points) if len(points) > 2 else np.zeros((0, 2))


def clip(outline: F64, other: F64) -> F64:
    """(M, 2) what two convex outlines (K, 2) share (Sutherland and Hodgman 1974)."""
    outline, other = convex(outline), convex(other)
    if len(outline) < 3 or len(other) < 3:
        return np.zeros((0, 2))
    for a, b in zip(other, np.roll(other, -1, 0), strict=True):
        side = (b[0] - a[0]) * (outline[:, 1] - a[1]) - (b[1] - a[1]) * (outline[:, 0] - a[0])
        if (side >= 0).all():
            continue
        if (side < 0).all():
            return np.zeros((0, 2))
        kept = []
        for k in range(len(outline)):
            n = (k + 1) % len(outline)
            if side[k] >= 0:
                kept.append(outline[k])
            if (side[k] >= 0) != (side[n] >= 0):
                t = side[k] / (side[k] - side[n])
                kept.append(outline[k] + t * (outline[n] - outline[k]))
        outline = np.array(kept)
    return convex(outline)


def _width(outline: F64) -> float:
    """Metres: the least width of a convex outline (M, 2), by its area and length; 0 of none."""
    if len(outline) < 3:
        return 0.0
    x, y = outline.T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    around = float(np.linalg.norm(np.roll(outline, -1, 0) - outline, axis=1).sum())
    return 2 * area / max(around, 1e-12)


def _hull(points: F64) -> F64:
    from scipy.spatial import ConvexHull

    middle = points.mean(0)
    return np.asarray(points[ConvexHull(points - middle).vertices])
