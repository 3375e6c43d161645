"""The text of scene.xml."""

import xml.etree.ElementTree as ET  # writing only
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import Platform, platform_names
from realsim.export.contact.base import ContactModel, Geom

VISUAL_GROUP, COLLISION_GROUP = 2, 3
DRAWN_BELOW = 0.03  # metres
UNTOUCHED = {"contype": "0", "conaffinity": "0"}
HFIELD_CONTACT = {"solref": "0.01 1", "solmix": "1000000"}
"""Of a height field's geom. MuJoCo collides it as prisms of one cell: what sinks half a cell deep is pushed out at
their sides, into the next one, and never gets out. With the usual 0.02 s, 93 and 114 of 150 balls dropped from half a
metre onto a smooth and a rough terrain of 10 m stay inside (cells of 2 cm; 54 and 61 of 10 cm); with this, none."""


def scene_xml(
    contact: ContactModel,
    platforms: Sequence[Platform],
    bounds: NDArray[np.float64],
    *,
    visual: str,
    texture: str | None,
    robot: str | None = None,
    azimuth: float = 60.0,
) -> str:
    """A scene in the simulation frame: metres, z up, files relative to the scene's folder.

    Args:
        bounds: (2, 3) corners of the terrain, for camera and statistics.
        visual: file of the mesh that is drawn; texture: its image, or None.
        robot: file of the robot's model, standing where it should, or None.
        azimuth: direction in which viewers look first, degrees from x to y.
    """
    root = ET.Element("mujoco", model="scene")
    ET.SubElement(root, "compiler", angle="radian")
    centre, extent = bounds.mean(0), float(np.linalg.norm(bounds[1] - bounds[0]))
    ET.SubElement(root, "statistic", center=numbers(centre), extent=numbers([max(extent, 0.5)]))
    _look(root, azimuth)
    asset = ET.SubElement(root, "asset")
    _materials(asset, texture)
    ET.SubElement(asset, "mesh", name="visual", file=visual, inertia="shell")
    _assets(asset, contact)
    world = ET.SubElement(root, "worldbody")
    _lights_and_camera(world, bounds)
    drawn = {"name": "visual", "type": "mesh", "mesh": "visual", "material": "scan", **UNTOUCHED}
    ET.SubElement(world, "geom", drawn, group=str(VISUAL_GROUP))
    _geoms(world, contact)
    for name, platform in zip(platform_names(platforms), platforms, strict=True):
        _platform_site(world, name, platform)
    if robot is not None:
        ET.SubElement(root, "include", file=robot)
    ET.indent(root, "  ")
    return ET.tostring(root, "unicode") + "\n"


def contact_elements(contact: ContactModel) -> str:
    """MJCF that holds the collision geoms alone."""
    root = ET.Element("mujoco", model="contact")
    _materials(asset := ET.SubElement(root, "asset"), None)
    _assets(asset, contact)
    _geoms(ET.SubElement(root, "worldbody"), contact)
    return ET.tostring(root, "unicode")


def numbers(values: Iterable[float]) -> str:
    """Numbers as MJCF text: at most ten significant digits, no negative zero."""
    return " ".join(f"{float(v) + 0.0:.10g}" for v in values)


def _look(root: ET.Element, azimuth: float) -> None:
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.45 0.45 0.45", specular="0 0 0")
    ET.SubElement(visual, "rgba", haze="0.78 0.83 0.88 1")
    ET.SubElement(visual, "map", znear="0.005", zfar="20")
    ET.SubElement(visual, "quality", shadowsize="4096")
    ET.SubElement(visual, "global", azimuth=numbers([azimuth]), elevation="-30", offwidth="1280", offheight="960")


