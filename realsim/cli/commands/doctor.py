"""`realsim doctor`: one log and one policy -> what is wrong, in the order in which to look."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult, strict_exit
from realsim.core.progress import steps
from realsim.gap.config import DiagnoseConfig


def doctor(
    log: Annotated[Path, tyro.conf.Positional],
    config: DiagnoseConfig,
    policy: Path,
    deploy_yaml: Path | None = None,
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    scene: Annotated[Path | None, tyro.conf.arg(metavar="STR")] = None,
    out: Path = Path("doctor"),
    overwrite: bool = False,
    strict: bool = False,
) -> CommandResult:
    """Say why a policy that walks in simulation fails on the robot: contract, delay, physics, camera, terrain.

    Args:
        log: a case (log.json, model.xml, runs/), or with --model a recording.
        policy: policy.onnx that ran.
        deploy_yaml: its contract where the file has none: deploy.yaml of unitree_rl_lab, IO_descriptors.yaml of Isaac
            Lab.
        model: of the robot, where PATH is a recording (MCAP, bag, CSV, ...).
        scene: scene.xml on which the robot walked (default: the terrain of the case's model).
        out: gets doctor.json and report.html.
        overwrite: replace an output folder that realsim wrote before.
        strict: exit with code 3 if the policy's contract is broken or the gap stays unexplained.
    """
    from realsim.cli.commands.diagnose import case_for_now, refuse_recording
    from realsim.gap.doctor import run_doctor

    if model is None:
        refuse_recording(log)
    with nullcontext(log) if model is None else case_for_now(log, model) as case, steps() as tick:
        found = run_doctor(
            case, out, tick, policy=policy, deploy_yaml=deploy_yaml, scene=scene, config=config, overwrite=overwrite
        )
    lines = [found["headline"]]
    for part in found["parts"]:
        state = part["level"] if part["checked"] else "not checked"
        lines.append(f"{part['name']:<9} {state}: {part['finding'].replace(chr(10), ' ')}")
        lines += [f"{'':<10}{name}: {text}" for name, text in part["settings"].items()]
        lines += [f"{'':<10}note: {note}" for note in part["notes"] if part["name"] == "contract"]
    lines.append(f"report    {out / 'report.html'}")
    return CommandResult("\n".join(lines), found, strict_exit({"level": found["level"]}, strict), found["level"])
