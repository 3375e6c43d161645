"""Seams between parts: neighbours are made to reach into each other.

Contacts are soft. What lands at 2 m/s sinks 2 cm into them, and its centre then lies inside a part, which pushes it out
through the nearest face. Where two parts only meet, that is the seam, on both sides: each pushes the thing into the
other, and it stays. A part that reaches beyond the seam pushes it up, as one solid would.

Nothing is added to the shape that all parts have together: a part grows only into what others fill.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.progress import track
from realsim.core.types import F64
from realsim.export.contact.base import Asset, ContactModel, Geom
from realsim.export.contact.merge import ADDS, Neighbours, Whole, merged
from realsim.export.contact.outline import area, hull, sides
from realsim.export.contact.polytope import Face, Polytope

REACH = 0.02
"""Metres by which one part reaches into the next."""
FARTHER = 0.06
"""Metres tried first where a whole face is covered: capsules sink deeper into boxes than into convex meshes."""
GAP = 0.003
"""Metres between parts that still meet: outlines are simplified one by one."""
STICKS_OUT = 0.003
"""Metres by which what is grown may stand out at a rim; planes are fitted no more closely to a surface."""
DEEP = 0.75 * REACH
"""Metres by which one part has to be in the other for nothing to stay on the seam."""
FLUSH = 1e-5
"""Metres below a neighbour's far side at which a part ends that goes through all of it."""
NARROW = 0.004
"""Metres: a thinner strip of contact is no seam that anything gets into."""
RADIUS = 0.01
"""Metres: of the balls that nothing may hold."""
OPPOSED = 0.9
"""Cosine: parts push against each other where they meet face to face. Where they cross, they push to the free side."""


def overlap(contact: ContactModel, tolerance: float = 0.0, most: float = np.inf) -> ContactModel:
    """The same representation with parts that reach REACH into their neighbours wherever those are solid.

    First parts whose hull adds nothing (less than half of the `tolerance` of their planes and than `most`, in metres)
    become one. Then parts grow across whole faces that their neighbours cover, so that a box stays a box; for what is
    left of a seam, a part is added that spans it.
    """
    before, others = parts_of(contact)
    named = [g.name for g in contact.geoms if g.type in ("box", "mesh") and not g.visible]
    whole = Whole(before, others)
    fewer = merged(before, whole, min(max(ADDS, tolerance / 2), most))
    named = [name for name, part in zip(named, fewer, strict=True) if part is not None]
    parts = [part for part in fewer if part is not None]
    near = Neighbours(parts)
    for i in track(range(len(parts)), "closing seams"):
        for old in parts[i].faces:
            face = parts[i].face_like(old)  # growing across one face makes those beside it longer
            grown = None if face is None else _grown(parts, near, whole, i, face)
            if grown is not None:
                parts[i] = grown
                near.update(i, grown)
    added: list[Polytope] = []
    for _, cover in _open(parts, near, added):
        added.append(Polytope.around(cover.core))
    geoms: list[Geom] = list(others)
    assets: list[Asset] = [a for a in contact.assets if a.points is None]
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
    found: dict[tuple[int, int], Seam] = {}
    for i, cover in _open(parts, Neighbours(parts), []):
        pair = (min(i, cover.part), max(i, cover.part))
        found.setdefault(pair, Seam(*pair, cover.face.lifted(cover.near).mean(0)))
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


@dataclass(frozen=True)
class _Cover:
    """What a neighbour covers of a face."""

    part: int
    face: Face
    near: F64
    """(K, 2) outline just outside the face."""
    far: F64
    """(K, 2) outline `reach` outside it, as far as the face's part can go on straight."""
    reach: float
    """Metres: REACH, or as far as the neighbour goes."""
    core: F64
    """(M, 3) corners of what a part has to hold that spans the seam."""
    bent: bool
    """Whether a side bends at the seam, so that nothing goes on straight."""


def _covers(parts: list[Polytope], near: Neighbours, i: int, face: Face) -> Iterator[_Cover]:
    """Neighbours that go on where a face of part i ends, and do not reach into it."""
    beyond = face.corners + REACH * face.normal
    low, high = np.minimum(face.corners.min(0), beyond.min(0)), np.maximum(face.corners.max(0), beyond.max(0))
    part = parts[i]
    for j in near.of(low, high, but=i).tolist():
        key = part, face, j, parts[j]  # looked at when parts grow, and again for what is left of the seams
        if key not in near.seen:
            near.seen[key] = _cover(part, face, j, parts[j])
        if (cover := near.seen[key]) is not None:
            yield cover


