"""What the CPU engine reads from MuJoCo's sensors, and where it writes it."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64
from trainer.physics.base import State
from trainer.physics.world import GROUND
from trainer.robots import TrainedRobot

_FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
_FORCE = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
_NO_REDUCTION, _NET_FORCE = 0, 3
_BODY, _SUBTREE, _GEOM = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM


class ContactReader:
    """Contacts and servo torques over the physics steps of a policy step.

    "Anything but a foot touches" is a difference of counts: contacts of the whole robot less those of its feet.
    """

    def __init__(self, robot: TrainedRobot, model: Any, self_collision: bool) -> None:
        feet = len(robot.feet)
        self.width = int(model.nsensordata)
        counts = 2 + self_collision + feet + self_collision * feet * (feet - 1) // 2
        self._feet, self._self_collision = feet, self_collision
        self._forces = slice(counts, counts + 3 * feet)
        self._torques = slice(counts + 3 * feet, counts + 3 * feet + len(robot.joints))

    @staticmethod
    def add_sensors(spec: Any, robot: TrainedRobot, self_collision: bool) -> None:
        """In this order: ground, robot on terrain, feet on terrain, [robot on itself, foot pairs], forces, torques."""
        add = spec.add_sensor

        def count(objtype: Any, obj: str, reftype: Any = mujoco.mjtObj.mjOBJ_UNKNOWN, ref: str = "") -> None:
            _contact(spec, [_FOUND, _NO_REDUCTION, 1], objtype, obj, reftype, ref)

        count(_GEOM, GROUND)
        count(_SUBTREE, robot.base, _BODY, "world")
        for foot in robot.feet:
            count(_BODY, foot, _BODY, "world")
        if self_collision:
            count(_SUBTREE, robot.base, _SUBTREE, robot.base)
            for i, foot in enumerate(robot.feet):
                for other in robot.feet[:i]:
                    count(_BODY, foot, _BODY, other)
        for foot in robot.feet:
            _contact(spec, [_FORCE, _NET_FORCE, 1], _BODY, foot)
        for joint in robot.joints:
            add(type=mujoco.mjtSensor.mjSENS_ACTUATORFRC, objtype=mujoco.mjtObj.mjOBJ_ACTUATOR, objname=joint)

    def write(self, state: State, sensors: F64) -> None:
        """From sensor data (N, S, width) of S physics steps into the state of all N worlds."""
        feet = slice(2, 2 + self._feet)
        state.ground_contact.numpy()[:] = (sensors[:, :, 0] > 0).any(axis=1)
        other = sensors[:, :, 1] > sensors[:, :, feet].sum(axis=2)
        if self._self_collision:
            own, pairs = 2 + self._feet, slice(3 + self._feet, self._forces.start)
            other |= sensors[:, :, own] > sensors[:, :, pairs].sum(axis=2)
        state.other_contact.numpy()[:] = other.any(axis=1)
        forces = sensors[:, -1, self._forces].reshape(len(sensors), self._feet, 3)
        state.foot_force.numpy()[:] = np.linalg.norm(forces, axis=2)
        state.joint_torque.numpy()[:] = sensors[:, -1, self._torques]


class FrameReader:
    """Poses of torso, camera body and feet, and the feet's velocities, at a state given.

    They come from one step of the bare robot with every force switched off, whose sensors belong to the step's start.
    """

    def __init__(self, robot: TrainedRobot, pool: Any, threads: int) -> None:
        spec = robot.robot.spec.copy()
        for flag in ("CONTACT", "CONSTRAINT", "ACTUATION", "GRAVITY", "EULERDAMP", "AUTORESET"):
            spec.option.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
        self._camera = robot.camera.body if robot.camera else robot.torso
        for body in (robot.torso, self._camera, *robot.feet):
            _frame(spec, "FRAMEPOS", body)
            _frame(spec, "FRAMEQUAT", body)
        for foot in robot.feet:
            _frame(spec, "FRAMELINVEL", foot)
            _frame(spec, "FRAMEANGVEL", foot)
        self._model, self._pool, self._feet = spec.compile(), pool, len(robot.feet)
        self._datas = [mujoco.MjData(self._model) for _ in range(threads)]

    def write(self, state: State, full: F64, worlds: NDArray[np.int_]) -> None:
        """Of the worlds with state rows `full` (K, n), into rows `worlds` (K,)."""
        if len(worlds) == 0:
            return
        _, sensors = self._pool.rollout(self._model, self._datas, full, nstep=1)
        poses, velocities = np.split(sensors[:, 0], [7 * (2 + self._feet)], axis=1)
        poses = poses.reshape(len(worlds), 2 + self._feet, 7)
        velocities = velocities.reshape(len(worlds), self._feet, 6)
        state.torso_pos.numpy()[worlds], state.torso_quat.numpy()[worlds] = poses[:, 0, :3], poses[:, 0, 3:]
        state.camera_pos.numpy()[worlds], state.camera_quat.numpy()[worlds] = poses[:, 1, :3], poses[:, 1, 3:]
        state.foot_pos.numpy()[worlds], state.foot_quat.numpy()[worlds] = poses[:, 2:, :3], poses[:, 2:, 3:]
        state.foot_lin_vel.numpy()[worlds] = velocities[:, :, :3]
        state.foot_ang_vel.numpy()[worlds] = velocities[:, :, 3:]


def _contact(
    spec: Any, intprm: list[int], objtype: Any, obj: str, reftype: Any = mujoco.mjtObj.mjOBJ_UNKNOWN, ref: str = ""
) -> None:
    spec.add_sensor(
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=objtype,
        objname=obj,
        reftype=reftype,
        refname=ref,
        intprm=intprm,
    )


def _frame(spec: Any, kind: str, body: str) -> None:
    """Of the body's own frame (XBODY), not of its inertia's."""
    kind = getattr(mujoco.mjtSensor, f"mjSENS_{kind}")
    spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=body)
