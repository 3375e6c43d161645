"""The folder of an experiment: command files, instructions, and a page of what each rival predicts."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import to_json, write_bytes, write_text
from realsim.gap.case.case import Case
from realsim.gap.case.recordings import PLAN, RECORDED
from realsim.gap.experiments.choose import Looked
from realsim.gap.experiments.picture import page_of
from realsim.gap.experiments.plan import Experiment, Planned
from realsim.gap.experiments.rivals import Rival


def write_experiment(
    folder: Path, case: Case, looked: Sequence[Looked], rivals: Sequence[Rival], proposal: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the best of `looked` into a folder that exists; returns what experiment.json holds.

    Args:
        asked: `next_experiment` of the diagnosis, see `realsim.gap.experiments.proposal.described`.
    """
    predicted = looked[0].predicted
    assert predicted is not None
    experiment = predicted.experiment
    for run in experiment.runs:
        write_text(folder / "commands" / f"{run.name}.csv", _csv(case, run))
        arrays: dict[str, Any] = {"time": run.time, "command": run.command}
        if run.enabled is not None:
            arrays["enabled"] = np.asarray(run.enabled, np.uint8)
        data = io.BytesIO()
        np.savez_compressed(data, **arrays)
        write_bytes(folder / "commands" / f"{run.name}.npz", data.getvalue())
    plan = {
        **{k: v for k, v in proposal.items() if k != "rivals"},
        "title": experiment.title,
        "command_kind": case.command_kind,
        "actuator_names": list(case.actuator_names),
        "runs": setups(experiment),
        "files": [f"commands/{run.name}.csv" for run in experiment.runs],
        "instructions": instructions(case, experiment),
    }
    write_text(folder / PLAN, to_json(plan))
    write_text(folder / "README.md", _readme(case, plan))
    write_text(folder / "report.html", page_of(case, looked, rivals, plan))
    (folder / RECORDED).mkdir()
    return plan


def setups(experiment: Experiment) -> dict[str, Any]:
    """Run -> masses and gains, as `runs` of log.json says them."""
    found: dict[str, Any] = {}
    for run in experiment.runs:
        entry: dict[str, Any] = {}
        if run.setup.payload:
            entry["payload"] = [{"body": b, "mass": m, "at": list(at)} for b, m, at in run.setup.payload]
        for actuator, which, value in run.setup.gains:
            entry.setdefault("gains", {}).setdefault(actuator, {})[which] = value
        if entry:
            found[run.name] = entry
    return found


def instructions(case: Case, experiment: Experiment) -> list[str]:
    """What to do, in the order in which it is done."""
    unit = {"position": "rad (m)", "velocity": "rad/s (m/s)", "torque": "N m (N)"}[case.command_kind]
    return [
        *experiment.instructions,
        f"Begin at rest under the first command. Send the columns command_* ({unit}, held from row to row) in time.",
        f"Log what the other runs logged. Save each run under its name in {RECORDED}/ (.npz or .csv).",
    ]


def _readme(case: Case, plan: Mapping[str, Any]) -> str:
    steps = "\n".join(f"{i}. {line}" for i, line in enumerate(plan["instructions"], 1))
    files = "\n".join(f"- {name}" for name in plan["files"])
    return (
        f"# {plan['title']}\n\n{plan['text']}\n\n{steps}\n\nCommand files (.csv, and the same as .npz):\n\n{files}\n\n"
        f"Then, with CASE and THIS the two folders:\n\n    realsim diagnose CASE THIS --out diagnosis\n"
    )


def _csv(case: Case, run: Planned) -> str:
    """time, command_ACTUATOR, and enabled_ACTUATOR where drives are switched off."""
    head = ["time", *(f"command_{name}" for name in case.actuator_names)]
    columns = [run.time[:, None], run.command]
    if run.enabled is not None:
        head += [f"enabled_{name}" for name in case.actuator_names]
        columns.append(np.asarray(run.enabled, float))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([f"{v:.6g}" for v in row] for row in np.concatenate(columns, axis=1))
    return text.getvalue()
