"""Two logs of one robot as one case: the earlier runs first."""

from __future__ import annotations

from dataclasses import dataclass, replace

from realsim.core.errors import GapError, did_you_mean
from realsim.gap.case.case import Case
from realsim.gap.case.split import split_runs
from realsim.gap.config import DiagnoseConfig

BEFORE = "before/"
"""Put before the names of the earlier log's runs."""


@dataclass(frozen=True)
class Pair:
    """One case with the runs of both logs."""

    case: Case
    before: tuple[int, ...]
    """Runs of the earlier log that are fitted."""
    now: tuple[int, ...]
    """Of today's."""
    notes: tuple[str, ...] = ()


def pair_of(today: Case, before: Case, config: DiagnoseConfig) -> Pair:
    """Both logs against today's model.

    Raises:
        GapError: where they are not of one robot.
    """
    for what, ours, theirs in (
        ("joints", today.joint_names, before.joint_names),
        ("actuators", today.actuator_names, before.actuator_names),
    ):
        missing = [name for name in theirs if name not in ours] or [name for name in ours if name not in theirs]
        if missing or len(ours) != len(theirs):
            raise GapError(
                "the earlier log is of another robot",
                file=before.folder,
                expected=f"{what} {', '.join(ours[:12])}",
                found=", ".join(theirs[:12]),
                hint=did_you_mean(missing[0], ours) if missing else None,
            )
        if ours != theirs:
            raise GapError(
                f"the two logs list their {what} in another order",
                file=before.folder,
                expected=", ".join(ours[:12]),
                found=", ".join(theirs[:12]),
                hint="use one log.json for both",
            )
    for what in ("command_kind", "base"):
        if getattr(today, what) != getattr(before, what):
            raise GapError(
                f"the two logs differ in {what}",
                file=before.folder,
                expected=str(getattr(today, what)),
                found=str(getattr(before, what)),
            )
    notes = []
    if today.xml != before.xml:
        notes.append("the two cases hold different models: today's is used for both")
    torque, site = today.torque_kind, today.imu_site
    if before.torque_kind != torque:
        notes.append("torque_kind differs: torques are not compared")
        torque = "none"
    if before.imu_site != site:
        notes.append("imu_site differs: the IMU is not compared")
        site = None
    earlier = tuple(replace(run, name=f"{BEFORE}{run.name}") for run in before.runs)
    later = tuple(replace(run, setup=replace(run.setup, later=True)) for run in today.runs)
    case = replace(today, runs=(*earlier, *later), torque_kind=torque, imu_site=site, added=())
    whole = replace(config, holdout=0)
    then, _ = split_runs(before, whole)
    now, _ = split_runs(today, whole)
    return Pair(case, tuple(then), tuple(len(earlier) + i for i in now), tuple(notes))
