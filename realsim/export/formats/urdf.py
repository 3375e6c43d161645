"""URDF: one fixed link with the scanned surface to look at and the collision geometry to touch."""

import xml.etree.ElementTree as ET  # writing only
from pathlib import Path

import numpy as np

from realsim.core.files import write_files, write_text
from realsim.export.formats.meshes import drawn, stl_bytes
from realsim.export.formats.scene import Box, SceneOnDisk
from realsim.export.mjcf import numbers


def urdf(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """terrain.urdf with meshes beside it (relative names, metres, z up); the floor is a wide box."""
    robot = ET.Element("robot", name="terrain")
    link = ET.SubElement(robot, "link", name="terrain")
    files = drawn(scene, "visual")
    visual = ET.SubElement(link, "visual", name="scan")
    ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename="visual.obj")
    for box in scene.all_boxes():
        collision = ET.SubElement(link, "collision", name=box.name)
        ET.SubElement(collision, "origin", xyz=numbers(box.position), rpy=numbers(roll_pitch_yaw(box)))
        ET.SubElement(ET.SubElement(collision, "geometry"), "box", size=numbers(2 * box.half))
    for part in (*scene.convex, *scene.surfaces):
        collision = ET.SubElement(link, "collision", name=part.name)
        files[f"{part.name}.stl"] = stl_bytes(part.vertices, part.triangles)
        ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=f"{part.name}.stl")
    ET.indent(robot, "  ")
    written = write_files(folder, files)
    write_text(folder / "terrain.urdf", '<?xml version="1.0"?>\n' + ET.tostring(robot, "unicode") + "\n")
    return [folder / "terrain.urdf", *written]


def roll_pitch_yaw(box: Box) -> np.ndarray:
    """Angles about the fixed axes x, y, z, as URDF and SDF count them."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(box.rotation).as_euler("xyz")
