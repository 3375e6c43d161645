"""A sub-terrain for mjlab's terrain generator: its version 1.6 takes generators and planes, and no mesh."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import write_text
from realsim.core.geometry import R_to_quat
from realsim.export.formats.scene import SceneOnDisk, height_nodes

MARGIN = 1.0  # metres of floor around the terrain
DEPTH = 1.0  # metres of floor below it

MODULE = '''"""A terrain that realsim measured, as a sub-terrain of mjlab (1.6):

    cfg = TerrainGeneratorCfg(size=SIZE, sub_terrains={"scene": ScannedTerrainCfg()})
"""

import json
from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab.terrains.terrain_generator import SubTerrainCfg, TerrainGeometry, TerrainOutput

SCENE = json.loads("""%s""")
SIZE = tuple(SCENE["size"])


@dataclass(kw_only=True)
class ScannedTerrainCfg(SubTerrainCfg):
  """The collision geometry of one scene: the same at every difficulty, its floor at z = 0."""

  def function(self, difficulty: float, spec: mujoco.MjSpec, rng: np.random.Generator) -> TerrainOutput:
    if np.less(self.size, np.array(SIZE) - 1e-6).any():
      raise ValueError(f"this terrain needs TerrainGeneratorCfg(size={SIZE}) or more, not {self.size}")
    body, made = spec.body("terrain"), []
    middle = np.array([self.size[0] / 2, self.size[1] / 2, 0.0])
    if SCENE["floor_depth"]:
      half = [self.size[0] / 2, self.size[1] / 2, SCENE["floor_depth"] / 2]
      made.append(body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle - [0, 0, half[2]], size=half))
    for box in SCENE["boxes"]:
      made.append(
        body.add_geom(
          type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle + box["pos"], quat=box["quat"], size=box["half"]
        )
      )
    for name, corners in SCENE["convex"].items():
      if not any(mesh.name == name for mesh in spec.meshes):
        spec.add_mesh(name=name, uservert=np.ravel(corners))
      made.append(body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=middle))
    for field in SCENE["height_fields"]:
      name = f"realsim_{len(spec.hfields)}"
      z = np.array(field["z"])
      spec.add_hfield(name=name, nrow=z.shape[0], ncol=z.shape[1], size=field["size"], userdata=z.ravel())
      geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=name, pos=middle + field["pos"])
      geom.solref[0], geom.solmix = 0.01, 1e6  # what sinks half a cell deep into a height field never gets out
      made.append(geom)
    return TerrainOutput(middle + SCENE["origin"], [TerrainGeometry(geom=geom) for geom in made])
'''


def mjlab(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """realsim_terrain.py: a `SubTerrainCfg` that adds the boxes and convex parts of the scene, x y about the middle of
    the patch, the floor at z = 0; robots begin on the start platform, without one on the floor beside the terrain.

    mjlab shifts a patch only along x and y, and the floor of a patch ends where the patch does.
    """
    z = scene.floor_z if scene.floor_z is not None else float(scene.bounds[0, 2])
    shift = -np.array([*scene.bounds.mean(0)[:2], z])
    size = np.ptp(scene.bounds, axis=0)[:2] + 2 * MARGIN
    start = scene.sites.get("start")
    origin = np.array([(MARGIN - size[0]) / 2, 0.0, 0.0]) if start is None else start[0] + shift
    content: dict[str, Any] = {
        "size": _short(size),
        "origin": _short(origin),
        "floor_depth": DEPTH if scene.floor_z is not None else 0.0,
        "boxes": [],
        "convex": {f"realsim_{part.name}": _short(part.vertices + shift) for part in scene.convex},
        "height_fields": [_height_field(part.vertices + shift) for part in scene.surfaces],
    }
    for box in scene.boxes:
        low, high = box.position + shift - box.half, box.position + shift + box.half
        if np.allclose(box.rotation, np.eye(3)):  # floors reach far beyond the patch
            low[:2], high[:2] = np.maximum(low[:2], -size / 2), np.minimum(high[:2], size / 2)
        if (high > low).all():
            place = {"pos": _short((low + high) / 2), "quat": _short(R_to_quat(box.rotation), 9)}
            content["boxes"].append(place | {"half": _short((high - low) / 2)})
    path = folder / "realsim_terrain.py"
    write_text(path, MODULE % json.dumps(content))
    return [path]


def _height_field(vertices: np.ndarray) -> dict[str, Any]:
    z, size, pos = height_nodes(vertices, DEPTH)
    return {"size": _short(size), "pos": _short(pos), "z": _short(z)}


def _short(values: Any, digits: int = 5) -> Any:
    return (np.round(values, digits) + 0.0).tolist()
