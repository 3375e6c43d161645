"""The terrain alone: the height and the geom below a point, by rays through MuJoCo's colliding geoms."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.models import load_mjcf
from realsim.core.types import F64, MjData, MjModel, MjSpec

CELL = 0.3
"""m: a geom that is larger is divided into squares of this size, about what a robot's foot treads on in one place."""


@dataclass(frozen=True)
class Terrain:
    """What stands still in a scene and can be touched."""

    spec: MjSpec
    """mujoco.MjSpec, unchanged."""
    model: MjModel
    data: MjData
    file: Path

    def below(self, point: F64, above: float) -> tuple[float, int]:
        """(z of the first surface below `point` (3,) raised by `above`, its geom); (-inf, -1) where there is none."""
        import mujoco

        geom = np.full(1, -1, np.int32)
        start = point + np.array([0.0, 0.0, above])
        far = mujoco.mj_ray(self.model, self.data, start, _DOWN, _ONLY, 1, -1, geom)
        return (float(start[2] - far), int(geom[0])) if far >= 0 else (-np.inf, -1)

    def foothold(self, geom: int, point: F64) -> tuple[str, F64, F64]:
        """(name, (2,) middle, (3, 3) axes) of the foothold at a point on a geom: the geom, or a square of it."""
        axes = self.data.geom_xmat[geom].reshape(3, 3)
        origin = self.data.geom_xpos[geom]
        local = (point - origin) @ axes
        cell = np.round(local[:2] / CELL)
        kind, size = int(self.model.geom_type[geom]), self.model.geom_size[geom]
        box = kind == 6  # mjGEOM_BOX
        for axis in range(2):
            if box and 2 * size[axis] <= 1.5 * CELL:
                cell[axis] = 0
        name = self.name(geom)
        if cell.any() or not box:
            name += f"[{cell[0]:+.0f},{cell[1]:+.0f}]"
        middle = origin + axes @ np.array([*(cell * CELL), local[2]])
        return name, middle[:2], axes

    def name(self, geom: int) -> str:
        """Of a geom, or of its body where it has none."""
        found = self.model.geom(geom).name or self.model.body(int(self.model.geom_bodyid[geom])).name
        return str(found or f"geom {geom}")


_DOWN = np.array([0.0, 0.0, -1.0])
_ONLY = np.array([1, 0, 0, 0, 0, 0], np.uint8)
_SEEN, _UNSEEN = 0, 5


def load_terrain(path: Path) -> Terrain:
    """The terrain of a scene.xml (its folder will do), or of a robot's model that stands on one.

    Raises:
        GapError: not a model that can be read safely, or nothing in it that a foot could touch.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "scene.xml"
    if not path.is_file():
        raise GapError("no such scene", file=path, expected="scene.xml, or the folder that holds it")
    spec, model, _ = load_mjcf(path, path.parent)
    return terrain_of(spec, model, path)


def terrain_of(spec: MjSpec, model: MjModel, file: Path) -> Terrain:
    """The static, colliding geoms of a compiled model; its groups and colours are overwritten, so give it a copy."""
    import mujoco

    solid = (model.geom_contype | model.geom_conaffinity) > 0
    static = model.body_weldid[model.geom_bodyid] == 0
    if not (solid & static).any():
        raise GapError(
            "the scene has nothing that a foot could touch", file=file, expected="colliding geoms of the world"
        )
    model.geom_group[:] = np.where(solid & static, _SEEN, _UNSEEN)
    model.geom_rgba[:, 3], model.geom_matid[:] = 1.0, -1  # rays pass through what is transparent
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return Terrain(spec, model, data, file)
