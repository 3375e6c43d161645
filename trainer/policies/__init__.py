"""Policies that ship: bases for fine-tuning, one a robot. CARD.md beside this file says how they were made."""

from pathlib import Path

from trainer.errors import TrainerError

FOLDER = Path(__file__).parent
BASES = {robot: f"{robot}_parkour.pt" for robot in ("g1", "go2", "quadruped")}
"""Robot -> its base."""
TASKS = {
    "g1": FOLDER / "g1_task.json",
    "go2": FOLDER / "go2_task.json",
    "quadruped": FOLDER / "quadruped_task.json",
}
"""Robot -> what differs from the paper's task where its base is fine-tuned. It is the task that the base was trained in
last, without a beginner's help (starts along the course); G1 is pushed less hard, and as often."""


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
