"""Policies that ship: bases for fine-tuning, one a robot. CARD.md beside this file says how they were made."""

from __future__ import annotations

from pathlib import Path

from trainer.errors import TrainerError

FOLDER = Path(__file__).parent
BASES = {"g1": "g1_parkour.pt", "quadruped": "quadruped_parkour.pt"}
"""Robot -> its base."""
TASK = FOLDER / "task.json"
"""What differs from the paper's task in the one that the bases were trained in last; fine-tuning them goes on in it. A
beginner's help (raised floor, starts along the course) and G1's more frequent pushes are in training/*/task.json."""


def base_of(robot: str) -> Path:
    """The checkpoint (.pt) that ships for a robot; its exported form (.onnx) lies beside it.

    Raises:
        TrainerError: there is none for that robot.
    """
    if robot not in BASES:
        raise TrainerError(
            f"no base policy ships for {robot}",
            expected=f"one of {', '.join(BASES)}",
            hint=f"realsim pretrain --robot {robot} --out base/, then --policy base/policy.pt; or --from-scratch",
        )
    return FOLDER / BASES[robot]
