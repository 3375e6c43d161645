"""The policies that ship load, fit the task as it is today, and are what their exported form computes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("onnxruntime", reason="running an exported policy needs onnxruntime")

from trainer.commands.task_file import load_task
from trainer.policies import BASES, FOLDER, TASKS, base_of
from trainer.ppo import checkpoint, export
from trainer.ppo.policy import check_layout
from trainer.robots import ROBOTS
from trainer.tasks import Observation
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.observations import layout

TRAINING = Path(__file__).resolve().parents[2] / "training"
MOST_BYTES = 8 * 2**20
"""Of a robot's files."""


@pytest.mark.parametrize("robot", BASES)
def test_a_base_fits_the_task_as_it_is_and_has_no_training_in_it(robot: str) -> None:
    policy, training = checkpoint.load(base_of(robot))
    assert policy.robot == robot
    assert training is None
    task = ParkourConfig()
    width, height = ROBOTS[robot]().camera.crop
    check_layout(
        policy.layout, layout(ROBOTS[robot](), task.observation, (task.depth.frames, height, width), task.depth.stride)
    )
    assert sum(f.stat().st_size for f in FOLDER.glob(f"{robot}_*")) < MOST_BYTES


@pytest.mark.parametrize("robot", BASES)
def test_the_exported_policy_is_the_checkpoint(robot: str) -> None:
    policy, _ = checkpoint.load(base_of(robot))
    file = base_of(robot).with_suffix(".onnx")
    session, facts = export.load(file)
    assert facts.robot == robot
    rng = np.random.default_rng(0)
    vector = rng.normal(size=(1, policy.layout.actor_width)).astype(np.float32)
    depth = rng.uniform(size=(1, *policy.layout.depth)).astype(np.float32)
    names = [i.name for i in session.get_inputs()]
    given = dict(zip(names, (vector, depth), strict=True))
    (action, *_) = session.run(None, given)
    expected = policy.act(Observation(torch.from_numpy(vector), torch.zeros(1, 1), torch.from_numpy(depth))).numpy()
    np.testing.assert_allclose(action, expected, atol=1e-4)


@pytest.mark.parametrize("robot", BASES)
def test_fine_tuning_goes_on_in_the_task_of_the_base(robot: str) -> None:
    """But for a beginner's help and for pushes; trials without a task file stay as they were."""
    task, trained = load_task(TASKS[robot]), load_task(TRAINING / robot / "task.json")
    pushes = {name: getattr(task.randomisation, name) for name in ("push", "push_seconds")}
    random = replace(trained.randomisation, **pushes)
    assert task == replace(trained, reset=task.reset, randomisation=random)
    assert task.self_collision
    assert not ParkourConfig().self_collision
