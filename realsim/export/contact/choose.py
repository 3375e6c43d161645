"""Selects the representation: build, measure, and take the cheapest within tolerance."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import UnknownNameError
from realsim.core.meshes import across, areas, edges_of, faces_by_place
from realsim.core.progress import steps
from realsim.core.types import TerrainMesh
from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel, UnsuitedError
from realsim.export.contact.cost import standing_place, step_cost
from realsim.export.contact.fidelity import OFF, Fidelity, measured
from realsim.export.contact.islands import FINE
from realsim.export.contact.patches import noise_of
from realsim.export.contact.probe import Reference, spec_of
from realsim.export.contact.shape import Shape, Solids
from realsim.export.contact.sides import FREE

# Cheapest first. A height field is soon built, and the first rays tell where it lacks sides; sheets take minutes.
# `convex` takes a minute to build and is better than none of these, `sdf` costs a hundred planes.
CANDIDATES = ("boxes", "hybrid", "hfield", "sheets")
OF_COLUMNS = ("boxes", "hybrid")
"""Those made of columns that are solid."""
SIDES = 0.75
"""Least share of the side faces in columns for these to be built: with more than a quarter passed through, the verdict
is "do not use" whatever else they are (`core.contact_limits`)."""
ONE_PLANE, FLAT = 1e-4, 0.1
"""Radians between two triangles of one plane (single precision makes 1e-5 in triangles of centimetres), and the least
share of edges between such in a model: a third in a box. Not tuned: noise leaves none."""


@dataclass
class _Tried:
    """A representation that is measured as far as it has to be."""

    contact: ContactModel
    rest: Iterator[Fidelity]
    fidelity: Fidelity

    def go_on(self) -> bool:
        """Measure one thing more; False where there is none."""
        more = next(self.rest, None)
        self.fidelity = more or self.fidelity
        return more is not None


@dataclass(frozen=True)
class Fitted:
    """A representation with what was measured on it."""

    contact: ContactModel
    fidelity: Fidelity
    summary: Mapping[str, Any]
    """JSON-able: `representation`, errors, areas, leaks, cost, geoms, and what else was considered."""
    warnings: tuple[str, ...] = ()


def fit_contact(
    mesh: TerrainMesh,
    ground_z: float,
    config: SceneConfig,
    place: NDArray[np.float64] | None = None,
    *,
    bare: bool = False,
    solids: Solids | None = None,
) -> Fitted:
    """Collision geometry of a mesh and how faithful it is; `config.contact` names it, or is `auto`.

    Args:
        place: (3,) where a robot stands when the cost is measured; the highest level place if None.
        bare: whether the ground goes on where the mesh has no surface; in a scan, nothing is known there.
        solids: convex pieces that the mesh is made of, if it is.

    Raises:
        UnknownNameError: no such representation.
    """
    from realsim.export import CONTACT

    if config.contact != "auto" and config.contact not in CONTACT:
        raise UnknownNameError("collision representation", config.contact, ["auto", *CONTACT])
    reference = Reference(mesh.vertices, mesh.triangles, mesh.invented)
    shape = Shape(mesh, ground_z, solids or Solids((), mesh))
    names: tuple[str, ...] = CANDIDATES if config.contact == "auto" else (config.contact,)
    tried: list[_Tried] = []
    refused: list[dict[str, Any]] = []
    noise = mesh.noise_m
    if noise is None:  # what is closed was modelled, or has an inside; only open walls are a scan's for sure
        noise = 0.0 if is_exact(mesh) else noise_of(mesh.vertices)
    if config.contact == "auto" and (carried := shape.sides_in_columns(noise)) < SIDES:
        found = f"columns hold {carried:.0%} of the side faces"
        refused = [{"representation": name, "refused": found} for name in OF_COLUMNS]
        names = tuple(name for name in CANDIDATES if name not in OF_COLUMNS)
        if mesh.noise_m is None and 2 * noise > FINE:  # walls with one side are a scan's: it is as noisy as it shows
            mesh = replace(mesh, noise_m=noise, resolution=_mean_edge(mesh))
            shape = Shape(mesh, ground_z)  # of which no piece is exact
    with steps() as tick:
        for name in names:
            if name == "sheets" and mesh.noise_m is None and is_closed(mesh) and any(map(_has_sides, tried)):
                refused.append({"representation": name, "refused": "a closed surface, of which columns hold the sides"})
                continue
            tick(f"building {name}", 0.0)
            try:
                contact = CONTACT[name](shape, config)
            except UnsuitedError as error:
                if config.contact != "auto":
                    raise
                refused.append({"representation": name, "refused": error.found})
                continue
            fidelities = measured(
                spec_of(contact),
                reference,
                ground_z,
                probes=config.contact_probes,
                tick=partial(tick, f"measuring {name}"),
                bare=bare,
                noise=_uncertain(mesh),
            )
            best = _Tried(contact, fidelities, next(fidelities))
            tried.append(best)
            while (met := best.fidelity.meets(*config.contact_tolerance)) and best.go_on():
                pass
            if met:
                break
        if not met:  # the rest is measured of the best alone
            while (best := min(tried, key=lambda t: t.fidelity.shortfall(*config.contact_tolerance))).go_on():
                pass
    contact, fidelity = best.contact, best.fidelity
    warnings = contact.warnings
    if not met:
        warnings = (*contact.warnings, _unmet(contact, fidelity, config.contact_tolerance, len(names)))
    if place is None:
        start, off = fidelity.touches.start, np.nan_to_num(fidelity.touches.error)
        heights = reference.top(start[:, :2], start[:, 2])
        known = np.isfinite(heights)
        true = known & (np.abs(off) < 0.01)
        place = standing_place(np.column_stack([start[:, :2], heights])[true if true.any() else known])
    cost = step_cost(spec_of(contact), place)
    weighed = ("median_mm", "p95_mm", "phantom_over_gaps_cm2", "free_sides_cm2", "leaks")
    considered = refused + [
        {"representation": t.contact.representation}
        | {k: t.fidelity.figures[k] for k in weighed if k in t.fidelity.figures}
        | _shares(t.fidelity)
        for t in tried
    ]
    summary = {"representation": contact.representation} | dict(fidelity.figures) | cost
    summary |= {"geoms": count_types(contact), "considered": considered} | dict(contact.statistics)
    summary |= {} if mesh.noise_m is None else {"noise_m": round(mesh.noise_m, 5)}
    return Fitted(contact, fidelity, summary, warnings)


def _uncertain(mesh: TerrainMesh) -> float:
    """Metres that the surface itself may be off: its noise, and where voxels round an inner edge, half of one."""
    return 0.0 if mesh.noise_m is None else max(mesh.noise_m, mesh.resolution / 2)


def is_closed(mesh: TerrainMesh) -> bool:
    """Whether no edge has one triangle alone."""
    return bool((edges_of(faces_by_place(mesh.vertices, mesh.triangles)).uses > 1).all())


def _has_sides(tried: _Tried) -> bool:
    """Whether it is made of columns and stops rays from the side: sheets would have nothing to add."""
    stopped = tried.fidelity.figures["sides"]["stopped"]
    return tried.contact.representation in OF_COLUMNS and (stopped is None or stopped >= 1 - OFF)


def is_exact(mesh: TerrainMesh) -> bool:
    """Whether no edge has one triangle alone, or at FLAT of the edges two triangles lie in one plane: noise leaves none
    of those, and every flat face of a model has some."""
    edges = edges_of(faces_by_place(mesh.vertices, mesh.triangles))
    normal = across(mesh.vertices, mesh.triangles)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    pair = edges.first[edges.uses == 2]
    one, other = normal[edges.order[pair] // 3], normal[edges.order[pair + 1] // 3]
    flat = np.linalg.norm(one - other, axis=1) < ONE_PLANE
    return bool((edges.uses > 1).all() or flat.sum() > FLAT * len(edges.uses))


def _mean_edge(mesh: TerrainMesh) -> float:
    """Metres between the vertices of a surface, if its triangles had one size."""
    area = areas(mesh.vertices, mesh.triangles)
    return float(np.sqrt(4 / np.sqrt(3) * area.mean()))


def _shares(fidelity: Fidelity) -> dict[str, float | None]:
    heights = {"heights_off": round(fidelity.off[0], 4)} if "drop" in fidelity.figures else {}
    return heights | {"sides_stopped": fidelity.figures["sides"]["stopped"]}


def count_types(contact: ContactModel) -> dict[str, int]:
    """{geom type: how many}."""
    return dict(Counter(geom.type for geom in contact.geoms))


def _unmet(contact: ContactModel, fidelity: Fidelity, tolerance: tuple[float, float], among: int) -> str:
    f = fidelity.figures
    least = f", the best of {among} candidates" if among > 1 else ""
    return (
        f"collision geometry ({contact.representation}{least}) is off by {f['median_mm']:.1f} mm (median), "
        f"{f['p95_mm']:.1f} mm (p95), {f['phantom_over_gaps_cm2']:.0f} cm2 phantom over gaps, "
        f"{f['free_sides_cm2']:.0f} cm2 of a part's sides in free air, "
        f"{f['leaks']} leak{'s' * (f['leaks'] != 1)}, {describe_shares(fidelity)}; "
        f"limits: {tolerance[0] * 1000:g} mm median, {tolerance[1] * 1000:g} mm p95, no "
        f"phantom over gaps, {FREE:g} cm2 in free air, no leak, {OFF:.0%} of heights and of rays"
    )


def describe_shares(fidelity: Fidelity) -> str:
    """Shares of heights and of rays from the side that are off, in words."""
    heights, sides = fidelity.off
    rays = fidelity.figures["sides"]
    beside = "too few side faces to measure" if rays["stopped"] is None else f"{sides:.1%} of rays from the side"
    through = f" ({rays['through']:.1%} through)" if rays["stopped"] is not None else ""
    return f"{heights:.1%} of heights by more than 2 cm, {beside}{through}"
