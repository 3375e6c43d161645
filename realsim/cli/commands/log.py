"""`realsim log`: what a recording holds, and the case that it becomes."""

from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.errors import GapError
from realsim.core.files import write_text


def log(
    recording: Annotated[Path, tyro.conf.Positional],
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    servos: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="KP KD")] = None,
    out: Path | None = None,
    use: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROLE=FIELD")] = (),
    rate: float | None = None,
    only: str = "",
    camera: str = "",
    scene: Annotated[Path | None, tyro.conf.arg(metavar="STR")] = None,
    skip: float = 0.0,
    seconds: float = float("inf"),
    plot: Annotated[Path | None, tyro.conf.arg(metavar="FILE.html")] = None,
    overwrite: bool = False,
) -> CommandResult:
    """Show what a robot's recording holds: which topic or column is what, with the evidence; and write it as a case.

    Args:
        recording: a file or a folder: MCAP, ROS bag, LeRobot, parquet, CSV, JSON, ULog, Rerun, npz; a folder of files
            is runs.
        model: MJCF (or URDF) of the robot; order, units and signs of the joints are tested against it.
        servos: of a model without actuators, as URDFs are: gains of a position servo at each joint, N m/rad and N m
            s/rad. The diagnosis corrects them.
        out: where the case for `realsim diagnose` goes; without it nothing is written.
        use: overrides a guess: "joint_pos=STREAM:FIELD" or "joint_pos=COLUMN,COLUMN" (a leading - negates a column),
            time=COLUMN, or ROLE=none; ROLE is command, joint_pos, joint_vel, ...
        rate: samples per second of a table that has no clock.
        only: prefix of the topics to read, if a recording holds several robots.
        camera: NAME or NAME=TOPIC: camera of the model that saw the recording's depth frames, where several may have;
            `none` leaves them out.
        scene: of `realsim reconstruct`, from a capture whose poses are in the frame of the log's base pose: base poses
            are put into its frame, in which `realsim footholds` expects them.
        skip: seconds after the first message from which the recording is read.
        seconds: how many seconds of it are read.
        plot: page to write: commands against positions, joint by joint, and what was understood of the recording.
        overwrite: replace a case that realsim wrote before.
    """
    from realsim import gap
    from realsim.gap import recordings as logs
    from realsim.gap.recordings.page import recording_page
    from realsim.gap.recordings.recording import Window

    if out is not None and model is None:
        raise GapError("a case needs a model", expected="realsim log RECORDING --model robot.xml --out case")
    target = logs.load_target(model, servos) if model is not None else None
    world = logs.load_world(scene) if scene is not None else None
    recordings = logs.read(recording, Window(skip, seconds))
    if rate is not None:
        if not rate > 0:
            raise GapError("--rate is no rate", expected="samples per second, above 0", found=f"{rate:g}")
        recordings = [replace(r, facts={**r.facts, "rate": rate}) for r in recordings]
    proposal = logs.propose(recordings, target, use=use, only=only, camera=camera, world=world)
    text, data = proposal.render(), proposal.as_dict()
    if plot is not None:
        write_text(plot, recording_page(proposal, target))
        text += f"\n\nplots   {plot}"
        data["plot"] = str(plot)
    if out is not None and target is not None:
        notes = logs.write_case(proposal, target, out, overwrite=overwrite, check=gap.load_case)
        case = gap.load_case(out)
        notes += [*(f"left out: {run}" for run in case.dropped_runs), *case.warnings]
        runs = f"{len(case.runs)} run{'s' * (len(case.runs) > 1)}"
        steps = [f"look at {out / 'log.html'}", f"realsim diagnose {quote(str(out))} --check"]
        lines = [f"case    {out} ({runs})", *(f"note    {s}" for s in notes), *(f"next    {s}" for s in steps)]
        text += "\n".join(["", "", *lines])
        data |= {"case": str(out), "notes": notes}
    return CommandResult(text, data)
