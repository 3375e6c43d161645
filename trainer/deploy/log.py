"""A run of the loop as a case: what `realsim diagnose`, `diagnose --policy` and `realsim footholds` read.

    CASE/model.xml, log.json     the robot on its terrain, and what the arrays are
    CASE/runs/run_0.npz          clock, commands, states, contact, depth; observations and actions of the policy
    CASE/policy.onnx             the policy; deploy.json has its hash, and how each run went

Samples stay in memory while the robot moves, so that no disk delays a step, and are written once it has stopped.
"""

import io
import tempfile
from contextlib import nullcontext
from dataclasses import asdict
from math import radians, tan
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import (
    check_room,
    digest,
    output_folder,
    read_bytes,
    read_json,
    to_json,
    write_bytes,
    write_text,
)
from realsim.core.geometry import R_to_quat, quat_to_R
from trainer.config import DeployConfig
from trainer.deploy.robot import Reading
from trainer.errors import TrainerError
from trainer.physics import PhysicsConfig
from trainer.physics.world import slots_for, world_spec
from trainer.ppo.export import Deployment
from trainer.robots import TrainedRobot
from trainer.robots.base import DepthMount
from trainer.tasks.parkour.depth import kept_pixels
from trainer.terrain import Terrain

CAMERA, IMU = "policy_depth", "policy_imu"
"""Names that the model gets for the policy's camera and the base frame's gyroscope."""
_LOOK = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], float)
"""Columns: a MuJoCo camera's right, up and back in the axes of a mount (x optical axis, y left, z up)."""
_SPARE = 50e6
"""Bytes of disk that must be free beside what the run itself will need."""
SIGNALS = ("base_pos", "base_quat", "contact", "joint_torque")
"""Fields of a `Reading` that not every robot has."""


