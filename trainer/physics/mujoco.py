"""MuJoCo on the CPU: `mujoco.rollout` steps all worlds on all cores, one call a policy step.

Each world has a model of its own (shared with the others of its terrain while nothing is randomised). Sensors watch
for contact over all physics steps. A model without physics gives the frames at the end of the policy step: the sensors
of the physics model are one step behind the state.
"""

import copy
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco import rollout
from numpy.typing import NDArray
from torch import Tensor

from realsim.core.types import F64
from trainer.physics import edits
from trainer.physics.base import MAX_SPEED, PhysicsConfig, State, WorldParams, empty_state
from trainer.physics.sensors import ContactReader, FrameReader
from trainer.physics.world import check_order, slots_for, world_spec
from trainer.robots import TrainedRobot
from trainer.terrain import Terrain


class MujocoPhysics:
    """See `trainer.physics.base.Physics`."""

    def __init__(self, robot: TrainedRobot, terrains: Sequence[Terrain], worlds: int, config: PhysicsConfig) -> None:
        self.robot, self.terrains, self.num_worlds, self.config = robot, terrains, worlds, config
        self.device = torch.device("cpu")
        self.policy_dt = config.timestep * config.decimation
        self.overflowed = self.solver_limited = 0
        self._slots = slots_for(terrains)
        self._threads = config.threads or len(os.sched_getaffinity(0))
        self._pool = rollout.Rollout(nthread=self._threads if self._threads > 1 else 0)
        self._nominal: dict[int, Any] = {}
        self._datas: dict[tuple[int, ...], list[Any]] = {}
        self._terrain = np.zeros(worlds, int)
        self._edits: list[edits.Edit] = [{} for _ in range(worlds)]
        self._models: list[Any] = [None] * worlds
        self._spare: dict[int, list[Any]] = defaultdict(list)
        self._delay = np.zeros(worlds, int)

        first = self._terrain_model(0)
        check_order(robot, first)
        self._contacts = ContactReader(robot, first, config.self_collision)
        self._frames = FrameReader(robot, self._pool, self._threads)
        self._nq, self._nv = first.nq, first.nv
        self._full = np.zeros((worlds, mujoco.mj_stateSize(first, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
        self._qpos = self._full[:, 1 : 1 + self._nq]
        self._qvel = self._full[:, 1 + self._nq : 1 + self._nq + self._nv]
        self._warmstart = np.zeros((worlds, self._nv))
        self._targets = np.tile(robot.default, (worlds, 1))
        self.state: State = empty_state(robot, worlds, self.device)
        everyone = torch.arange(worlds)
        base = torch.tensor([0.0, 0.0, robot.standing_height]).repeat(worlds, 1)
        upright = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(worlds, 1)
        default = torch.tensor(robot.default, dtype=torch.float32).repeat(worlds, 1)
        self.reset(everyone, base, upright, default, torch.zeros(worlds, dtype=torch.long))

    def step(self, targets: Tensor) -> State:
        """See `Physics.step`. Commands of a world with delay d act from its d-th physics step on."""
        wanted = targets.detach().cpu().numpy().astype(float)
        finite = np.isfinite(wanted).all(axis=1)  # MuJoCo would take zero for a target that is no number
        wanted[~finite] = self._targets[~finite]
        late = self._delay[:, None] > np.arange(self.config.decimation)
        control = np.where(late[:, :, None], self._targets[:, None], wanted[:, None])
        self._targets = wanted

        states, sensors = self._rollout(control)
        qvel = states[:, :, 1 + self._nq : 1 + self._nq + self._nv]
        diverged = self._diverged(states[:, -1]) | ~finite
        alive = ~diverged
        self._warmstart[alive] = (qvel[alive, -1] - qvel[alive, -2]) / self.config.timestep
        acceleration = (qvel[:, -1, 6:] - self._qvel[:, 6:]) / self.policy_dt
        # A diverged world stays where it last was sound, so that whoever reads it before the reset sees finite numbers.
        self._full[alive] = states[alive, -1]
        self._write(np.arange(self.num_worlds))
        _put(self.state.joint_acc, np.where(alive[:, None], acceleration, 0.0))
        self._contacts.write(self.state, np.where(alive[:, None, None], sensors, 0.0))
        _put(self.state.diverged, diverged)
        return self.state

    def reset(
        self,
        ids: Tensor,
        base_pos: Tensor,
        base_quat: Tensor,
        joint_pos: Tensor,
        terrain_ids: Tensor,
    ) -> None:
        """See `Physics.reset`."""
        worlds = ids.cpu().numpy()
        self._full[worlds] = 0.0
        self._qpos[worlds] = torch.cat([base_pos, base_quat, joint_pos], dim=1).cpu().numpy()
        self._warmstart[worlds] = 0.0
        self._targets[worlds] = joint_pos.cpu().numpy()
        self._release(worlds)
        self._terrain[worlds] = terrain_ids.cpu().numpy()
        self._write(worlds)
        for tensor in (self.state.joint_acc, self.state.joint_torque, self.state.foot_force):
            tensor[ids] = 0.0
        for flag in (self.state.ground_contact, self.state.other_contact, self.state.diverged):
            flag[ids] = False

    def set_velocity(self, ids: Tensor, base_lin_vel: Tensor, base_ang_vel: Tensor) -> None:
        """See `Physics.set_velocity`."""
        worlds = ids.cpu().numpy()
        self._qvel[worlds, :6] = torch.cat([base_lin_vel, base_ang_vel], dim=1).cpu().numpy()
        self._write(worlds)

    def set_params(self, ids: Tensor, params: WorldParams) -> None:
        """See `Physics.set_params`. Models are built at the next step: a reset in between costs nothing more."""
        worlds = ids.cpu().numpy()
        self._release(worlds)
        for world, edit in zip(worlds, edits.rows(params), strict=False):
            if "delay_steps" in edit:
                self._delay[world] = int(edit.pop("delay_steps"))
            self._edits[world] |= edit

    def _rollout(self, control: F64) -> tuple[F64, F64]:
        """All worlds over one policy step, worlds with models of the same size together (they share the data)."""
        groups: dict[tuple[int, ...], list[int]] = {}
        for world in range(self.num_worlds):
            groups.setdefault(_size(self._model(world)), []).append(world)
        states = np.empty((self.num_worlds, self.config.decimation, self._full.shape[1]))
        sensors = np.empty((self.num_worlds, self.config.decimation, self._contacts.width))
        for worlds in groups.values():
            models = [self._models[w] for w in worlds]
            datas = self._datas_for(models[0])
            states[worlds], sensors[worlds] = self._pool.rollout(
                models,
                datas,
                self._full[worlds],
                control[worlds],
                initial_warmstart=self._warmstart[worlds],
                nstep=self.config.decimation,
            )
            self.overflowed += sum(int(d.warning[w].number) for d in datas for w in _FULL)
        return states, sensors

    def _model(self, world: int) -> Any:
        if self._models[world] is None:
            index, edit = int(self._terrain[world]), self._edits[world]
            model = nominal = self._terrain_model(index)
            if edit:
                # Copying a model takes longer than simulating a policy step: copies are handed on between worlds.
                model = self._spare[index].pop() if self._spare[index] else copy.copy(nominal)
                edits.apply(model, nominal, self.robot, edit, self._datas_for(model)[0])
            self._models[world] = model
        return self._models[world]

    def _release(self, worlds: NDArray[np.int_]) -> None:
        for world in worlds:
            model, index = self._models[world], int(self._terrain[world])
            if model is not None and model is not self._nominal[index]:
                self._spare[index].append(model)
            self._models[world] = None

    def _datas_for(self, model: Any) -> list[Any]:
        """One `MjData` a thread for all models of this size."""
        size = _size(model)
        if size not in self._datas:
            self._datas[size] = [mujoco.MjData(model) for _ in range(self._threads)]
        return self._datas[size]

    def _terrain_model(self, index: int) -> Any:
        if index not in self._nominal:
            terrain = self.terrains[index]
            spec = world_spec(self.robot, terrain, 0 if terrain.contact is not None else self._slots, self.config)
            ContactReader.add_sensors(spec, self.robot, self.config.self_collision)
            if self.config.jacobian == "auto":
                spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE  # a fifth faster than MuJoCo's choice for G1
            self._nominal[index] = spec.compile()
        return self._nominal[index]

    def _diverged(self, full: F64) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            qvel = np.abs(full[:, 1 + self._nq : 1 + self._nq + self._nv])
            sane = (qvel[:, :3].max(axis=1) < MAX_SPEED) & (qvel[:, 3:].max(axis=1) < 10 * MAX_SPEED)
            return ~(sane & np.isfinite(full).all(axis=1))

    def _write(self, worlds: NDArray[np.int_]) -> None:
        """Positions and velocities of these worlds from the present state into `self.state`."""
        qpos, qvel, state = self._qpos[worlds], self._qvel[worlds], self.state
        _put(state.base_pos, qpos[:, :3], worlds)
        _put(state.base_quat, qpos[:, 3:7], worlds)
        _put(state.base_lin_vel, qvel[:, :3], worlds)
        _put(state.base_ang_vel, qvel[:, 3:6], worlds)
        _put(state.joint_pos, qpos[:, 7:], worlds)
        _put(state.joint_vel, qvel[:, 6:], worlds)
        self._frames.write(state, self._full[worlds], worlds)


_FULL = (mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL)


def _size(model: Any) -> tuple[int, ...]:
    """What the memory layout of a model's data depends on, given that the robot is the same."""
    return model.ngeom, model.nbvh, model.nbvhdynamic, model.narena


def _put(tensor: Tensor, values: NDArray[Any], worlds: NDArray[np.int_] | None = None) -> None:
    tensor.numpy()[slice(None) if worlds is None else worlds] = values


def elliptic(robot: TrainedRobot, terrains: Sequence[Terrain], worlds: int, config: PhysicsConfig) -> MujocoPhysics:
    """The engine `elliptic`: what a policy makes of another contact model than the one that it knows."""
    other = replace(
        config,
        timestep=config.timestep / 2,
        decimation=2 * config.decimation,
        cone="elliptic",
        solver="cg",
        iterations=100,
        ls_iterations=50,
    )
    return MujocoPhysics(robot, terrains, worlds, other)
