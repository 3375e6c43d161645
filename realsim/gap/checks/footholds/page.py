"""The page: the verdict, the map of footholds, and the figures of each."""

from math import degrees

import numpy as np

from realsim.core.types import F64
from realsim.gap.checks.camera.calibrate import CameraFound
from realsim.gap.checks.camera.terrain import Terrain
from realsim.gap.checks.footholds.footholds import Foothold, FootholdMap
from realsim.gap.checks.footholds.verdict import SceneVerdict, sentence
from realsim.report import page, raster, svg

WORDS = {"height": "height", "tilt": "tilt", "give": "soft", "slip": "slippery", "wobble": "wobbles"}
AXES = ("right", "down", "forward")
COLORS = (37, 99, 190), (226, 226, 222), (190, 60, 37)


def scene_page(
    verdict: SceneVerdict, found: FootholdMap, terrain: Terrain, case: str, more: list[str], extra: list[str]
) -> str:
    """The whole page as text.

    Args:
        more: warnings and notes beside it.
        extra: cards of other checks of the same log.
    """
    facts = [
        ("Footholds", str(len(found.footholds)), "places where feet stood"),
        ("Changed", str(len(found.changed)), "beyond everyday deviations of a scan"),
        ("Contacts", str(found.contacts), f"{found.lost} where the scene has no top"),
        (
            "Base height off by",
            f"{1000 * found.base[0]:.0f} to {1000 * found.base[1]:.0f} mm",
            "estimated for each run, and taken out",
        ),
        ("Repeatability", f"{1000 * found.scatter:.1f} mm", "of one foothold's height, contact to contact"),
    ]
    body = [
        page.verdict(verdict.level, verdict.headline, verdict.reasons, verdict.next),
        page.facts(facts),
        page.card(
            "Map", _map(found, terrain) + svg.color_bar(-20, 20, "mm", COLORS),
            "Every disc is a foothold at the middle of its contacts, coloured by how much it is higher or lower than "
            "scanned; a ring marks those that differ beyond everyday deviations. Grey: the scanned tops.", wide=True,
        ),
        *extra,
        page.card("Footholds", _table(found), "Values with 90 percent intervals. Soft: sinking under the robot's whole "
                  "weight. Bold: named above.", wide=True),
        page.card("How to read it", page.bullets([
            "Heights are of one foothold against the others: if all tops were off by the same, the base would be "
            "blamed.", "A foothold that few contacts reached has a wide interval and is not named.", *more,
        ])),
    ]  # fmt: skip
    return page.document(
        f"Footholds of {case}", f"{len(found.footholds)} footholds, scene {terrain.file.name}", "".join(body)
    )


def _map(found: FootholdMap, terrain: Terrain) -> str:
    places = np.array([h.place[:2] for h in found.footholds])
    low, high = places.min(axis=0) - 0.25, places.max(axis=0) + 0.25
    axes = svg.Axes(
        (low[0], high[0]), (low[1], high[1]), width=980, equal=True, x_label="x (m)", y_label="y (m)", grid=False
    )
    for outline in _outlines(terrain, low, high):
        axes.polyline(outline, "var(--faint)", width=0.8, fill="rgba(128,128,128,0.12)", closed=True)
    for hold in found.footholds:
        at = [hold.place[:2]]
        if hold.changes:
            axes.dots(at, "var(--ink)", radius=11)
        h = hold.quantities["height"]
        r, g, b = raster.colorize(h.value, -0.02, 0.02, COLORS)[:3]
        mm = h.text("+.0f", 1e3, " mm")
        title = sentence(hold) if hold.changes else f"{hold.name}: {mm}, {hold.touches} contacts"
        axes.dots(at, f"rgb({r},{g},{b})", radius=9, titles=[title])
    for hold in found.changed:
        text = ", ".join(_short(hold, kind) for kind in hold.changes)
        axes.text(*hold.place[:2], text, dy=-16, fill="var(--ink)", halo=True)
    return axes.svg("footholds from above")


def _outlines(terrain: Terrain, low: F64, high: F64) -> list[F64]:
    """Boxes of the terrain from above, as far as they lie on the map."""
    found = []
    model, data = terrain.model, terrain.data
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    for g in range(model.ngeom):
        if model.geom_group[g] == 0 and model.geom_type[g] == 6:  # mjGEOM_BOX
            R, p, s = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g], model.geom_size[g]
            ring = p[:2] + (corners * s[:2]) @ R[:2, :2].T
            if (ring.max(axis=0) > low).all() and (ring.min(axis=0) < high).all():
                found.append(np.clip(ring, low, high))
    return found


def _short(hold: Foothold, kind: str) -> str:
    q = hold.quantities
    if kind == "height":
        return f"{1000 * q['height'].value:+.0f} mm".replace("-", "−")
    if kind == "tilt":
        return f"{np.hypot(degrees(q['tilt_x'].value), degrees(q['tilt_y'].value)):.0f}°"
    if kind == "slip" and "friction" in q:
        return f"friction {q['friction'].value:.2f}"
    return WORDS[kind]


def _table(found: FootholdMap) -> str:
    parts = {"height": "height (mm)", "tilt": "tilt (°)", "give": "gives way (mm)", "slip": "slides (mm)"}
    parts |= {"wobble": "sways (mm)"}
    rows = []
    for hold in sorted(found.footholds, key=lambda h: (not h.changes, h.name)):
        q = hold.quantities
        texts = {kind: q[kind].text(".1f", 1e3) if kind in q else "–" for kind in parts}
        texts["tilt"] = f"{degrees(q['tilt_x'].value):.1f}, {degrees(q['tilt_y'].value):.1f}"
        cells = [f"<b>{text}</b>" if kind in hold.changes else text for kind, text in texts.items()]
        rows.append([page.esc(hold.name), f"{hold.place[0]:.2f}, {hold.place[1]:.2f}", str(hold.touches), *cells])
    return page.table(["foothold", "x, y (m)", "contacts", *parts.values()], rows, raw=range(8))


def camera_cards(found: CameraFound | None) -> list[str]:
    """What recorded depth says of its camera, as a card; nothing where none was recorded."""
    if found is None:
        return []
    quantities = [("delay", "ms", 1e3, found.quantities["delay"])]
    quantities += [(f"turned about {a}", "°", 57.2958, q) for a, q in zip(AXES, found.along("turn"), strict=True)]
    quantities += [(f"shifted to {a}", "mm", 1e3, q) for a, q in zip(AXES, found.along("shift"), strict=True)]
    if "ratio" in found.quantities:
        quantities.append(("noise", "ratio", 1.0, found.quantities["ratio"]))
    rows = [
        [what, unit, f"{scale * q.value:.2f}", f"{scale * q.low:.2f} to {scale * q.high:.2f}"]
        for what, unit, scale, q in quantities
    ]
    note = (
        f"{found.frames} frames, {found.pixels} pixels of {found.camera} against rays in the scene. Median residual: "
        f"{1000 * found.before:.1f} mm with the camera as in the model, {1000 * found.after:.1f} mm as found here."
    )
    text = page.bullets(
        found.sentences(), "The camera is where the model has it, on time, and no noisier than it should be."
    )
    return [page.card("Depth camera", text + page.table(["", "unit", "value", "90 percent"], rows), note, wide=True)]