class CaseLog:
    """Remembers the steps of one run and writes them as a run of a case.

    Args:
        folder: the case; a new one, or one of the same robot, terrain and policy, which gets a further run.
        body, terrain: what model.xml is made of; the terrain as the operator believes in it.
        policy: policy.onnx.
        facts: its metadata.
        config: of the loop.

    Raises:
        RealsimError: the folder holds something else, or the disk has no room for the run.
    """

    def __init__(
        self, folder: Path, body: TrainedRobot, terrain: Terrain, policy: Path, facts: Deployment, config: DeployConfig
    ) -> None:
        self.folder, self.body, self.terrain, self.policy, self.facts = folder, body, terrain, policy, facts
        self.identity = {
            "policy": digest(read_bytes(policy)),
            "robot": facts.robot,
            "terrain": terrain.name,
            "config": asdict(config),
        }
        self.samples: dict[str, list[Any]] = {}
        self.first: Reading | None = None
        self.runs: dict[str, Any] = {}
        self._check(config)

    def add(
        self,
        time: float,
        reading: Reading,
        inputs: dict[str, Any],
        command: Any,
        speed: float,
        action: Any,
        targets: Any,
    ) -> None:
        """One step: `time` in s of the reading, what the policy saw, was told (3,) and answered, and the joint targets
        that were sent."""
        row = {
            "time": time,
            "command": targets,
            "joint_pos": reading.joint_pos,
            "joint_vel": reading.joint_vel,
            "imu_gyro": reading.ang_vel,
            "observation": inputs["vector"][0],
            "action": action,
            "speed": speed,
            "policy_command": command,
            **{name: getattr(reading, name) for name in SIGNALS if getattr(reading, name) is not None},
        }
        if reading.depth is not None:
            row |= {"depth": np.nan_to_num(reading.depth), "depth_time": time}
        self.first = self.first or reading
        for name, value in row.items():
            self.samples.setdefault(name, []).append(np.array(value, np.float32 if name == "depth" else float))

    def write(self, outcome: dict[str, Any]) -> Path | None:
        """The run with how it went; its file, None if there was no step.

        Raises:
            TrainerError: it cannot be written; where a folder for temporary files has room it is kept there.
        """
        if self.first is None:
            return None
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {name: np.array(values) for name, values in self.samples.items()}
        begun = arrays["time"][0]
        arrays |= {name: arrays[name] - begun for name in ("time", "depth_time") if name in arrays}
        np.savez_compressed(buffer, **arrays, **self._state(self.first))
        name = f"run_{len(self.runs)}"
        further = (self.folder / "deploy.json").is_file()
        try:  # a new case appears whole or not at all
            with nullcontext(self.folder) if further else output_folder(self.folder) as folder:
                self._write_run(folder, name, buffer.getvalue(), outcome)
        except (OSError, RealsimError) as error:
            found = error.found if isinstance(error, RealsimError) else str(error)
            raise TrainerError(
                "the log could not be written", file=self.folder, found=found, hint=_rescued(name, buffer)
            ) from error
        self.runs[name] = outcome
        return self.folder / "runs" / f"{name}.npz"

    def _state(self, reading: Reading) -> dict[str, Any]:
        """init_qpos and init_qvel of a case, where the whole state is known: MuJoCo has the base's velocity in the
        world and its turning in its own axes."""
        if reading.base_lin_vel is None or reading.base_pos is None or reading.base_quat is None:
            return {}
        model = self._spec().compile()
        joints = [model.joint(name) for name in self.body.joints]
        qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
        qpos[:7] = np.concatenate([reading.base_pos, reading.base_quat])
        qvel[:6] = np.concatenate([reading.base_lin_vel, reading.ang_vel])
        qpos[[int(j.qposadr[0]) for j in joints]] = reading.joint_pos
        qvel[[int(j.dofadr[0]) for j in joints]] = reading.joint_vel
        return {"init_qpos": qpos, "init_qvel": qvel}

    def _spec(self) -> Any:
        spec = world_spec(self.body, self.terrain, slots_for([self.terrain]), PhysicsConfig())
        spec.body(self.body.base).add_site(name=IMU)
        return spec

    def _write_run(self, folder: Path, name: str, arrays: bytes, outcome: dict[str, Any]) -> None:
        self._write_head(folder)
        file = folder / "runs" / f"{name}.npz"
        write_bytes(file, arrays)
        try:
            write_text(folder / "deploy.json", to_json(self.identity | {"runs": self.runs | {name: outcome}}))
        except RealsimError:
            file.unlink()
            raise

    def _check(self, config: DeployConfig) -> None:
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            known = self.folder / "deploy.json"
            before = read_json(known) if known.is_file() else {}
            same = isinstance(before, dict) and all(
                before.get(k) == self.identity[k] for k in ("policy", "robot", "terrain")
            )
            if not same:
                raise TrainerError(
                    "the folder holds something else than runs of this policy on this terrain",
                    file=self.folder,
                    expected="a new folder, or a case that `realsim deploy --log` began with the same policy and scene",
                    found=", ".join(sorted(p.name for p in self.folder.iterdir())[:5])
                    if self.folder.is_dir()
                    else "a file",
                )
            self.runs = dict(before.get("runs", {}))
        width = self.facts.layout.actor_width + 8 * len(self.facts.layout.actions) + 30
        pixels = int(np.prod(self.facts.layout.depth[1:])) if self.facts.layout.depth else 0
        need = config.seconds / self.facts.policy_dt * (8 * width + 4 * pixels) + _SPARE
        check_room(self.folder, need, "the disk has no room for the log: the robot was not started")

    def _write_head(self, folder: Path) -> None:
        spec = self._spec()
        log: dict[str, Any] = {
            "joint_names": list(self.body.joints),
            "actuator_names": list(self.body.joints),
            "command_kind": "position",
            "command_hold": "zoh",
            "base": "floating",
            "torque_kind": "measured" if "joint_torque" in self.samples else "none",
            "imu_site": IMU,
            "contact_bodies": list(self.body.feet) if "contact" in self.samples else [],
            "notes": f"recorded by realsim deploy, policy {str(self.identity['policy'])[:12]}",
        }
        if self.body.camera is not None and "depth" in self.samples:
            camera = self.body.camera
            quat = R_to_quat(quat_to_R(camera.quat) @ _LOOK)
            spec.body(camera.body).add_camera(name=CAMERA, pos=camera.pos, quat=quat, fovy=camera.fovy_deg)
            log["depth_camera"] = pinhole(camera)
        spec.compile()
        write_text(folder / "model.xml", spec.to_xml())
        write_text(folder / "log.json", to_json(log))
        if not (folder / "policy.onnx").is_file():
            write_bytes(folder / "policy.onnx", read_bytes(self.policy))


def pinhole(mount: DepthMount) -> dict[str, Any]:
    """The camera of log.json for the pixels that the policy sees."""
    rows, columns = kept_pixels(mount)
    width, height = mount.full
    focal = height / 2 / tan(radians(mount.fovy_deg) / 2)
    step_x, step_y = width / mount.small[0], height / mount.small[1]
    cx = np.mean(np.arange(len(columns)) - (columns + 0.5 - width / 2) / step_x)
    cy = np.mean(np.arange(len(rows)) - (rows + 0.5 - height / 2) / step_y)
    return {"camera": CAMERA, "fx": focal / step_x, "fy": focal / step_y, "cx": float(cx), "cy": float(cy)}


def _rescued(name: str, buffer: io.BytesIO) -> str:
    kept: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(prefix=f"{name}_", suffix=".npz", delete=False) as file:
            kept = Path(file.name)
            file.write(buffer.getvalue())
        return f"the run is kept in {kept}"
    except OSError as error:
        if kept is not None:
            kept.unlink(missing_ok=True)
        return f"it could not be kept elsewhere either: {error}"
