"""What was understood of a recording, as a page: commands against positions, joint by joint, before any search."""

from collections.abc import Sequence

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.recordings.arrays import RunArrays, run_arrays
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.names import ROLES
from realsim.gap.recordings.proposal import Proposal
from realsim.report import page, svg

MOST_RUNS, MOST_JOINTS, MOST_POINTS = 4, 40, 700
"""What is drawn: the first runs, the first joints, and samples of each evenly spread."""
_REACHED = {
    "position": ("joint_pos", "rad or m"),
    "velocity": ("joint_vel", "rad/s"),
    "torque": ("joint_torque", "N m"),
}


def recording_page(proposal: Proposal, target: Target | None = None, notes: Sequence[str] = ()) -> str:
    """A self-contained HTML page of a proposal; `notes` are those of the case that was written from it."""
    runs = _runs(proposal)
    first = proposal.recordings[0]
    counted = f"{len(proposal.recordings)} run{'s' * (len(proposal.recordings) != 1)}"
    doubtful = [r for r in ROLES if r in proposal.assignments and proposal.assignments[r].doubtful]
    reasons = [f"{r} is in doubt: {proposal.assignments[r].evidence[-1]}" for r in doubtful]
    needed = [m for m in proposal.missing if "(needed)" in m]
    level: page.Level = "bad" if not runs else "look" if doubtful or proposal.warnings else "good"
    headline = "Is every curve where it should be?" if runs else "Commands or positions were not found"
    steps = ["correct what is wrong with --use ROLE=FIELD or --use ROLE=COLUMN,COLUMN", "realsim diagnose CASE --check"]
    body = page.verdict(level, headline, needed + reasons, steps)
    for name, run in runs:
        body += page.card(f"Run {name}", page.grid(*_plots(proposal, target, run)), wide=True)
    body += page.card("Taken for", _table(proposal), wide=True)
    lists = {"Missing": proposal.missing, "Warnings": [*proposal.warnings, *notes], "Time": proposal.clocks}
    body += page.grid(
        *(page.card(title, page.folded_bullets(items, "more", 8)) for title, items in lists.items() if items)
    )
    return page.document("What was understood of a recording", f"{first.path.name} ({first.reader}), {counted}", body)


def _runs(proposal: Proposal) -> list[tuple[str, RunArrays]]:
    found = []
    for recording in proposal.recordings if proposal.complete else ():
        try:
            found.append((recording.name, run_arrays(proposal, recording)))
        except GapError:  # reported where it is written
            continue
        if len(found) == MOST_RUNS:
            break
    return found


def _plots(proposal: Proposal, target: Target | None, run: RunArrays) -> list[str]:
    """A plot for each actuator: what was commanded, and what the joint did."""
    arrays, commanded = run.arrays, proposal.assignments["command"].targets
    driven = dict(zip(target.actuators, target.driven, strict=True)) if target is not None else {}
    role, unit = _REACHED[proposal.command_kind]
    plots = []
    for k, name in enumerate(commanded[:MOST_JOINTS]):
        joint = driven.get(name, name)
        series = [_series("command", arrays["time"], arrays["command"][:, k])]
        if role in arrays and joint in proposal.joints:
            series.append(_series("measured", arrays["time"], arrays[role][:, proposal.joints.index(joint)]))
        if len(series) == 1 and proposal.joints and joint in proposal.joints:
            series = [_series("measured", arrays["time"], arrays["joint_pos"][:, proposal.joints.index(joint)])]
        title = joint if joint == name or not joint else f"{joint} ({name})"
        plots.append(page.card(title or name, svg.line(series, x_label="time (s)", y_label=unit, height=180)))
    return plots


def _series(name: str, time: F64, values: F64) -> svg.Series:
    good = np.flatnonzero(np.isfinite(values))
    rows = good[:: max(1, len(good) // MOST_POINTS)]
    return svg.Series(name, time[rows], values[rows])


def _table(proposal: Proposal) -> str:
    rows = []
    for role in ROLES:
        if role in proposal.assignments:
            found = proposal.assignments[role]
            doubt = "in doubt" if found.doubtful else ""
            rows.append([role, found.source.label, found.order, found.unit, doubt, "; ".join(found.evidence)])
    return page.table(["array", "field", "order", "unit", "", "evidence"], rows)
