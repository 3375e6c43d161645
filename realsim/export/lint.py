"""What a user's own MJCF collides as: the measure of `contact`, on the static geoms of any model."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError, require
from realsim.core.geometry import R_to_quat
from realsim.core.meshes import merged, mesh_of, sampled
from realsim.core.mjcf import check_mjcf
from realsim.core.progress import note
from realsim.core.types import F64
from realsim.export.any_mesh import GOOD, contact_verdict
from realsim.export.config import SceneConfig
from realsim.export.contact.fidelity import EDGE, measure
from realsim.export.contact.polytope import Polytope
from realsim.export.contact.probe import Reference
from realsim.export.contact.seams import open_seams
from realsim.export.formats.scene import primitive_corners

SAMPLES = 2000
"""Points of a mesh that are compared with its hull."""


@dataclass(frozen=True)
class _Static:
    """The geoms of a model that do not move, in the world's frame."""

    spec: Any
    """`MjSpec` of those that collide, as MuJoCo collides them."""
    drawn: list[tuple[F64, NDArray[Any]]]
    """Triangles of what is to be touched: visual meshes that do not collide; without one, what collides as drawn."""
    parts: list[tuple[str, Polytope]]
    hulls: list[dict[str, Any]]
    """Mesh geoms that collide as a hull farther than EDGE from their own surface."""
    ground_z: float
    planes: int


def lint_mjcf(path: Path) -> dict[str, Any]:
    """Measure the static geoms of a model against what is drawn, JSON-able.

    Balls, feet and rays are those of `realsim contact`. The surface to match is that of static mesh geoms that do not
    collide (a visual mesh); where there is none, the colliding geoms' own triangles, which MuJoCo replaces by hulls.

    Args:
        path: MJCF, or any model that MuJoCo loads.

    Returns:
        `verdict`, `geoms` (how many collide), `hulls` (mesh geoms that collide as their hull, with how far that is
        off), `seams` (places where parts only meet, so that a foot may stay between them), and the measured figures.

    Raises:
        ExportError: MuJoCo does not load it, or nothing static in it collides and has a surface.
    """
    require("recon", "realsim lint")
    config = SceneConfig()
    static = _static(_load(path), path)
    vertices, faces = merged(static.drawn)
    reference = Reference(vertices, faces.astype(np.int32))
    note("measuring ...")
    bare = static.planes > 0
    figures = dict(measure(static.spec, reference, static.ground_z, probes=config.contact_probes, bare=bare).figures)
    seams = open_seams([part for _, part in static.parts])
    names = [name for name, _ in static.parts]
    listed = [{"geoms": [names[s.one], names[s.other]], "at": [round(float(v), 3) for v in s.at]} for s in seams]
    count = len(static.parts) + static.planes
    found = figures | {"hidden_cm2": 0.0, "ground_z": static.ground_z}
    verdict = contact_verdict(found, config.contact_tolerance)
    return {
        "mjcf": str(path),
        "verdict": _with_parts(verdict, static.hulls, listed),
        "geoms": count,
        "hulls": static.hulls,
        "seams": listed,
    } | found


def _with_parts(verdict: dict[str, Any], hulls: list[dict[str, Any]], seams: list[dict[str, Any]]) -> dict[str, Any]:
    """The verdict with what is known of single geoms."""
    reasons, todo = list(verdict["reasons"]), []
    if hulls:
        worst = max(hulls, key=lambda h: h["off_mm"])
        reasons.append(
            f"{len(hulls)} mesh geom{'s collide' if len(hulls) > 1 else ' collides'} as a convex hull that is off the "
            f"mesh, most of all {worst['geom']} (by {worst['off_mm']:.0f} mm)."
        )
        todo.append("give each such mesh collision geometry: realsim contact MESH")
    if seams:
        first = seams[0]
        reasons.append(
            f"{len(seams)} seam{'s' * (len(seams) > 1)} where parts only meet ({first['geoms'][0]} and "
            f"{first['geoms'][1]} at {first['at']}): a small foot that lands there may stay."
        )
        todo.append("let neighbouring parts reach 2 cm into each other, or use one convex part")
    level = verdict["level"] if verdict["level"] != "good" or not reasons else "look"
    mine = [step for step in verdict["next"] if "--contact" not in step]
    return {"level": level, "headline": (*reasons, GOOD)[0], "reasons": reasons, "next": todo + mine}