def _cover(part: Polytope, face: Face, j: int, other: Polytope) -> _Cover | None:
    """What of a part's face part j covers."""
    back = other.faces[int((other.planes[:, :3] @ face.normal).argmin())]
    cosine = float(back.normal @ face.normal)
    if cosine > -OPPOSED:
        return None
    section = other.section(face, GAP)
    if not len(section) or _apart(face.outline, section):
        return None
    close = clip(face.outline, hull(section))
    if _width(close) <= NARROW:
        return None
    into = float(((face.lifted(close) @ back.normal + back.offset) / cosine).min())
    if into > DEEP:
        return None
    reach = min(REACH, _thickness(other, face) - FLUSH)
    far = _straight_on(part, face, reach, other.section(face, reach))
    depth = min(REACH + max(into, 0.0), -float((part.points @ face.normal + face.offset).min()) - FLUSH)
    inside = clip(close, _straight_on(other, back, depth, part.section(face, -depth), face))
    outside = clip(close, far)
    if bent := min(_width(inside), _width(outside)) <= NARROW:
        inside = clip(close, hull(part.section(face, -depth)))
        while _width(outside := clip(close, hull(other.section(face, reach)))) <= NARROW < reach / 2:
            reach /= 2  # farther out, a steep side has fallen below the face
    if min(_width(inside), _width(outside)) <= NARROW:
        return None
    core = [face.lifted(inside, -depth), face.lifted(close), face.lifted(outside, reach)]
    return _Cover(j, face, close, far, reach, np.concatenate(core), bent)


def _straight_on(part: Polytope, face: Face, beyond: float, outline: F64, flat: Face | None = None) -> F64:
    """What of an outline (K, 2), `beyond` metres outside a part's face, lies between that part's other faces.

    Args:
        flat: the face in whose plane the outline is given, on the other side of the same seam; None for `face`.
    """
    plane, height = (face, beyond) if flat is None else (flat, -beyond)
    outline = hull(outline)
    for other in part.faces:
        if other is not face and len(outline):
            normal = plane.axes @ other.normal
            offset = other.offset + (height - plane.offset) * float(plane.normal @ other.normal)
            outline = _cut(outline, outline @ normal + offset)
    return hull(outline)


def _thickness(part: Polytope, face: Face) -> float:
    """Metres from a face outward to where a part ends."""
    return float((part.points @ face.normal + face.offset).max())


def _grown(parts: list[Polytope], near: Neighbours, whole: Whole, i: int, face: Face) -> Polytope | None:
    """Part i, grown across one of its faces into what no part spans yet, if that adds nothing to the whole."""
    part, covers = parts[i], [c for c in _covers(parts, near, i, face) if not c.bent or _stays(parts, near, [], c)]
    open_ = [c for c in covers if not _spanned(parts, near, c)]
    if not open_:
        return None
    through = min(_thickness(parts[c.part], face) for c in covers) - FLUSH
    tries = [(face.outline, by) for by in (FARTHER, REACH, through)]
    # A neighbour whose own surface falls away from the seam (the other side of a ridge) is entered below that.
    tries += [(cover.far, cover.reach) for cover in open_]
    for flat, by in tries:
        ahead = face.lifted(_straight_on(part, face, by, flat), by)
        middle = ahead.mean(0) if len(ahead) else ahead
        if len(ahead) < 3 or not whole.holds(middle + 0.9 * (ahead - middle), 0.0):  # the end is nowhere outside
            continue
        if whole.holds_hull(Polytope.around(face.corners, ahead), STICKS_OUT, part):
            return Polytope.around(part.points, ahead)
    return None


