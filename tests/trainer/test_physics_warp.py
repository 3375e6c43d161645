"""The GPU engine against the CPU engine, on Warp's CPU device."""

from __future__ import annotations

import os
from dataclasses import replace
from importlib.util import find_spec

import mujoco
import numpy as np
import pytest
import torch

from trainer import terrain as terrains
from trainer.physics import ENGINES, Physics, PhysicsConfig, WorldParams
from trainer.physics.static_geoms import StaticGeoms
from trainer.physics.world import PARKED_Z, slots_for, world_spec
from trainer.robots import ROBOTS

WORLDS = 4
LANDS = [terrains.generate("stakes", 0.3, 0), terrains.generate("wedges", 0.5, 0)]
pytestmark = pytest.mark.skipif(find_spec("mujoco_warp") is None, reason="the GPU engine needs mujoco-warp")
compiles = pytest.mark.skipif(
    not os.environ.get("REALSIM_SLOW"),
    reason="compiling MuJoCo Warp for the CPU takes half a minute a robot: set REALSIM_SLOW=1",
)


def pair(name: str, lands=LANDS, **options) -> list[Physics]:
    """Both engines with the same worlds, standing a centimetre above the start, every second world on land 1."""
    robot, ids = ROBOTS[name](), torch.arange(WORLDS)
    engines = [ENGINES[e](robot, lands, WORLDS, PhysicsConfig(threads=1, **options)) for e in ("warp", "mujoco")]
    for physics in engines:
        place(physics, ids)
    return engines


def place(physics: Physics, ids: torch.Tensor, x: float = 0.0, y: float = 0.0, height: float = 0.01) -> None:
    n, robot = len(ids), physics.robot
    pos = torch.tensor([x, y, robot.standing_height + height]).repeat(n, 1)
    joints = torch.tensor(robot.default, dtype=torch.float32).repeat(n, 1)
    physics.reset(ids, pos, torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1), joints, ids % len(physics.terrains))


def targets(physics: Physics, seed: int) -> torch.Tensor:
    robot, rng = physics.robot, torch.Generator().manual_seed(seed)
    noise = torch.randn(WORLDS, len(robot.joints), generator=rng)
    return torch.tensor(robot.default + 0.2 * robot.action_scale * noise.numpy(), dtype=torch.float32)


def assert_near(ours, theirs) -> None:
    """With other masses: on the GPU contacts stay as soft as the nominal robot's, so poses differ a little."""
    for name, atol in (("base_pos", 2e-3), ("joint_pos", 0.02), ("foot_pos", 5e-3), ("torso_quat", 5e-3)):
        torch.testing.assert_close(getattr(ours, name), getattr(theirs, name), atol=atol, rtol=0.0)


def assert_same(ours, theirs) -> None:
    """Forces and accelerations of stiff contact amplify rounding: they get more room than positions."""
    room = {"joint_acc": 5.0, "joint_torque": 0.1, "foot_force": 3.0, "joint_vel": 0.1, "foot_ang_vel": 0.1}
    for name, value in vars(theirs).items():
        other = getattr(ours, name)
        assert other.shape == value.shape, name
        atol = room.get(name, 0.01 if "vel" in name else 1e-3)
        torch.testing.assert_close(
            other.float(), value.float(), atol=atol, rtol=0.01, msg=lambda m, n=name: f"{n}: {m}"
        )


@compiles
@pytest.mark.slow
@pytest.mark.parametrize("name", list(ROBOTS))
def test_both_engines_go_the_same_way(name: str) -> None:
    warp, cpu = pair(name)
    push = torch.tensor([[0.2, -0.1, 0.0]]), torch.tensor([[0.0, 0.1, 0.3]])
    for step in range(20):
        if step == 10:
            for physics in (warp, cpu):
                physics.set_velocity(torch.tensor([2]), *push)
            assert_same(warp.state, cpu.state)
        assert_same(warp.step(targets(cpu, step)), cpu.step(targets(cpu, step)))
    assert not warp.state.diverged.any()
    assert warp.overflowed == 0
    assert warp.usage()["contacts of all worlds"] > WORLDS


