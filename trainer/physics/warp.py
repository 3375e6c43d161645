"""MuJoCo Warp: all worlds on one GPU, a policy step is one CUDA graph and waits for nothing.

Torch and Warp share memory: `state` is made of views of the simulation's arrays where their layout allows it. All
worlds have the same model; terrain, friction, masses and gains are rows of its fields that belong to a world.
"""

from __future__ import annotations

import gc
from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from trainer.errors import TrainerError
from trainer.physics import warp_kernels as kernels
from trainer.physics.base import MAX_SPEED, PhysicsConfig, State, WorldParams, empty_state
from trainer.physics.static_geoms import StaticGeoms
from trainer.physics.warp_compile import compile_for
from trainer.physics.warp_params import BATCHED, TERRAIN_FIELDS, WorldFields
from trainer.physics.world import GROUND, check_order, slots_for, world_spec
from trainer.robots import TrainedRobot
from trainer.terrain import Terrain

wp.config.log_level = wp.LOG_WARNING  # not a line for every kernel that is loaded


class WarpPhysics:
    """See `trainer.physics.base.Physics`.

    Raises:
        TrainerError: no such device.
        torch.OutOfMemoryError: the device has not the memory for that many worlds.
    """

    def __init__(self, robot: TrainedRobot, terrains: Sequence[Terrain], worlds: int, config: PhysicsConfig) -> None:
        self.robot, self.terrains, self.num_worlds, self.config = robot, terrains, worlds, config
        self.policy_dt = config.timestep * config.decimation
        self._device = _device(config.device)
        self.device = wp.device_to_torch(self._device)
        contacts = [t.contact for t in terrains]
        self._host = world_spec(robot, terrains[0], slots_for(terrains), config, contacts).compile()
        check_order(robot, self._host)
        # Warp knows no automatic reset, and refuses the flag that switches it off.
        self._host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        with wp.ScopedDevice(self._device):
            self._make(worlds)
            self._bind_state()
            compile_for(self._policy_step, self._device)
            # Once outside of a graph: what is left to load is loaded, buffers of the allocator are filled.
            self._policy_step()
            self._graph = self._refresh_graph = None
            if self._device.is_cuda:
                self._graph = _captured(self._policy_step)
                self._refresh_graph = _captured(self._refresh)
            wp.synchronize_device()  # from here on everything runs on torch's stream
        self._overflow_counter.zero_()
        everyone = torch.arange(worlds, device=self.device)
        base = torch.tensor([0.0, 0.0, robot.standing_height], device=self.device).repeat(worlds, 1)
        upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=self.device).repeat(worlds, 1)
        self.reset(everyone, base, upright, self._default.repeat(worlds, 1), torch.zeros_like(everyone))

    def step(self, targets: Tensor) -> State:
        """See `Physics.step`. Nothing here waits for the GPU."""
        self._wanted.copy_(targets)
        self._launch(self._graph, self._policy_step)
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
        ids, terrain_ids = ids.to(self.device), terrain_ids.to(self.device)
        qpos = torch.cat([base_pos, base_quat, joint_pos], dim=1).to(self.device, torch.float32)
        self._qpos[ids] = self._sound_qpos[ids] = qpos
        self._previous[ids] = qpos[:, 7:]
        for tensor in (self._qvel, self._sound_qvel, self._warmstart, *self._zeroed_at_reset):
            tensor.index_fill_(0, ids, 0)  # an assignment would copy the zero from the host
        self._move_terrain(ids, terrain_ids)
        self._launch(self._refresh_graph, self._refresh)

    def set_velocity(self, ids: Tensor, base_lin_vel: Tensor, base_ang_vel: Tensor) -> None:
        """See `Physics.set_velocity`."""
        ids = ids.to(self.device)
        velocity = torch.cat([base_lin_vel, base_ang_vel], dim=1).to(self.device, torch.float32)
        self._qvel[ids, :6] = velocity
        self._sound_qvel[ids, :6] = velocity
        self._launch(self._refresh_graph, self._refresh)

    def set_params(self, ids: Tensor, params: WorldParams) -> None:
        """See `Physics.set_params`."""
        self._fields.set(ids.to(self.device), params)
        if params.delay_steps is not None:
            self._delay[ids.to(self.device)] = params.delay_steps.to(self.device, torch.int32)

    @property
    def overflowed(self) -> int:
        """Policy steps of a world so far in which a buffer was too small. Waits for the GPU."""
        return int(self._overflow_counter[0].item())

    @property
    def solver_limited(self) -> int:
        """Policy steps of a world so far in which the solver stopped at its limit. Waits for the GPU."""
        return int(self._overflow_counter[1].item())

    def usage(self) -> dict[str, int]:
        """How full the buffers were in the last physics step. Waits for the GPU."""
        return {
            "contacts of all worlds": int(self._data.nacon.numpy()[0]),
            "candidate pairs of all worlds": int(self._data.ncollision.numpy()[0]),
            "room for contacts of all worlds": int(self._data.naconmax),
            "constraints of the fullest world": int(self._data.nefc.numpy().max()),
            "room for constraints of a world": int(self._data.njmax),
        }

    def _make(self, worlds: int) -> None:
        """The model and data on the device, and torch's views of what changes between steps."""
        config = self.config
        try:
            model = mjw.put_model(self._host, batch_sizes=dict.fromkeys(BATCHED, worlds))
            data = mjw.make_data(
                self._host,
                nworld=worlds,
                nconmax=config.contacts_per_world,
                njmax=config.constraints_per_world,
            )
        except RuntimeError as error:
            if "allocate" not in str(error):
                raise
            # As torch says it, so that who asked can try again with fewer worlds.
            raise torch.OutOfMemoryError(f"{worlds} worlds: out of memory on {self._device}: {error}") from error
        model.opt.warn_overflow = False  # counted here and reported; a line a step would drown everything else
        if config.broadphase != "auto":
            kinds = {"nxn": mjw.BroadphaseType.NXN, "sap": mjw.BroadphaseType.SAP_TILE}
            model.opt.broadphase = kinds[config.broadphase]
        self._model, self._data = model, data
        self._qpos, self._qvel, self._warmstart = (wp.to_torch(a) for a in (data.qpos, data.qvel, data.qacc_warmstart))
        self._sound_qpos, self._sound_qvel = self._qpos.clone(), self._qvel.clone()
        self._default = torch.tensor(self.robot.default, dtype=torch.float32, device=self.device)
        self._wanted = self._default.repeat(worlds, 1)
        self._previous = self._wanted.clone()
        self._delay = torch.zeros(worlds, dtype=torch.int32, device=self.device)
        self._overflow_counter = torch.zeros(2, dtype=torch.int32, device=self.device)
        self._fields = WorldFields(model, self._host, self.robot, self.device)
        self._static = StaticGeoms.of(self._host, self.terrains, self.device)
        self._geoms = {name: wp.to_torch(getattr(data, name)) for name in ("geom_xpos", "geom_xmat")}
        self._geoms |= {name: wp.to_torch(getattr(model, name)) for name in TERRAIN_FIELDS}
        self._kind = wp.array(_kinds(self._host, self.robot), dtype=int)
        self._foot_bodies = wp.array([self._host.body(f).id for f in self.robot.feet], dtype=int)
        self._foot_joints = wp.array(_joints_to(self._host, self.robot.feet), dtype=int)
        self._foot_forces = wp.zeros((worlds, len(self.robot.feet)), dtype=wp.vec3)

    def _bind_state(self) -> None:
        """`state`: views of the simulation's arrays, and tensors of its own that kernels write."""
        data, host, robot = self._data, self._host, self.robot
        xpos, xquat = wp.to_torch(data.xpos), wp.to_torch(data.xquat)
        torso = host.body(robot.torso).id
        camera = host.body(robot.camera.body).id if robot.camera else torso
        state = empty_state(robot, self.num_worlds, self.device)
        state.base_pos, state.base_quat, state.joint_pos = self._qpos[:, :3], self._qpos[:, 3:7], self._qpos[:, 7:]
        state.base_lin_vel, state.base_ang_vel = self._qvel[:, :3], self._qvel[:, 3:6]
        state.joint_vel = self._qvel[:, 6:]
        state.torso_pos, state.torso_quat = xpos[:, torso], xquat[:, torso]
        state.camera_pos, state.camera_quat = xpos[:, camera], xquat[:, camera]
        state.joint_torque = wp.to_torch(data.actuator_force)
        self.state = state
        forces = wp.to_torch(self._foot_forces)
        flags = (state.ground_contact, state.other_contact, state.diverged)
        self._zeroed_at_reset = (state.joint_acc, state.joint_torque, state.foot_force, forces, *flags)
        self._acc, self._ground, self._other, self._diverged = map(wp.from_torch, (state.joint_acc, *flags))
        self._feet_out = [
            wp.from_torch(state.foot_pos, dtype=wp.vec3),
            wp.from_torch(state.foot_quat, dtype=wp.quat),
            wp.from_torch(state.foot_lin_vel, dtype=wp.vec3),
            wp.from_torch(state.foot_ang_vel, dtype=wp.vec3),
            wp.from_torch(state.foot_force),
        ]
        self._inputs = {
            "wanted": wp.from_torch(self._wanted),
            "previous": wp.from_torch(self._previous),
            "delay": wp.from_torch(self._delay),
            "sound_qpos": wp.from_torch(self._sound_qpos),
            "sound_qvel": wp.from_torch(self._sound_qvel),
            "overflowed": wp.from_torch(self._overflow_counter),
        }

    def _policy_step(self) -> None:
        """All physics steps of a policy step, contacts watched in each; what the CUDA graph holds."""
        data, contact, own, worlds = self._data, self._data.contact, self._inputs, self.num_worlds
        pairs = [data.nacon, contact.geom, contact.worldid]
        wp.launch(kernels.clear_contacts, dim=worlds, outputs=[self._ground, self._other, self._foot_forces])
        for step in range(self.config.decimation):
            wp.launch(
                kernels.choose_targets,
                dim=data.ctrl.shape,
                inputs=[step, own["delay"], own["previous"], own["wanted"]],
                outputs=[data.ctrl],
            )
            mjw.step(self._model, data)
            wp.launch(
                kernels.watch_contacts,
                dim=data.naconmax,
                inputs=[*pairs, contact.dist, contact.includemargin, self._kind],
                outputs=[self._ground, self._other],
            )
        wp.launch(
            kernels.sum_foot_forces,
            dim=data.naconmax,
            inputs=[
                *pairs,
                contact.frame,
                contact.friction,
                contact.dim,
                contact.efc_address,
                data.efc.force,
                data.njmax,
                self._kind,
            ],
            outputs=[self._foot_forces],
        )
        wp.launch(
            kernels.guard,
            dim=worlds,
            inputs=[
                MAX_SPEED,
                self.policy_dt,
                own["wanted"],
                data.qpos,
                data.qvel,
                data.qacc_warmstart,
                data.overflow,
                own["sound_qpos"],
                own["sound_qvel"],
                own["previous"],
            ],
            outputs=[self._acc, data.actuator_force, self._foot_forces, self._diverged, own["overflowed"]],
        )
        self._refresh()

    def _refresh(self) -> None:
        """Body poses of the present state, which a physics step leaves one step behind; then the feet."""
        data = self._data
        mjw.kinematics(self._model, data)
        wp.launch(
            kernels.write_feet,
            dim=(self.num_worlds, len(self.robot.feet)),
            inputs=[
                self._foot_bodies,
                self._foot_joints,
                data.qvel,
                data.xpos,
                data.xquat,
                data.xmat,
                data.xanchor,
                data.xaxis,
                self._host.body(self.robot.base).id,
                self._foot_forces,
            ],
            outputs=self._feet_out,
        )

    def _launch(self, graph: Any, eager: Any) -> None:
        """On torch's current stream, so that order needs no waiting; into torch's graph while it captures one."""
        if graph is None:
            with wp.ScopedDevice(self._device):
                eager()
            return
        stream = wp.stream_from_torch(torch.cuda.current_stream(self.device))
        if stream.is_capturing:
            with wp.ScopedStream(stream, sync_enter=False):
                eager()
        else:
            wp.capture_launch(graph, stream=stream)

    def _move_terrain(self, ids: Tensor, terrain_ids: Tensor) -> None:
        """Fixed geoms keep the pose that is in the data: the engine computes it only once."""
        table, rows, view = self._static, ids[:, None], self._geoms
        view["geom_xpos"][rows, table.geoms] = table.pos[terrain_ids]
        view["geom_xmat"][rows, table.geoms] = table.mat[terrain_ids]
        half = table.half[terrain_ids]
        view["geom_size"][rows, table.slots] = half
        view["geom_rbound"][rows, table.slots] = half.norm(dim=-1)
        view["geom_aabb"][rows, table.slots, 1] = half


