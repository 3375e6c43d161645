"""Commands of the joints: the field, its kind, its joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.recordings.evidence import Evidence
from realsim.gap.recordings.joints import SPEEDS, columns_for, torque
from realsim.gap.recordings.proposal import Candidate
from realsim.gap.recordings.signals import held

OTHER_ORDER = 0.3
"""Correlation by which another order of columns must do better than the given one."""


def command(e: Evidence) -> None:
    """The command that the model's actuators take; where none was recorded, the torque that drove the joints."""
    if "joint_pos" not in e.proposal.assignments:
        return
    wanted = e.target.command_kind if e.target is not None else ""
    found = [c for c in (*e.candidates_for("command"), *e.candidates_for("command.")) if _moves(e, c)]
    source = _best(e, found, wanted)
    if source is None and wanted == "torque" and "command" not in e.chosen:
        _measured_torque(e)
        return
    if source is None:
        return
    columns, joints, how = columns_for(e, source)
    if not columns:
        return
    time, field = e.of(source)
    kind = source.role.partition(".")[2] or _kind(e, source, columns) or wanted or "position"
    evidence = [f"by {source.why}", how]
    scale, unit = _scale(e, kind, source)
    if kind == "position":
        columns, said = _order(e, time, field.values, columns, joints)
        evidence += said
    if e.target is None:
        e.settle("command", source, columns, joints, evidence, scale=scale, unit=unit)
    else:
        keep = [j for j in range(len(e.target.actuators)) if e.target.driven[j] in joints]
        order = [joints.index(e.target.driven[j]) for j in keep]
        gear = (
            np.array([e.target.model.actuator_gear[j, 0] for j in keep]) if kind == "position" else np.ones(len(keep))
        )
        if (gear != 1).any():
            evidence.append("multiplied by the actuators' gear: their commands are the actuator's")
        per_joint = np.broadcast_to(scale, len(columns))
        e.settle(
            "command", source, [columns[i] for i in order], [e.target.actuators[j] for j in keep], evidence,
            scale=per_joint[order] * gear, offset=np.array(_offsets(e, joints))[order] if kind == "position" else 0.0,
            unit=unit, doubtful=wanted != kind,
        )  # fmt: skip
        if wanted and wanted != kind:
            e.proposal.warnings.append(
                f"the log commands {kind}s, the model's actuators take {wanted}s: give the model {kind} actuators, "
                f"or name the field of {wanted}s: --use command=STREAM:FIELD"
            )
    e.proposal.command_kind = kind
    _gains(e, source)


def enabled(e: Evidence) -> None:
    """Which drives are on: 0 and 1, one column for all or one a joint."""
    command = e.proposal.assignments.get("command")
    source = e.nearest(e.candidates_for("enabled"))
    if command is None or source is None:
        return
    values = e.of(source)[1].values
    if not set(np.unique(values[np.isfinite(values)])) <= {0.0, 1.0} or not (values == 1).any():
        e.proposal.warnings.append(f"{source.label} is not 0 and 1 for drives that are off and on: left out")
        return
    columns = [0] * len(command.targets)
    if values.shape[1] > 1:
        columns = list(command.columns)
        if values.shape[1] <= max(columns):
            e.proposal.warnings.append(f"{source.label} has {values.shape[1]} columns: left out")
            return
    e.settle("enabled", source, columns, command.targets, [f"by {source.why}", "0 and 1"], unit="1")


def _best(e: Evidence, found: Sequence[Candidate], wanted: str) -> Candidate | None:
    """Of the command's kind that the model takes, before others; then the nearest to the joints' topic."""
    for kinds in ((f"command.{wanted}", "command"), ("command.position", "command.velocity", "command.torque")):
        ranked = [c for c in found if c.role in kinds and columns_for(e, c)[0]]
        if ranked:
            return e.nearest(ranked)
    named = [c for c in found if c.label in {s.label for s in e.chosen.values() if s is not None}]
    return named[0] if named else None


def _moves(e: Evidence, source: Candidate) -> bool:
    """Whether it changes at all: fields of zeros belong to the other kinds of command."""
    values = e.of(source)[1].values
    return bool(np.isfinite(values).any() and np.nanmax(np.nanstd(values, axis=0)) > 1e-9)


def _kind(e: Evidence, source: Candidate, columns: Sequence[int]) -> str:
    """A command without a kind in its name is what it looks like."""
    time, field = e.of(source)
    found = {}
    for kind, role in (("position", "joint_pos"), ("velocity", "joint_vel")):
        beside = e.beside(role, time)
        if beside is not None:
            found[kind] = float(np.median([alike(field.values[:, c], beside[:, k]) for k, c in enumerate(columns)]))
    return max(found, key=lambda k: found[k]) if found and max(found.values()) > 0.5 else ""


