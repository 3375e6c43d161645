"""The scene with what was found in it: tops moved and turned, friction and softness set, where a foothold is a geom."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import check_size, inside, read_bytes, write_bytes, write_text
from realsim.core.geometry import quat_to_R
from realsim.gap.answer.patch import asset_files
from realsim.gap.case.model.edit import put
from realsim.gap.checks.camera.terrain import Terrain
from realsim.gap.checks.footholds.footholds import Foothold, FootholdMap
from realsim.gap.effects.ground import multiply, quaternion


def write_corrected(folder: Path, terrain: Terrain, found: FootholdMap, weight: float) -> list[str]:
    """Write scene.xml and its files; returns what could not be put into it.

    Args:
        weight: N of the robot, to which the softness refers.
    """
    spec = terrain.spec.copy()
    left = []
    geoms = {g.name: g for g in spec.geoms if g.name}
    for hold in found.changed:
        geom = geoms.get(hold.name)
        if geom is None:
            left.append(f"{hold.name}: a part of a larger geom, left as scanned in the corrected scene")
            continue
        left += _change(geom, hold, weight)
    for name in asset_files(terrain.spec):
        source = inside(terrain.file.parent, name)
        check_size(source)
        write_bytes(inside(folder, name), read_bytes(source))
    write_text(folder / "scene.xml", spec.to_xml())
    return left


def _change(geom: Any, hold: Foothold, weight: float) -> list[str]:
    q, left = hold.quantities, []
    for kind in hold.changes:
        if kind == "height":
            geom.pos = np.asarray(geom.pos) + np.array([0.0, 0.0, q["height"].value])
        elif kind == "tilt":
            turn = quaternion(q["tilt_x"].value, q["tilt_y"].value)
            top = np.array(hold.place)
            R = quat_to_R(turn)
            geom.pos, geom.quat = top + R @ (np.asarray(geom.pos) - top), multiply(turn, np.asarray(geom.quat))
        elif kind == "slip" and "friction" in q:
            put(geom, "friction", 0, q["friction"].value)
            geom.priority = 1
        elif kind == "give":
            # A contact of stiffness k (MuJoCo's negative solref) that sinks as far under the robot's weight.
            k = weight / max(q["give"].value, 1e-4)
            geom.solref, geom.priority = np.array([-k, -0.1 * k]), 1
            left.append(f"{hold.name}: its softness is put into the contact; how it swings is not known")
        else:
            left.append(f"{hold.name}: {kind} is not put into the corrected scene")
    return left
