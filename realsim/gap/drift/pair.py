"""Two logs of one robot as one case: the earlier runs first."""

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
    for what in ("joint_names", "actuator_names", "command_kind", "base"):
        ours, theirs = getattr(today, what), getattr(before, what)
        if ours == theirs:
            continue
        message, hint = f"the two logs differ in {what}", None
        if isinstance(ours, tuple) and sorted(ours) == sorted(theirs):
            message, hint = f"the two logs list their {what} in another order", "use one log.json for both"
        elif isinstance(ours, tuple):
            missing = [name for name in theirs if name not in ours]
            message, hint = "the earlier log is of another robot", did_you_mean(missing[0], ours) if missing else None
        expected, found = (v if isinstance(v, str) else ", ".join(v[:12]) for v in (ours, theirs))
        raise GapError(message, file=before.folder, expected=expected, found=found, hint=hint)
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