def _open(parts: list[Polytope], near: Neighbours, added: list[Polytope]) -> Iterator[tuple[int, _Cover]]:
    """(part, seam at one of its faces) of those that neither a part spans nor one that was added; of bent ones, of
    which a round thing has hundreds, those that could hold a ball."""
    for i, part in enumerate(parts):
        for face in part.faces:
            for cover in _covers(parts, near, i, face):
                spanned = _spanned(parts, near, cover) or _held(cover.core, added)
                if not spanned and (not cover.bent or _stays(parts, near, added, cover)):
                    yield i, cover


def _stays(parts: list[Polytope], near: Neighbours, added: list[Polytope], cover: _Cover) -> bool:
    """Whether a ball that comes from above stays somewhere on a seam, its middle its radius within the rim: every part
    pushes it out through the nearest of its faces, and none of them up."""
    rim = np.concatenate([cover.near, (cover.near + np.roll(cover.near, 1, axis=0)) / 2])
    inward = cover.near.mean(0) - rim
    inward *= np.minimum(RADIUS / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9), 1.0)
    at = cover.face.lifted(rim + inward)
    beside = RADIUS * np.stack([cover.face.normal, -cover.face.normal]) + [0.0, 0.0, 2 * RADIUS]
    above, lifts = at + beside[:, None], np.zeros(len(at))
    free = np.ones((2, len(at)), bool)
    low, high = at.min(0) - RADIUS, at.max(0) + 3 * RADIUS
    for part in [*(parts[j] for j in near.of(low, high)), *added]:
        if (part.lower < high).all() and (part.upper > low).all():
            free &= ~part.contains(above.reshape(-1, 3)).reshape(2, -1)
            off = part.planes[:, :3] @ at.T + part.planes[:, 3:]
            lifts += np.maximum(RADIUS - off.max(0), 0.0) * part.planes[off.argmax(0), 2]
    held = free.any(0) & (lifts < RADIUS / 2)
    held[: len(held) // 2] &= np.linalg.norm(cover.near - np.roll(cover.near, 1, axis=0), axis=1) > 2 * RADIUS
    return bool((held & np.roll(held, len(held) // 2)).any())  # at a corner and in the middle of a side beside it


def _spanned(parts: list[Polytope], near: Neighbours, cover: _Cover) -> bool:
    """Whether one part holds a seam and REACH on both sides of it."""
    core = cover.core
    return _held(core, [parts[j] for j in near.of(core.min(0) + GAP, core.max(0) - GAP)])


def _held(core: F64, parts: list[Polytope]) -> bool:
    """Whether one of some parts holds all points (N, 3)."""
    return any(part.contains(core, GAP).all() for part in parts)


def clip(outline: F64, other: F64) -> F64:
    """(M, 2) what two outlines (K, 2) as `hull` makes them share (Sutherland and Hodgman 1974)."""
    if len(outline) < 3 or len(other) < 3:
        return np.zeros((0, 2))
    for a, b in zip(other, [*other[1:], other[0]], strict=True):
        outline = _cut(outline, (b[1] - a[1]) * (outline[:, 0] - a[0]) - (b[0] - a[0]) * (outline[:, 1] - a[1]))
    return hull(outline)


def _apart(outline: F64, points: F64) -> bool:
    """Whether all points (N, 2) lie outside one side of an outline (K, 2) as `hull` makes it."""
    (x, y), (dx, dy) = outline.T[..., None], sides(outline).T[..., None]
    return bool((dy * (points[:, 0] - x) - dx * (points[:, 1] - y) > 0).all(1).any())


def _cut(outline: F64, outside: F64) -> F64:
    """(M, 2) what of a convex outline (K, 2) is not outside a line, by the distances (K,) of its corners from that."""
    kept, out = [], outside > 1e-6  # of two lines in one, rounding would cut a corner off
    if not out.any():
        return outline
    for k in range(len(outline)):
        n = (k + 1) % len(outline)
        if not out[k]:
            kept.append(outline[k])
        if out[k] != out[n]:
            t = outside[k] / (outside[k] - outside[n])
            kept.append(outline[k] + t * (outline[n] - outline[k]))
    return np.array(kept).reshape(-1, 2)


def _width(outline: F64) -> float:
    """Metres: the least width of a convex outline (M, 2), by its area and length; 0 of none."""
    if len(outline) < 3:
        return 0.0
    around = float(np.linalg.norm(sides(outline), axis=1).sum())
    return 2 * abs(area(outline)) / max(around, 1e-12)