def _materials(asset: ET.Element, texture: str | None) -> None:
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": "0.75 0.82 0.9", "rgb2": "0.95 0.96 0.97"}
    ET.SubElement(asset, "texture", sky, width="256", height="1536")
    checker = {"type": "2d", "builtin": "checker", "rgb1": "0.55 0.57 0.6", "rgb2": "0.5 0.52 0.55"}
    ET.SubElement(asset, "texture", checker, name="floor", width="256", height="256")
    ET.SubElement(asset, "material", name="floor", texture="floor", texrepeat="1 1", texuniform="true")
    if texture is None:
        ET.SubElement(asset, "material", name="scan", rgba="0.72 0.7 0.66 1", specular="0", shininess="0")
    else:
        ET.SubElement(asset, "texture", name="scan", type="2d", file=texture)
        ET.SubElement(asset, "material", name="scan", texture="scan", specular="0", shininess="0")


def _assets(asset: ET.Element, contact: ContactModel) -> None:
    for a in contact.assets:
        kind = {"content_type": "image/vnd.mujoco.hfield"} if a.kind == "hfield" else {}
        file = {"file": a.file} if a.file else {}
        ET.SubElement(asset, a.kind, {"name": a.name, **file, **kind, **a.attributes})


def _lights_and_camera(world: ET.Element, bounds: NDArray[np.float64]) -> None:
    centre, size = bounds.mean(0), bounds[1] - bounds[0]
    high = bounds[1, 2] + 4
    ET.SubElement(world, "light", pos=numbers([*centre[:2], high]), dir="0.2 0.3 -1", type="directional")
    # Beside the terrain, from the side on which y is negative, looking at its middle and down by 35 degrees.
    distance = 0.65 * float(np.hypot(size[0], size[1])) + 0.5
    down = np.radians(35)
    eye = centre + distance * np.array([0, -np.cos(down), np.sin(down)])
    up = [0, np.sin(down), np.cos(down)]
    ET.SubElement(world, "camera", name="side", pos=numbers(eye), xyaxes=numbers([1, 0, 0, *up]))


def _geoms(world: ET.Element, contact: ContactModel) -> None:
    for geom in contact.geoms:
        ET.SubElement(world, "geom", _geom(geom))
        if geom.visible and geom.type == "plane":
            ET.SubElement(world, "geom", _drawn_floor(geom))


def _geom(geom: Geom) -> dict[str, str]:
    out = {"name": geom.name, "type": geom.type, "pos": numbers(geom.pos)}
    if geom.quat != (1.0, 0.0, 0.0, 0.0):
        out["quat"] = numbers(geom.quat)
    if geom.size is not None:
        out["size"] = numbers(geom.size)
    if geom.asset is not None:
        out["hfield" if geom.type == "hfield" else "mesh"] = geom.asset
    if geom.type == "hfield":
        out |= HFIELD_CONTACT
    if geom.visible and geom.type != "plane":
        return out | {"material": "floor", "group": "0"}
    return out | {"rgba": "0.35 0.55 0.8 1", "group": str(COLLISION_GROUP)}


def _drawn_floor(floor: Geom) -> dict[str, str]:
    """The drawn floor: a little below the collision floor, so that it does not flicker through the scan."""
    x, y, z = floor.pos
    out = {"name": f"{floor.name}_drawn", "type": "plane", "pos": numbers((x, y, z - DRAWN_BELOW))}
    if floor.size is not None:
        out["size"] = numbers(floor.size)
    return out | {"material": "floor", "group": "0", **UNTOUCHED}


def _platform_site(world: ET.Element, name: str, platform: Platform) -> None:
    """A thin, half transparent slab in the platform's top face; x along its long side."""
    color = {"start": "0.2 0.7 0.3 0.4", "goal": "0.85 0.25 0.2 0.4"}.get(name, "0.9 0.75 0.2 0.3")
    place = {"pos": numbers(platform.centroid), "euler": numbers([0, 0, platform.yaw])}
    size = numbers([*(platform.size[:2] / 2), 0.001])
    ET.SubElement(world, "site", {"name": name, "type": "box", **place}, size=size, rgba=color, group="4")
