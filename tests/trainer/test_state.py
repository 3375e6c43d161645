"""The state of a base's training, kept without the weights that ship."""

from pathlib import Path

import pytest
import torch

from trainer.errors import TrainerError
from trainer.policies import BASES, base_of
from trainer.ppo import checkpoint
from training import state


@pytest.mark.parametrize(("robot", "iterations"), [("g1", 9147), ("quadruped", 2089)])
def test_the_base_that_ships_goes_on_from_its_state(robot: str, iterations: int, tmp_path: Path) -> None:
    whole, ships, kept = tmp_path / "whole.pt", tmp_path / "ships.pt", tmp_path / state.STATE
    state.join(whole, base_of(robot), state.HERE / robot / state.STATE)
    policy, training = checkpoint.load(whole)
    assert training is not None
    assert training["iteration"] == iterations
    state.split(whole, ships, kept)
    state.join(tmp_path / "again.pt", ships, kept)
    again, same = checkpoint.load(tmp_path / "again.pt")
    assert state.fingerprint(again) == state.fingerprint(policy)
    assert _equal(training, same)


def test_a_state_of_another_policy_is_refused(tmp_path: Path) -> None:
    assert "quadruped" in BASES
    with pytest.raises(TrainerError, match="another policy"):
        state.join(tmp_path / "whole.pt", base_of("quadruped"), state.HERE / "g1" / state.STATE)
    with pytest.raises(TrainerError, match="no training state"):
        state.split(base_of("g1"), tmp_path / "ships.pt", tmp_path / state.STATE)


def _equal(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_equal(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_equal, a, b))
    return torch.equal(a, b) if torch.is_tensor(a) else a == b
