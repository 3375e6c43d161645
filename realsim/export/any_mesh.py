"""Collision geometry for any mesh from anywhere."""

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.contact_limits import shares
from realsim.core.errors import ExportError
from realsim.core.files import file_digests, to_json, write_bytes, write_text
from realsim.core.geometry import error_grid
from realsim.core.progress import note
from realsim.core.types import F64, SceneFiles
from realsim.export.config import SceneConfig
from realsim.export.contact.islands import PIT_AREA
from realsim.export.contact.shape import Solids
from realsim.export.contact.sides import FREE
from realsim.export.ground import DEEP, GroundLevel, ground_level, hidden_cm2
from realsim.export.mend import read_mesh
from realsim.export.scene import write_terrain
from realsim.export.visual import png_bytes

LIMIT = 0.015  # metres at which a colour is full
NONE, AGREE, PHANTOM, MISSING = (235, 235, 235), (247, 247, 247), (178, 24, 43), (33, 102, 172)  # RGB


def contact_mesh(
    mesh: Path,
    folder: Path,
    config: SceneConfig,
    *,
    unit: str | None = None,
    up: str = "auto",
    ground_z: float | None = None,
) -> SceneFiles:
    """A mesh file becomes a scene folder with measured collision geometry, contact.json and contact.png.

    The frame is the file's own (z up, metres), less `origin_m` of contact.json where the file is far from its origin.

    Args:
        mesh: .ply, .obj, .stl, .glb or .off.
        folder: exists, empty.
        unit: of the file: m, cm, mm or inch; None for metres, up to 50 of them.
        up: axis that points up: z, y or auto.
        ground_z: metres; found from the mesh if None.

    Raises:
        ExportError: the mesh cannot be used, nothing of it rises from the ground, or the scene does not hold.
    """
    if ground_z is not None and not isfinite(ground_z):
        raise ExportError(
            "the height of the ground is not a number", expected="--ground-z in metres", found=f"{ground_z}"
        )
    note(f"reading and mending {mesh.name} ...")
    made = read_mesh(mesh, unit, up)
    terrain = made.terrain
    ground = (
        ground_level(terrain)
        if ground_z is None
        else GroundLevel(ground_z, False, f"at z = {ground_z:.3f} m, as given")
    )
    top = float(terrain.vertices[:, 2].max())
    if top < ground.z - DEEP:  # nothing is left that could be measured
        raise _under_the_ground(mesh, ground, f"its highest point at z = {top:.3f} m")
    solids = Solids(made.solids, made.rest)
    files = write_terrain(folder, terrain, ground.z, config, bare=True, solids=solids)
    hidden = hidden_cm2(terrain, files.scene_xml, ground, files.contact.get("noise_m", 0.0))
    if hidden and set(files.contact["geoms"]) == {"plane"}:
        raise _under_the_ground(mesh, ground, f"{hidden:.0f} cm2 of its surface below")
    contact = dict(files.contact) | {"mesh": mesh.name, "ground_z": ground.z, "ground": ground.description}
    contact |= {"hidden_cm2": hidden, "mended": list(made.notes), "up": made.up.axis}
    contact |= {"origin_m": made.origin.tolist(), "question": made.question}
    contact["missing_area_cm2"] = round(contact["missing_area_cm2"] + hidden, 2)
    contact["verdict"] = contact_verdict(contact, config.contact_tolerance)
    write_text(folder / "contact.json", to_json(contact | {"files": file_digests(folder)}))
    if files.contact_map is not None:
        write_bytes(folder / "contact.png", heatmap_png(files.contact_map))
    return replace(files, contact=contact)


def _under_the_ground(mesh: Path, ground: GroundLevel, found: str) -> ExportError:
    return ExportError(
        "no part of the mesh rises above the ground",
        file=mesh,
        expected=f"a mesh that reaches above z = {ground.z:.3f} m",
        found=found,
        hint="choose another --ground-z, or leave it out",
    )


def contact_verdict(contact: Mapping[str, Any], tolerance: tuple[float, float]) -> dict[str, Any]:
    """Whether collision geometry can be used, JSON-able: `level` (good, look, bad), `headline`, `reasons`, `next`.

    Bad is what lets a robot fall or walk through, or hides part of the mesh; look is a tolerance that is not met.

    Args:
        contact: the figures of the measure, and `hidden_cm2`; `drop`, `sides` and `question` may be missing.
        tolerance: metres at the median and at the 95th percentile.
    """
    bad, look, todo = [], [], []
    if contact.get("question"):
        look.append(contact["question"])
        todo.append("answer the question by the option that it names")
    if contact["leaks"]:
        bad.append(
            f"{contact['leaks']} of {contact['leak_objects']} balls thrown onto it fell into what should be solid."
        )
        todo.append("try another --contact (hybrid, convex, hfield), or close the holes of the mesh")
        todo.append("if it is a scan of a place, which has a floor and holes: realsim reconstruct MESH --out scene")
    if contact.get("held"):
        look.append(f"{contact['held']} of {contact['leak_objects']} balls thrown onto it stay between parts.")
    if contact["hidden_cm2"]:
        lines = bad if contact["hidden_cm2"] > 1e4 * PIT_AREA else look
        lines.append(f"{contact['hidden_cm2']:.0f} cm2 of the mesh lie below the ground and are not in the scene.")
        todo.append("leave out --ground-z, or give the height at which the mesh stands")
    for name, found, most in zip(("median", "p95"), (contact["median_mm"], contact["p95_mm"]), tolerance, strict=True):
        if not found <= 1000 * most:
            look.append(f"The contact error is {found:.1f} mm ({name}), above the limit of {1000 * most:g} mm.")
    if contact["phantom_over_gaps_cm2"]:
        look.append(f"{contact['phantom_over_gaps_cm2']:.0f} cm2 of contact surface span gaps that a foot fits in.")
    if contact.get("free_sides_cm2", 0.0) > FREE:
        where = ", ".join(f"{v:.2f}" for v in contact["free_sides_at"])
        look.append(f"{contact['free_sides_cm2']:.0f} cm2 of a part's sides stand in free air, about ({where}).")
    off = [(name, share, check, reject) for name, share, check, reject in shares(contact) if not share <= check]
    for name, share, check, reject in off:
        most, lines = (check, look) if share <= reject else (reject, bad)
        lines.append(f"{name}: {share:.1%}, above the limit of {most:.0%}.")
    if off or len(look) > bool(contact.get("question")):
        todo.append("look at contact.png, and try another --contact or a finer --hfield-resolution")
    level = "bad" if bad else "look" if look else "good"
    return {"level": level, "headline": (*bad, *look, GOOD)[0], "reasons": bad + look, "next": todo}


GOOD = "The contact geometry meets every limit."


def heatmap_png(contact_map: F64, pixels: int = 6) -> bytes:
    """PNG of (N, 3) x, y, signed error in metres: red where MuJoCo touches what is not there, blue
    where it lacks what is there, white where both agree, full colour at 15 mm. x to the right, y up."""
    error = error_grid(contact_map)[..., None]
    strength = np.clip(np.abs(error) / LIMIT, 0, 1)
    color = np.array(AGREE) * (1 - strength) + np.where(error > 0, PHANTOM, MISSING) * strength
    image = np.where(np.isnan(error), NONE, np.rint(color)).astype(np.uint8)[..., ::-1]  # OpenCV wants blue first
    return png_bytes(image.repeat(pixels, 0).repeat(pixels, 1))