def _load(path: Path) -> Any:
    import mujoco

    check_mjcf(path, problem=ExportError, plugins=True)
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        found = " ".join(str(error).split())
        hint = "mend what MuJoCo names; python -m mujoco.viewer --mjcf=FILE loads it the same way"
        raise ExportError(
            "MuJoCo does not load the model", file=path, expected="MJCF", found=found, hint=hint
        ) from error


def _static(model: Any, path: Path) -> _Static:
    """Everything welded to the world."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    spec = mujoco.MjSpec()
    kinds = mujoco.mjtGeom
    visual: list[tuple[F64, NDArray[Any]]] = []
    own: list[tuple[F64, NDArray[Any]]] = []
    parts: list[tuple[str, Polytope]] = []
    hulls: list[dict[str, Any]] = []
    planes: list[float] = []
    for g in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[g]] != 0:
            continue
        kind, R = model.geom_type[g], data.geom_xmat[g].reshape(3, 3)
        collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, g) or f"geom {g}"
        place = {"pos": data.geom_xpos[g], "quat": R_to_quat(R), "size": model.geom_size[g]}
        if kind == kinds.mjGEOM_PLANE:
            if collides and R[2, 2] > 0.999:
                planes.append(float(data.geom_xpos[g][2]))
                spec.worldbody.add_geom(type=kind, contype=1, conaffinity=1, **place)
            continue
        if kind == kinds.mjGEOM_MESH:
            vertices, faces = mesh_of(model, int(model.geom_dataid[g]))
            world = vertices @ R.T + data.geom_xpos[g]
            (own if collides else visual).append((world, faces))
            if collides:
                off = _off_hull(world, faces)
                if off > EDGE:
                    hulls.append({"geom": name, "off_mm": round(1000 * off, 1)})
                mesh = spec.add_mesh(name=f"mesh_{g}", uservert=world.ravel())  # its hull collides, faces or not
                spec.worldbody.add_geom(type=kind, meshname=mesh.name, contype=1, conaffinity=1)
                parts.append((name, Polytope(world)))
        elif collides:
            corners = primitive_corners(kinds(kind), model.geom_size[g])
            if corners is None:
                raise ExportError(
                    "a static geom of a kind that cannot be measured",
                    file=path,
                    expected="planes, boxes, meshes, spheres, capsules, cylinders and ellipsoids",
                    found=f"{name}: {kinds(kind).name}",
                )
            spec.worldbody.add_geom(type=kind, contype=1, conaffinity=1, **place)
            part = Polytope(corners @ R.T + data.geom_xpos[g])
            parts.append((name, part))
            own.append(part.hull[:2])
    drawn = visual or own
    if not parts or not drawn:
        found = f"{len(parts)} static geoms that collide, besides planes"
        raise ExportError(
            "nothing to measure", file=path, expected="static boxes or meshes that collide", found=found,
            hint="give the scene's model: bodies with joints (robots) are left out; realsim contact MESH makes a scene",
        )  # fmt: skip
    lowest = min(float(v[:, 2].min()) for v, _ in drawn)
    return _Static(spec, drawn, parts, hulls, max(planes, default=lowest), len(planes))


def _off_hull(vertices: F64, faces: NDArray[Any]) -> float:
    """Metres that a mesh's surface lies inside its hull at the farthest."""
    points, _ = sampled(vertices, faces, SAMPLES, np.random.default_rng(0))
    return float(Polytope(vertices).depth(points).max(initial=0.0))
