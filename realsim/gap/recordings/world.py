"""The base's pose in the frame of a scene: a report says how its scene lies in the world of its capture."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import read_json
from realsim.core.types import F64


@dataclass(frozen=True)
class World:
    """From the world of a capture, in which the log's base poses are, to its scene."""

    scene: Path
    T_sim_world: F64
    """(4, 4), rigid."""
    scale: float
    """By which lengths of the capture were multiplied before."""

    def place(self, pos: F64) -> F64:
        """(T, 3) m in the scene's frame."""
        return np.asarray(self.scale * pos @ self.T_sim_world[:3, :3].T + self.T_sim_world[:3, 3])

    def turn(self, quat: F64) -> F64:
        """(T, 4) w x y z in the scene's frame; rows without a value stay so."""
        from scipy.spatial.transform import Rotation

        good = np.isfinite(quat).all(axis=1)
        out = quat.copy()
        turned = Rotation.from_matrix(self.T_sim_world[:3, :3]) * Rotation.from_quat(quat[good], scalar_first=True)
        out[good] = turned.as_quat(scalar_first=True)
        return out


def load_world(scene: Path) -> World:
    """From report.json beside scene.xml (its folder will do).

    Raises:
        GapError: no report, or poses of the capture were not used, so that its world was chosen and no log is in it.
    """
    folder = scene if scene.is_dir() else scene.parent
    report = folder / "report.json"
    expected = "a scene of `realsim reconstruct` with report.json"
    if not report.is_file():
        raise GapError("how the scene lies is not known", file=scene, expected=expected, found="no report.json")
    written = read_json(report)
    written = written if isinstance(written, dict) else {}
    if written.get("world") == "chosen by the backend":
        raise GapError(
            "the scene was made without poses of its capture", file=report,
            expected="a capture whose poses are in the frame of the log's base pose", found="a world of its own",
        )  # fmt: skip
    try:
        T, scale = np.array(written["T_sim_world"], float), float(written["scale"]["value"])
        R = T[:3, :3]
        good = T.shape == (4, 4) and np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0
        good = good and 0 < scale < np.inf
    except (IndexError, KeyError, TypeError, ValueError):
        good = False
    if not good:
        raise GapError(
            "how the scene lies cannot be read", file=report, expected=f"{expected}, with T_sim_world, scale"
        )
    return World(scene, T, scale)