@compiles
@pytest.mark.slow
def test_parameters_pushes_divergence_and_resets_are_the_same() -> None:
    """One compiled engine, everything that a task does to it."""
    warp, cpu = pair("quadruped")
    some, joints = torch.tensor([1, 3]), 12
    params = WorldParams(
        friction=torch.tensor([0.4, 0.9]),
        contact_time=torch.tensor([0.03, 0.0]),
        mass_scale=torch.tensor([1.1, 0.9]),
        payload=torch.tensor([1.0, 0.5]),
        com_offset=torch.tensor([[0.02, 0.0, 0.0], [0.0, 0.01, -0.01]]),
        kp_scale=torch.full((2, joints), 0.9),
        kd_scale=torch.full((2, joints), 1.2),
        armature_scale=torch.full((2, joints), 1.3),
        joint_friction=torch.full((2, joints), 0.2),
        delay_steps=torch.tensor([1, 3]),
    )
    for physics in (warp, cpu):
        physics.set_params(some, params)
        place(physics, some)
    for step in range(15):
        assert_near(warp.step(targets(cpu, step)), cpu.step(targets(cpu, step)))
    bad = targets(cpu, 0)
    bad[0, 3] = float("nan")
    for physics in (warp, cpu):
        physics.set_velocity(torch.tensor([2]), torch.tensor([[0.0, 0.0, 1e7]]), torch.tensor([[1e7, 0.0, 0.0]]))
        state = physics.step(bad)
        assert state.diverged.tolist() == [True, False, True, False]
        assert [n for n, v in vars(state).items() if not torch.isfinite(v.float()).all()] == []
        place(physics, torch.tensor([0, 2]))
        place(physics, torch.tensor([1]), y=4.0, height=0.01 + LANDS[1].floor_z)  # beside the course: on the ground
    for step in range(10):
        assert_near(warp.step(targets(cpu, step)), cpu.step(targets(cpu, step)))
    assert warp.state.ground_contact.tolist() == [False, True, False, False]


@compiles
@pytest.mark.slow
@pytest.mark.parametrize("name", list(ROBOTS))
def test_limbs_that_cross_collide_in_both(name: str) -> None:
    """In the air, legs are turned inwards until they meet; contact of two feet is no undesired contact."""
    warp, cpu = pair(name, self_collision=True)
    ids, touched = torch.arange(WORLDS), False
    for physics in (warp, cpu):
        place(physics, ids, height=1.0)
    inwards = cpu.robot.default.copy()
    for j, joint in enumerate(cpu.robot.joints):
        if joint.endswith(("hip_roll_joint", "L_hip_joint", "R_hip_joint")):
            inwards[j] = -0.8 if joint.startswith(("left", "FL", "RL")) else 0.8
    wanted = torch.tensor(inwards, dtype=torch.float32).repeat(WORLDS, 1)
    for _ in range(15):
        ours, theirs = warp.step(wanted), cpu.step(wanted)
        touched |= bool(theirs.other_contact.any()) or float(theirs.foot_force.sum()) > 0
        assert_near(ours, theirs)
        assert torch.equal(ours.other_contact, theirs.other_contact)
    assert touched
    assert warp.overflowed == 0


@compiles
@pytest.mark.slow
def test_a_scene_of_its_own_geoms_stands_only_in_its_worlds() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[0, 0, -0.1])
    scene = replace(LANDS[0], boxes=(), contact=spec, floor_z=-1.0)
    hole = replace(LANDS[0], boxes=(), floor_z=-1.0)
    warp, cpu = pair("quadruped", [scene, hole])
    for step in range(10):
        assert_same(warp.step(targets(cpu, step)), cpu.step(targets(cpu, step)))
    assert (warp.state.foot_force.sum(dim=1) > 10).tolist() == [True, False, True, False]


