"""What the camera would see: depth of the scene along its pixels, from the logged pose of the robot."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from realsim.core.geometry import exp_so3
from realsim.core.types import F64, MjData, MjModel
from realsim.gap.case.case import Case
from realsim.gap.case.motion import Motion, estimate
from realsim.gap.checks.camera.recorded import DepthCamera, Frames
from realsim.gap.checks.camera.terrain import Terrain

GROUPS = np.array([1, 0, 0, 0, 0, 0], np.uint8)
TO_OPENCV = np.diag([1.0, -1.0, -1.0])
Correction = Callable[[int, float, F64], F64]
"""(run, s, place of the camera (3,)) -> (6,) m to add to it, and rotation vector to turn it by, world axes."""


@dataclass(frozen=True)
class Mount:
    """How the camera differs from model.xml, and how late its images are."""

    delay: float = 0.0
    """s"""
    turn: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) rad, a rotation vector in the camera's axes: x right, y down, z forward."""
    shift: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) m in the same axes."""

    @cached_property
    def rotation(self) -> F64:
        """(3, 3) of the turn."""
        return exp_so3(self.turn)


class View:
    """Frames of a log with the poses of their camera."""

    def __init__(
        self, case: Case, terrain: Terrain, camera: DepthCamera, frames: list[Frames], rays: F64,
        correction: Correction | None = None,
    ) -> None:  # fmt: skip
        import mujoco

        self.case, self.terrain, self.camera, self.frames, self.rays = case, terrain, camera, frames, rays
        self._correction = correction
        self._model = case.spec.copy().compile()
        self._data = mujoco.MjData(self._model)
        self._own = case.spec.copy().compile()
        # Of the robot itself only what can be seen: rays that meet it say nothing of the terrain.
        moving = self._own.body_weldid[self._own.geom_bodyid] != 0
        self._own.geom_group[:] = np.where(moving, 0, 5)
        self._own_data = mujoco.MjData(self._own)
        self._camera = self._model.camera(camera.name).id
        self._motions: dict[int, Motion] = {f.run: estimate(case, case.runs[f.run]) for f in frames}
        # Slopes by mount and base ask for the same few moments of the log again and again.
        self._corrected = lru_cache(8 * sum(len(f.time) for f in frames))(self._logged)
        self.hidden = [self._hides(f) for f in frames]

    def poses(self, which: int, mount: Mount, offsets: F64) -> tuple[F64, F64]:
        """((N, 3) m, (N, 3, 3) OpenCV axes in the world) of the camera when the images of one run were taken.

        `offsets` (N, 6): m and rad by which the logged poses are off, beside the correction.
        """
        from scipy.spatial.transform import Rotation

        frames = self.frames[which]
        logged = [self._corrected(frames.run, float(t) - mount.delay) for t in frames.time]
        places, R, corrections = (np.stack(part) for part in zip(*logged, strict=True))
        offsets = offsets + corrections
        R = Rotation.from_rotvec(offsets[:, 3:]).as_matrix() @ R
        return places + offsets[:, :3] + R @ mount.shift, R @ mount.rotation

    def _logged(self, run: int, time: float) -> tuple[F64, F64, F64]:
        """`_nominal`, and the correction (6,) of the base there."""
        place, R = self._nominal(run, time)
        return place, R, np.zeros(6) if self._correction is None else self._correction(run, time, place)

    def _nominal(self, run: int, time: float) -> tuple[F64, F64]:
        """By the logged state, straight between its samples."""
        import mujoco

        motion = self._motions[run]
        at = float(np.clip(time, motion.time[0], motion.time[-1]))
        n = int(np.clip(np.searchsorted(motion.time, at), 1, len(motion.time) - 1))
        share = (at - motion.time[n - 1]) / (motion.time[n] - motion.time[n - 1])
        self._data.qpos[:] = (1 - share) * motion.qpos[n - 1] + share * motion.qpos[n]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        R = self._data.cam_xmat[self._camera].reshape(3, 3) @ TO_OPENCV
        return self._data.cam_xpos[self._camera].copy(), R

    def depth(self, which: int, mount: Mount, offsets: F64) -> tuple[F64, Any]:
        """((N, P) m along the optical axis, 0 where nothing is, (N, P) geom) of the frames of one run.

        `offsets` (N, 6): see `poses`.
        """
        z, geoms = [], []
        for place, R in zip(*self.poses(which, mount, offsets), strict=True):
            along, geom = _cast(self.terrain.model, self.terrain.data, place, self.rays @ R.T)
            # Rays have z = 1 in the camera, so what they travel in their own length is the depth.
            z.append(np.where((along > 0) & (along <= self.camera.far), along, 0.0))
            geoms.append(geom)
        return np.array(z), np.array(geoms)

    def _hides(self, frames: Frames) -> Any:
        """(N, P) bool, whether the robot itself is in the way."""
        import mujoco

        found = []
        for t in frames.time:
            place, R = self._nominal(frames.run, float(t))
            self._own_data.qpos[:] = self._data.qpos
            mujoco.mj_kinematics(self._own, self._own_data)
            along, _ = _cast(
                self._own, self._own_data, place, self.rays @ R.T, exclude=int(self._own.cam_bodyid[self._camera])
            )
            found.append(along > 0)
        return np.array(found)


def _cast(model: MjModel, data: MjData, place: F64, directions: F64, exclude: int = -1) -> tuple[F64, Any]:
    import mujoco

    count = len(directions)
    geom, far = np.full(count, -1, np.int32), np.zeros(count)
    mujoco.mj_multiRay(
        model, data, place, np.ascontiguousarray(directions).ravel(), GROUPS, 1, exclude, geom, far, None, count, 1e3
    )
    return far, geom
