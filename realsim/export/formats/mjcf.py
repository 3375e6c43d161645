"""MJCF: the scene as it is, and a profile for MuJoCo Warp."""

import shutil
import xml.etree.ElementTree as ET  # writing only
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import ExportError
from realsim.core.files import explain_write_errors, to_json, write_text
from realsim.core.geometry import R_to_quat
from realsim.export.contact.cost import with_g1
from realsim.export.formats.scene import SceneOnDisk, height_nodes
from realsim.export.mjcf import HFIELD_CONTACT, numbers


def mjcf(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """scene.xml and what it refers to, copied: the profile for the CPU."""
    with explain_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        names = ["scene.xml", *_referred(scene.folder / "scene.xml")]
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(scene.folder / name, folder / name)
    return [folder / name for name in names]


def warp(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """terrain.xml: collision geometry alone, for MuJoCo Warp; advice.json: sizes measured with G1 on it.

    No visual mesh, no sites: every geom is in the world, group 3, contype 1 and conaffinity 0, so that terrain is
    touched by robots (conaffinity 1) and never tested against itself. Boxes and planes collide with capsules and
    spheres in closed form there; convex parts and height fields go through the general solver.
    """
    root = ET.Element("mujoco", model="terrain")
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    bits = {"group": "3", "contype": "1", "conaffinity": "0"}
    if scene.floor_z is not None:
        place = {"pos": numbers([0, 0, scene.floor_z]), "size": "0 0 1"}
        ET.SubElement(world, "geom", {"name": "floor", "type": "plane", **place, **bits})
    for box in scene.boxes:
        place = {"pos": numbers(box.position), "quat": numbers(R_to_quat(box.rotation)), "size": numbers(box.half)}
        ET.SubElement(world, "geom", {"name": box.name, "type": "box", **place, **bits})
    for part in scene.convex:
        ET.SubElement(asset, "mesh", name=part.name, vertex=numbers(np.round(part.vertices, 5).ravel()))
        ET.SubElement(world, "geom", {"name": part.name, "type": "mesh", "mesh": part.name, **bits})
    for part in scene.surfaces:
        # Node by node: MuJoCo Warp takes a height field from any model. In the text, rows go from the highest y down.
        z, size, centre = height_nodes(part.vertices, 0.1)
        shape = {"nrow": str(len(z)), "ncol": str(z.shape[1]), "size": numbers(size)}
        ET.SubElement(asset, "hfield", {"name": part.name, **shape, "elevation": numbers(z[::-1].ravel())})
        geom = {"name": part.name, "type": "hfield", "hfield": part.name, "pos": numbers(centre)}
        ET.SubElement(world, "geom", {**geom, **HFIELD_CONTACT, **bits})
    ET.indent(root, "  ")
    text = ET.tostring(root, "unicode") + "\n"
    write_text(folder / "terrain.xml", text)
    write_text(folder / "advice.json", to_json(_advice(text, scene)))
    return [folder / "terrain.xml", folder / "advice.json"]


def _advice(text: str, scene: SceneOnDisk) -> dict[str, Any]:
    """nconmax and njmax a world: twice the most contacts and constraint rows seen with G1 standing and falling."""
    import mujoco

    centre = scene.sites["start"][0] if "start" in scene.sites else scene.bounds.mean(0) * [1, 1, 0]
    model = with_g1(mujoco.MjSpec.from_string(text), np.asarray(centre))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0
    contacts, rows = 0, 0
    for _ in range(500):
        mujoco.mj_step(model, data)
        contacts, rows = max(contacts, int(data.ncon)), max(rows, int(data.nefc))
    return {
        "nconmax_per_world": 2 * contacts,
        "njmax_per_world": 2 * rows,
        "measured": {"robot": "g1", "contacts": contacts, "constraint_rows": rows, "steps": 500},
        "closed_form_geoms": len(scene.boxes) + (scene.floor_z is not None),
        "convex_solver_geoms": len(scene.convex) + len(scene.surfaces),
    }


def _referred(path: Path) -> list[str]:
    """Files that an MJCF file names, relative to it; included files' own too."""
    from defusedxml import ElementTree
    from defusedxml.common import DefusedXmlException

    from realsim.core.files import inside, read_text

    names: list[str] = []
    try:
        tree = ElementTree.fromstring(read_text(path))
    except (ElementTree.ParseError, DefusedXmlException) as error:
        raise ExportError("not plain XML", file=path, found=str(error)) from error
    for element in tree.iter():
        name = element.get("file")
        if name and name not in names:
            inside(path.parent, name)
            names.append(name)
            if element.tag == "include":
                names += [n for n in _referred(path.parent / name) if n not in names]
    return names
