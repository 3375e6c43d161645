"""SDF: a static model for Gazebo."""

import xml.etree.ElementTree as ET  # writing only
from pathlib import Path

from realsim.core.files import write_files, write_text
from realsim.export.formats.meshes import drawn, stl_bytes
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.formats.urdf import roll_pitch_yaw
from realsim.export.mjcf import numbers

VERSION = "1.9"
CONFIG = f"""<?xml version="1.0"?>
<model>
  <name>terrain</name>
  <version>1.0</version>
  <sdf version="{VERSION}">model.sdf</sdf>
  <description>A scanned terrain, metres, z up.</description>
</model>
"""


def sdf(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """model.config, model.sdf and meshes/: a static model; the floor is a plane."""
    root = ET.Element("sdf", version=VERSION)
    model = ET.SubElement(root, "model", name="terrain")
    ET.SubElement(model, "static").text = "true"
    link = ET.SubElement(model, "link", name="terrain")
    files = {f"meshes/{name}": data for name, data in drawn(scene, "visual").items()}
    _mesh(ET.SubElement(link, "visual", name="scan"), "visual.obj")
    if scene.floor_z is not None:
        floor = ET.SubElement(link, "collision", name="floor")
        ET.SubElement(floor, "pose").text = numbers([0, 0, scene.floor_z, 0, 0, 0])
        plane = ET.SubElement(ET.SubElement(floor, "geometry"), "plane")
        ET.SubElement(plane, "normal").text = "0 0 1"
        ET.SubElement(plane, "size").text = "100 100"
    for box in scene.boxes:
        collision = ET.SubElement(link, "collision", name=box.name)
        ET.SubElement(collision, "pose").text = numbers([*box.position, *roll_pitch_yaw(box)])
        shape = ET.SubElement(ET.SubElement(collision, "geometry"), "box")
        ET.SubElement(shape, "size").text = numbers(2 * box.half)
    for part in (*scene.convex, *scene.surfaces):
        _mesh(ET.SubElement(link, "collision", name=part.name), f"{part.name}.stl")
        files[f"meshes/{part.name}.stl"] = stl_bytes(part.vertices, part.triangles)
    ET.indent(root, "  ")
    written = write_files(folder, files)
    write_text(folder / "model.sdf", '<?xml version="1.0"?>\n' + ET.tostring(root, "unicode") + "\n")
    write_text(folder / "model.config", CONFIG)
    return [folder / "model.sdf", folder / "model.config", *written]


def _mesh(parent: ET.Element, name: str) -> None:
    mesh = ET.SubElement(ET.SubElement(parent, "geometry"), "mesh")
    ET.SubElement(mesh, "uri").text = f"meshes/{name}"
