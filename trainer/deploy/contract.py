"""Whether a logged run was driven by the policy that it names: the network's answers, what it saw, and what was sent.

`realsim diagnose --policy` tells sixteen mistakes apart for policies without a camera. Here the log has the policy's
own inputs and outputs, so that each link of the chain is compared by itself, with a camera too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import read_npz
from trainer.deploy.observer import Observer
from trainer.errors import TrainerError
from trainer.ppo import export
from trainer.ppo.export import Deployment

TOLERANCE = 1e-3
"""Radians and units of action: rounding of the log and of another machine's network is a tenth of it."""
NEEDED = ("time", "command", "joint_pos", "joint_vel", "observation", "action")


@dataclass(frozen=True)
class Contract:
    """What was found in all runs of a case."""

    runs: int
    steps: int
    off: dict[str, float]
    """Link -> its largest error, of those beyond the tolerance."""

    @property
    def kept(self) -> bool:
        return not self.off

    def lines(self) -> list[str]:
        if self.kept:
            return [f"kept in {self.steps} steps of {self.runs} runs: network, observations and targets agree"]
        return [f"{link} is off by up to {error:.3g}" for link, error in self.off.items()]


def check(case: Path) -> Contract:
    """Compare every step of a case that `realsim deploy --log` wrote.

    Raises:
        TrainerError: the case has no policy, or runs without its inputs and outputs.
    """
    file = case / "policy.onnx"
    if not file.is_file():
        raise TrainerError(
            "the case has no policy", file=case, expected="policy.onnx, as `realsim deploy --log` writes"
        )
    session, facts = export.load(file)
    runs = sorted((case / "runs").glob("*.npz"))
    if not runs:
        raise TrainerError("the case has no runs", file=case / "runs", expected="runs/*.npz")
    errors: dict[str, float] = {}
    steps = 0
    for path in runs:
        data = read_npz(path)
        missing = [name for name in NEEDED if name not in data]
        if missing:
            raise TrainerError(
                "the run lacks what the policy saw and said", file=path, found=f"no {', '.join(missing)}"
            )
        steps += len(data["time"])
        for link, error in _errors(data, session, facts).items():
            errors[link] = max(error, errors.get(link, 0.0))
    return Contract(len(runs), steps, {link: e for link, e in errors.items() if not e <= TOLERANCE})


def _errors(data: dict[str, Any], session: Any, facts: Deployment) -> dict[str, float]:
    default, scale = np.asarray(facts.default), np.asarray(facts.action_scale)
    action, seen = data["action"], data["observation"]
    limit = np.inf if facts.action_limit is None else facts.action_limit
    before = np.vstack([np.zeros((1, action.shape[1])), action[:-1]])
    expected = {
        "joint_pos": data["joint_pos"] - default,
        "joint_vel": data["joint_vel"],
        "last_action": before,
        "base_ang_vel": data.get("imu_gyro"),
    }
    errors, first = {}, 0
    for name, width in facts.layout.actor:
        now = expected.get(name)
        if now is not None:
            newest = seen[:, first + width - now.shape[1] : first + width]
            errors[f"the observation {name}"] = float(np.abs(newest - now).max())
        first += width
    said = np.clip(_answers(data, session, facts), -limit, limit)
    errors["the policy's action"] = float(np.abs(said - action).max())
    errors["the joint target"] = float(np.abs(data["command"] - (default + scale * action)).max())
    return errors


def _answers(data: dict[str, Any], session: Any, facts: Deployment) -> Any:
    """(T, J) what the policy says to the logged observations."""
    observe = Observer(facts)
    answers = []
    for k, vector in enumerate(data["observation"].astype(np.float32)):
        inputs = {"vector": vector[None]}
        if facts.layout.depth is not None:
            inputs["depth"] = observe.stack(data["depth"][k].astype(float))[None]
        answers.append(session.run(None, inputs)[0][0])
    return np.array(answers)
