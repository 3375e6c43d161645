"""The hook for learners, and the reference motion."""

import numpy as np
import pytest
import torch

from realsim.core.errors import UnknownNameError
from trainer.errors import TrainerError
from trainer.policies import base_of
from trainer.ppo.distributed import Rank
from trainer.ppo.motion import TROT, cycle, reference
from trainer.robots import ROBOTS
from trainer.trainers import BUILT_IN, Scene, TrainConfig, find
from trainer.trainers.ppo import decide


def test_trainers_are_found_by_name_and_unknown_ones_are_listed() -> None:
    assert callable(find("ppo"))
    with pytest.raises(UnknownNameError, match="unknown trainer 'pop'") as caught:
        find("pop")
    assert all(name in caught.value.expected for name in BUILT_IN)


def test_no_terrain_is_said() -> None:
    with pytest.raises(TrainerError, match="no terrain"):
        Scene(())


@pytest.mark.parametrize("name", ["quadruped", "g1"])
def test_reference_motion_stays_in_the_limits_and_repeats(name: str) -> None:
    robot = ROBOTS[name]()
    features = reference(robot, 0.02, speeds=(0.6,))
    width = 9 + 2 * len(robot.joints) + 3 * len(robot.feet)
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


def test_the_policy_of_another_robot_is_refused() -> None:
    rank = Rank(0, 1, torch.device("cpu"))
    with pytest.raises(TrainerError, match="for another robot") as error:
        decide(TrainConfig(robot="go2"), base_of("quadruped"), rank)
    assert "quadruped" in error.value.render()