def _scale(e: Evidence, kind: str, source: Candidate) -> tuple[F64 | float, str]:
    """(factor to the contract's unit, unit): a position command is in the positions' unit and signs."""
    place = e.proposal.assignments["joint_pos"]
    if kind == "position":
        return np.array(place.scale), place.unit
    sizes = SPEEDS if kind == "velocity" else {"N m": 1.0, "mN m": 1e-3}
    unit = source.unit if source.unit in sizes else next(iter(sizes))
    return sizes[unit], unit


def _offsets(e: Evidence, joints: Sequence[str]) -> list[float]:
    place = e.proposal.assignments["joint_pos"]
    return [place.offset[place.targets.index(j)] for j in joints]


def _order(
    e: Evidence, time: F64, table: F64, columns: Sequence[int], joints: Sequence[str]
) -> tuple[list[int], list[str]]:
    """(columns in the joints' order, what was found): which column each joint follows best, where that is plain."""
    place = e.series("joint_pos")
    assert place is not None
    at_times, positions = place
    if len(columns) < 2:
        return list(columns), []
    asked = held(time, table[:, list(columns)], at_times)
    positions = np.stack([positions[:, e.proposal.joints.index(j)] for j in joints], axis=1)
    corr = np.array(
        [[abs(alike(asked[:, a], positions[:, b])) for a in range(len(columns))] for b in range(len(joints))]
    )
    rows, best = linear_sum_assignment(-corr)
    gain = corr[rows, best] - np.diag(corr)
    moved = [b for b in range(len(joints)) if best[b] != b]
    # Only where every joint that changes its column follows the new one, and not the old one, is it another order.
    if moved and all(gain[b] > OTHER_ORDER and corr[b, best[b]] > 0.8 for b in moved):
        said = ", ".join(f"{joints[b]} follows column {columns[best[b]]}" for b in moved[:6])
        return [columns[i] for i in best], [f"in another order than the positions: {said} (correlation above 0.8)"]
    return list(columns), []


def _measured_torque(e: Evidence) -> None:
    """Torque motors and no command in the log: what was measured is what drove the joints."""
    torque(e)
    found = e.proposal.assignments.get("joint_torque")
    if found is None or e.target is None:
        return
    keep = [j for j in range(len(e.target.actuators)) if e.target.driven[j] in found.targets]
    at = [found.targets.index(e.target.driven[j]) for j in keep]
    e.settle(
        "command", found.source, [found.columns[i] for i in at], [e.target.actuators[j] for j in keep],
        ["no command was recorded, and the model's actuators are torque motors: the measured torque drives them"],
        scale=[found.scale[i] for i in at], unit=found.unit, doubtful=found.doubtful,
    )  # fmt: skip
    e.proposal.command_kind = "torque"


def _gains(e: Evidence, source: Candidate) -> None:
    """Servo gains in the log beside those of the model."""
    stream = e.stream(source)
    prefix = source.member.rpartition(".")[0]
    logged = {g: stream.fields.get(f"{prefix}.{g}" if prefix else g) for g in ("kp", "kd")}
    facts = {g: e.recording.facts.get(g, e.recording.facts.get(g.capitalize())) for g in ("kp", "kd")}
    if e.target is None or e.proposal.command_kind != "position":
        return
    command = e.proposal.assignments["command"]
    for i, name in enumerate(("kp", "kd")):
        model = np.array([e.target.gains[e.target.actuators.index(a), i] for a in command.targets])
        field = logged[name]
        if field is not None and field.width > max(command.columns):
            said = np.nanmedian(field.values[:, list(command.columns)], axis=0)
            off = float((field.values[:, list(command.columns)] == 0).all(axis=1).mean())
            if name == "kp" and off > 0.01:
                e.proposal.warnings.append(
                    f"kp is 0 in {off:.0%} of the commands: torque is off there; read the rest: --skip, --seconds"
                )
        elif isinstance(facts[name], (int, float)):
            said = np.full(len(model), float(facts[name]))
        else:
            continue
        odd = np.abs(said - model) > 0.02 * np.maximum(np.abs(model), 1e-6)
        if odd.any():
            j = int(np.argmax(odd))
            e.proposal.warnings.append(
                f"{name} of {int(odd.sum())} servos is not the model's: {command.targets[j]} has {said[j]:.4g} logged, "
                f"{model[j]:.4g} in the model: set what was sent, if it is in N m/rad"
            )
