"""Where every fixed geom of the one GPU model stands in each terrain.

All worlds share one model. A terrain is a choice of poses and sizes for its static geoms: boxes go into slots, geoms of
other scenes are parked out of reach, the ground plane goes to the terrain's height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from trainer.physics.world import GROUND, PARKED_Z, SCENE, SLOT, box_poses
from trainer.terrain import Terrain


@dataclass(frozen=True)
class StaticGeoms:
    """Tables over T terrains: all S static geoms, of which K are box slots. float32 on the engine's device."""

    geoms: Tensor
    """(S,) geom numbers in the model."""
    pos: Tensor
    """(T, S, 3) metres."""
    mat: Tensor
    """(T, S, 3, 3)."""
    slots: Tensor
    """(K,) geom numbers of the box slots."""
    half: Tensor
    """(T, K, 3) half edges, metres."""

    @classmethod
    def of(cls, model: Any, terrains: Sequence[Terrain], device: torch.device) -> StaticGeoms:
        """Read from a model that `world_spec` made with the contacts of all these terrains."""
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        names = {model.geom(g).name: g for g in range(model.ngeom) if model.geom_bodyid[g] == 0}
        geoms = np.array(sorted(names.values()))
        slots = np.array([names[f"{SLOT}{k}"] for k in range(sum(n.startswith(SLOT) for n in names))], int)
        pos = np.repeat(data.geom_xpos[None], len(terrains), axis=0)
        mat = np.repeat(data.geom_xmat.reshape(1, -1, 3, 3), len(terrains), axis=0)
        half = np.zeros((len(terrains), len(slots), 3))
        for t, terrain in enumerate(terrains):
            half[t], pos[t, slots], mat[t, slots] = box_poses(terrain, len(slots))
            pos[t, names[GROUND], 2] = terrain.floor_z
            for name, geom in names.items():
                if name.startswith(SCENE) and not name.startswith(f"{SCENE}{t}/"):
                    pos[t, geom, 2] = PARKED_Z

        def tensor(array: np.ndarray) -> Tensor:
            return torch.as_tensor(array, dtype=torch.float32, device=device)

        return cls(
            torch.as_tensor(geoms, device=device),
            tensor(pos[:, geoms]),
            tensor(mat[:, geoms]),
            torch.as_tensor(slots, device=device),
            tensor(half),
        )
