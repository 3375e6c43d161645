"""The hook for learners, the reference motion, and scenes in other engines."""
# ruff: noqa: E402 - what needs torch is imported after it is known to be there

from __future__ import annotations

from importlib.util import find_spec

import mujoco
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the trainer needs torch (extra: train)")

from realsim.errors import MissingExtraError, UnknownNameError
from trainer.errors import TrainerError
from trainer.ppo.motion import TROT, cycle, reference
from trainer.robots import ROBOTS
from trainer.tasks.parkour.amp import layout
from trainer.terrain import flat, generate
from trainer.trainers import BUILT_IN, Scene, find
from trainer.trainers.courses import add_course, extent


def test_trainers_are_found_by_name_and_unknown_ones_are_listed() -> None:
    assert callable(find("ppo"))
    with pytest.raises(UnknownNameError, match="unknown trainer 'pop'") as caught:
        find("pop")
    assert all(name in caught.value.expected for name in BUILT_IN)


@pytest.mark.skipif(find_spec("mjlab") is not None, reason="mjlab is installed")
def test_a_missing_engine_is_said() -> None:
    with pytest.raises(MissingExtraError, match="mjlab"):
        find("mjlab")


def test_no_terrain_is_said() -> None:
    with pytest.raises(TrainerError, match="no terrain"):
        Scene(())


@pytest.mark.parametrize("name", ["quadruped", "g1"])
def test_reference_motion_stays_in_the_limits_and_repeats(name: str) -> None:
    robot = ROBOTS[name]()
    features = reference(robot, 0.02, speeds=(0.6,))
    width = sum(w for _, w in layout(len(robot.joints), len(robot.feet)))
    assert features.shape[1] == 2 * width
    assert torch.isfinite(features).all()
    before, after = features.split(width, dim=1)
    assert torch.equal(after, before.roll(-1, 0))
    angles = before[:, 9 : 9 + len(robot.joints)].double().numpy() + robot.default
    assert (angles > robot.lower).all()
    assert (angles < robot.upper).all()


def test_standing_feet_move_back_as_fast_as_the_base_moves_ahead() -> None:
    robot = ROBOTS["quadruped"]()
    _, feet = cycle(robot, TROT, 0.6, 0.02)
    velocity = np.diff(feet[:, 0], axis=0) / 0.02  # the first foot stands first
    standing = slice(1, round(TROT.duty * len(feet)) - 1)
    assert np.allclose(velocity[standing, 0], -0.6, atol=0.02)
    assert np.allclose(velocity[standing, 2], 0.0, atol=0.02)
    assert feet[:, 0, 2].max() - feet[:, 0, 2].min() == pytest.approx(TROT.lift, abs=0.003)
    assert np.allclose(feet[0, 0, 2], feet[0, 3, 2], atol=1e-3)  # diagonal feet together


def _heights(spec: mujoco.MjSpec, points: np.ndarray, offset: np.ndarray) -> np.ndarray:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit = np.zeros(1, np.int32)
    tops = []
    for x, y in points + offset[:2]:
        tops.append(5.0 - mujoco.mj_ray(model, data, np.array([x, y, 5.0]), np.array([0, 0, -1.0]), None, 1, -1, hit))
    return np.array(tops) - offset[2]


@pytest.mark.parametrize("kind", ["boxes", "contact"])
def test_a_course_is_the_same_in_another_engine(kind: str) -> None:
    terrain = generate("wedges", 0.5, 3)
    low, high = extent(terrain, -0.01)
    rng = np.random.default_rng(0)
    points = rng.uniform(low, high, (200, 2))
    if kind == "contact":
        # The same course once more as convex meshes, tilted bodies and all.
        source = mujoco.MjSpec()
        for i, b in enumerate(terrain.boxes):
            corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * b.size
            source.add_mesh(name=f"m{i}", uservert=(corners @ b.T[:3, :3].T + b.T[:3, 3]).ravel())
            source.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"m{i}")
        from dataclasses import replace

        boxed, terrain = terrain, replace(terrain, boxes=(), contact=source)
    else:
        boxed = terrain
    offset = np.array([3.0, -2.0, 0.0])
    spec = mujoco.MjSpec()
    geoms = add_course(spec, spec.worldbody.add_body(name="terrain"), terrain, offset, "course")
    assert len(geoms) == 1 + len(boxed.boxes)
    plain = mujoco.MjSpec()
    add_course(plain, plain.worldbody.add_body(name="terrain"), boxed, np.zeros(3), "plain")
    assert np.allclose(_heights(spec, points, offset), _heights(plain, points, np.zeros(3)), atol=1e-3)
    assert flat().floor_z == 0.0