def _device(name: str) -> Any:
    wp.init()
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError) as error:
        raise TrainerError(
            f"there is no device {name}",
            expected=f"one of {', '.join(str(d) for d in wp.get_devices())}",
            hint="use the engine `mujoco` on the CPU",
        ) from error


def _captured(function: Any) -> Any:
    """A function as a CUDA graph. Graphs of worlds that are gone are freed before, not while this one is captured: CUDA
    would refuse both."""
    gc.collect()
    collects = gc.isenabled()
    gc.disable()
    try:
        with wp.ScopedCapture() as capture:
            function()
    finally:
        if collects:
            gc.enable()
    return capture.graph


def _kinds(model: Any, robot: TrainedRobot) -> np.ndarray:
    """(ngeom,) what a geom is to `watch_contacts`."""
    feet = {model.body(foot).id: i for i, foot in enumerate(robot.feet)}
    kinds = [feet.get(b, kernels.LIMB) if b else kernels.TERRAIN for b in model.geom_bodyid]
    kinds[model.geom(GROUND).id] = kernels.GROUND
    return np.array(kinds, np.int32)


def _joints_to(model: Any, bodies: Sequence[str]) -> np.ndarray:
    """(F, L) hinges between the base and each body, filled up with -1."""
    chains = []
    for name in bodies:
        chain, body = [], model.body(name).id
        while body:
            chain += [j for j in range(1, model.njnt) if model.jnt_bodyid[j] == body]
            body = model.body_parentid[body]
        chains.append(chain)
    longest = max(map(len, chains))
    return np.array([chain + [-1] * (longest - len(chain)) for chain in chains], np.int32)