def test_static_geoms_stand_where_their_terrain_has_them() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[0, 0, -0.1])
    scene = replace(LANDS[0], boxes=(), contact=spec)
    lands = [*LANDS, scene]
    robot, slots = ROBOTS["quadruped"](), slots_for(lands)
    model = world_spec(robot, lands[0], slots, PhysicsConfig(), [t.contact for t in lands]).compile()
    table = StaticGeoms.of(model, lands, torch.device("cpu"))
    assert len(table.geoms) == slots + 2
    for t, land in enumerate(lands):
        centres = sorted(box.T[:3, 3].tolist() for box in land.boxes)
        found = sorted(p.tolist() for p in table.pos[t, table.slots] if p[2] > PARKED_Z)
        np.testing.assert_allclose(np.array(found).reshape(-1, 3), np.array(centres).reshape(-1, 3), atol=1e-5)
        assert (table.pos[t, :, 2] == PARKED_Z).sum() == slots - len(land.boxes) + (land is not scene)
        assert table.pos[t, model.geom("ground").id, 2] == pytest.approx(land.floor_z)


@pytest.mark.parametrize("name", list(ROBOTS))
def test_no_pair_of_geoms_needs_the_convex_solver(name: str) -> None:
    """Capsules and spheres against boxes and the plane are cheap on the GPU; box on box or meshes are not."""
    robot = ROBOTS[name]()
    model = world_spec(robot, LANDS[0], slots_for(LANDS), PhysicsConfig(self_collision=True)).compile()
    cheap = {int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)}
    for a in range(model.ngeom):
        for b in range(a):
            meet = (model.geom_contype[a] & model.geom_conaffinity[b]) | (
                model.geom_contype[b] & model.geom_conaffinity[a]
            )
            if meet:
                assert {int(model.geom_type[a]), int(model.geom_type[b])} & cheap


def test_nothing_is_freed_while_a_graph_is_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    """CUDA refuses to free a graph during a capture, and gives up the capture as well."""
    import gc
    import weakref

    from trainer.physics import warp

    class Capture:
        graph = "graph"

        def __enter__(self) -> Capture:
            return self

        def __exit__(self, *_: object) -> None:
            pass

    class World:
        def __init__(self) -> None:
            self.itself = self  # only the collector frees it

    monkeypatch.setattr(warp.wp, "ScopedCapture", Capture)
    gone = weakref.ref(World())
    seen = []
    assert warp._captured(lambda: seen.append((gone() is None, gc.isenabled()))) == "graph"
    assert seen == [(True, False)]
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError):
        warp._captured(lambda: 1 / 0)
    assert gc.isenabled()


def test_ground_that_gives_and_places_that_slip_change_the_model() -> None:
    """As on the CPU (test_physics.py), in the fields that worlds have of their own."""
    import mujoco_warp as mjw
    import warp as wp

    from trainer.physics.warp_params import BATCHED, WorldFields

    contact = mujoco.MjSpec()
    for name, mu in (("dry", 1.0), ("wet", 0.3)):
        box = contact.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.4, 0.4, 0.1])
        box.friction = [mu, 0.005, 0.0001]
    robot = ROBOTS["quadruped"]()
    host = world_spec(robot, replace(terrains.flat(), contact=contact), 0, PhysicsConfig(), [contact]).compile()
    host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    with wp.ScopedDevice("cpu"):
        model = mjw.put_model(host, batch_sizes=dict.fromkeys(BATCHED, 3))
        fields = WorldFields(model, host, robot, torch.device("cpu"))
        params = WorldParams(friction=torch.tensor([0.8, 0.5]), contact_time=torch.tensor([0.1, -0.5]))
        fields.set(torch.tensor([1, 2]), params)
        geoms = [host.geom(name).id for name in ("scene0/dry", "scene0/wet", "FL_foot")]
        friction, solref = wp.to_torch(model.geom_friction)[:, geoms, 0], wp.to_torch(model.geom_solref)[:, geoms, 0]
    np.testing.assert_allclose(friction, [[1.0, 0.3, 1.0], [0.8, 0.24, 0.8], [0.5, 0.15, 0.5]], rtol=1e-6)
    np.testing.assert_allclose(solref, [[0.02, 0.02, 0.02], [0.12, 0.12, 0.02], [0.01, 0.01, 0.02]], rtol=1e-6)
