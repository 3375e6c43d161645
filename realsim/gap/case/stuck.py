"""Joints whose reading stands still although they are commanded: nothing is known of how they move."""

from dataclasses import replace

import numpy as np

from realsim.core.errors import GapError
from realsim.gap.case.case import Case, Run

STANDS = 0.01
"""Share of its command's motion below which a joint's reading stands still, both as standard deviations in a run. Set
by hand: the weakest joint of 14 logs, mostly repeats of two servos, has 0.37."""
COMMANDED = 0.02
"""rad (or 20 to a metre) of standard deviation from which a joint is commanded to move: stiction may hold it below. Set
by hand."""


def without_stuck(case: Case) -> Case:
    """The case without the joints that are commanded and never move; they are still driven in the simulator.

    Raises:
        GapError: where no joint is left.
    """
    stuck = [j for j, name in enumerate(case.joint_names) if _stands(case, j, name)]
    if not stuck:
        return case
    names = ", ".join(case.joint_names[j] for j in stuck)
    ask = "is the encoder read, does the drive give torque, is the joint free (brake, end stop)?"
    if len(stuck) == len(case.joint_names):
        raise GapError(
            "no joint moves although it is commanded to", file=case.folder / "runs",
            expected="positions that change with their commands", found=f"readings that stand still: {names}", hint=ask,
        )  # fmt: skip
    note = f"{names}: the reading stands still although the command moves, so it is not compared: {ask}"
    kept = _with_joints(case, tuple(n for j, n in enumerate(case.joint_names) if j not in stuck))
    return replace(kept, warnings=(note, *kept.warnings))


def with_same_joints(today: Case, before: Case) -> tuple[Case, Case]:
    """Two logs of one robot with the joints that are stuck in neither."""
    names = tuple(name for name in today.joint_names if name in before.joint_names)
    if not names and today.joint_names:
        raise GapError(
            "no joint moves in both logs", file=before.folder, expected=f"motion of {', '.join(today.joint_names)}",
            found=f"motion of {', '.join(before.joint_names)} alone",
        )  # fmt: skip
    return _with_joints(today, names), _with_joints(before, names)


def _with_joints(case: Case, names: tuple[str, ...]) -> Case:
    """The case as if only these of its joints were logged."""
    columns = [case.joint_names.index(name) for name in names]

    def pick(run: Run) -> Run:
        signals = {k: v[:, columns] if k.startswith("joint_") else v for k, v in run.signals.items()}
        return replace(run, signals=signals)

    return replace(case, joint_names=names, runs=tuple(map(pick, case.runs)))


def _stands(case: Case, column: int, joint: str) -> bool:
    """Whether a joint stands still in all runs together, where its drive is on."""
    name = case.actuator_of(joint)
    if name is None or case.command_kind == "torque":  # friction may bear a torque, and that says how much it is
        return False
    drive = case.actuator_names.index(name)
    moved, variances = [], []
    for run in case.runs:
        command = run.command[:, drive] / case.gear(joint)
        if case.command_kind == "velocity":
            command = np.cumsum(command * np.gradient(run.time))
        reading = run.signals["joint_pos"][:, column]
        on = run.on[:, drive] & np.isfinite(reading)
        if on.any():
            moved.append(float(np.var(reading[on])))
            variances.append(float(np.var(command[on])))
    least = COMMANDED / 20 if case.slides(joint) else COMMANDED
    size = float(np.sqrt(np.mean(variances or [0.0])))
    return size > least and float(np.sqrt(np.mean(moved))) < STANDS * size
