"""Contact in the simulator against the surface that was seen: one card of the report."""

from collections.abc import Mapping, Sequence
from typing import Any

from realsim.core.geometry import error_grid
from realsim.core.types import Platform, Reconstruction, SceneFiles
from realsim.report import page, raster, svg
from realsim.report.marks import leaks_of
from realsim.report.topdown import ROLE_INK, mark

_RANGE = 0.015  # metres at which the colour is full


def contact_card(result: Reconstruction) -> list[str]:
    """The measured error of the collision geometry as a map and in figures; empty where nothing was measured."""
    scene = result.scene
    if scene.contact_map is None or "median_mm" not in scene.contact:
        return []
    return map_card(scene, result.aligned.platforms, rows(scene.contact))


def map_card(scene: SceneFiles, platforms: Sequence[Platform], table: Sequence[tuple[str, str]] = ()) -> list[str]:
    """The map of the error with the platforms' outlines, and a table below it."""
    bar = svg.color_bar(-1e3 * _RANGE, 1e3 * _RANGE, "mm", raster.SIGNED, "error")
    note = (
        "A ball of 1 cm was lowered onto the collision geometry everywhere: height of the first touch minus the "
        "surface. Red: contact with no surface there (phantom). Blue: surface without contact (missing)."
    )
    body = _map(scene, platforms) + bar + (page.table(("figure", "value"), table) if table else "")
    return [page.card("Contact against the surface", body, note)]


def _map(scene: SceneFiles, platforms: Sequence[Platform]) -> str:
    """The error from above, in the simulation frame, with the platforms' outlines and where balls fell through."""
    contact_map, leaks = scene.contact_map, leaks_of(scene.contact)
    assert contact_map is not None
    (x0, y0), (x1, y1) = contact_map[:, :2].min(0), contact_map[:, :2].max(0)
    extent = (float(x0), float(x1), float(y0), float(y1))
    picture = raster.colorize(error_grid(contact_map), -_RANGE, _RANGE, raster.SIGNED)
    scale = max(1, 900 // picture.shape[1])  # browsers blur what they enlarge
    axes = svg.Axes(extent[:2], extent[2:], equal=True, x_label="x (m)", y_label="y (m)", grid=False)
    axes.image(raster.png_uri(picture.repeat(scale, 0).repeat(scale, 1)), extent)
    for p in platforms:
        axes.polyline(p.outline, ROLE_INK.get(p.role, "var(--ink)"), width=1.6, closed=True, title=p.role)
    mark(axes, leaks)
    return axes.svg("map of the contact error")


def rows(c: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(figure, value) of the measure of a scene's contact."""
    geoms = ", ".join(_counted(n, kind) for kind, n in dict(c.get("geoms", {})).items())
    found = [
        ("representation", f"{c['representation']} ({geoms})"),
        ("error, median", f"{c['median_mm']:.2f} mm"),
        ("error, 95th percentile", f"{c['p95_mm']:.1f} mm"),
        ("error, largest", f"{c['max_mm']:.1f} mm"),
        ("phantom surface", f"{c['phantom_area_cm2']:.0f} cm²"),
        ("missing surface", f"{c['missing_area_cm2']:.0f} cm²"),
        ("leaks", f"{c['leaks']}"),
    ]
    if "drop" in c:
        off = c["drop"]["phantom_share"] + c["drop"]["missing_share"]
        found.insert(4, ("heights off by more than 2 cm", f"{off:.1%}"))
    if c.get("sides", {}).get("stopped") is not None:
        sides = c["sides"]
        counts = (
            f"{sides['stopped']:.1%} of {sides['rays']}; {sides['through']:.1%} through, {sides['early']:.1%} early"
        )
        found.append(("rays from the side that stop where they should", counts))
    if "phantom_over_gaps_cm2" in c:
        found.append(("phantom surface over gaps wider than a foot", f"{c['phantom_over_gaps_cm2']:.0f} cm²"))
    follow, kept = (c.get(f"unseen_undersides_{k}_cm2", 0.0) for k in ("at_side_faces", "as_filled"))
    if follow or kept:
        found.append(("unseen undersides", f"{follow + kept:.0f} cm², {follow:.0f} of them placed where the sides end"))
    if "step_cost_vs_plane" in c:
        found.append(("time of a simulation step", f"{c['step_cost_vs_plane']:.2f} times that on a plane, G1 standing"))
    return found


def _counted(n: int, kind: str) -> str:
    return f"{n} {kind}" + ("" if n == 1 else "es" if kind.endswith(("x", "sh")) else "s")
