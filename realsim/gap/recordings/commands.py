"""Commands of the joints: the field, its kind, its joints."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.units import ANGLE, FORCE, LENGTH, MOVING, TORQUE, TURNING, nearest_unit
from realsim.gap.recordings.evidence import Evidence
from realsim.gap.recordings.joints import columns_for, kinds_of, torque
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.names import known_type, match_joints
from realsim.gap.recordings.pairing import ALIKE, BETTER, LEADS, PLAIN, agreement, leads, pair
from realsim.gap.recordings.proposal import Candidate
from realsim.gap.recordings.recording import Field
from realsim.gap.recordings.signals import follows

OTHER_UNIT = 3.0
"""Ratio of what was commanded to what was reached from which it is not in the positions' unit."""
THE_UNIT = 1.6
"""Ratio up to which it is in another one."""
BY_VALUES = "what the joints did: they follow it"
FOLLOWS = 0.8
"""Correlation from which a joint tells the size of its command."""


def command(e: Evidence) -> None:
    """The command that the model's actuators take; where none was recorded, the torque that drove the joints."""
    if e.target is not None and not e.target.joints:
        _of_a_body(e, e.target)
        return
    if "joint_pos" not in e.proposal.assignments:
        return
    wanted = e.target.command_kind if e.target is not None else ""
    found = [c for c in (*e.candidates_for("command"), *e.candidates_for("command.")) if moves(e, c)]
    source = _best(e, found, wanted)
    if source is None and wanted == "torque" and "command" not in e.chosen:
        _measured_torque(e)
        return
    if source is None and "command" not in e.chosen:
        source = _leader(e)
    if source is None:
        return
    columns, joints, how = columns_for(e, source)
    if not columns:
        return
    kind = source.role.partition(".")[2] or _kind(e, source, columns) or wanted or "position"
    evidence = [f"by {source.why}", how]
    doubtful = source.why == BY_VALUES
    if kind == "position":
        columns, reasons, odd = _order(e, source, columns, joints, named=how.startswith("its columns name"))
        evidence += reasons
        doubtful |= odd
    scale, unit, offset, reasons, odd = _scale(e, kind, source, columns, joints)
    evidence += reasons
    doubtful |= odd
    names, order, gear = _driving(e.target, joints)
    if kind != "position":
        gear = np.ones(len(order))
    if (gear != 1).any():
        evidence.append("multiplied by the actuators' gear: their commands are the actuator's")
    e.settle("command", source, [columns[i] for i in order], names, evidence, scale=scale[order] * gear,
             offset=offset[order], unit=unit, doubtful=doubtful or bool(e.target and wanted != kind))  # fmt: skip
    if wanted not in ("", kind):
        e.warn(
            f"the log commands {kind}s, the model's actuators take {wanted}s: give the model {kind} actuators, "
            f"or name the field of {wanted}s: --use command=STREAM:FIELD"
        )
    e.proposal.command_kind = kind
    _gains(e, source)


def _driving(target: Target | None, joints: Sequence[str]) -> tuple[list[str], list[int], F64]:
    """(the actuators of these joints, or without a model the joints; the place of each one's joint; gears)."""
    if target is None:
        return list(joints), list(range(len(joints))), np.ones(len(joints))
    keep = [u for u, joint in enumerate(target.driven) if joint in joints]
    order = [list(joints).index(target.driven[u]) for u in keep]
    return [target.actuators[u] for u in keep], order, target.model.actuator_gear[keep, 0]


def of_the_policy(e: Evidence) -> None:
    """The velocity command that a policy was given, where the user names it.

    Raises:
        GapError: it is not three wide.
    """
    source = next(iter(e.candidates_for("policy_command")), None)
    if source is None:
        return
    if (width := e.of(source)[1].width) != 3:
        raise GapError(
            "--use policy_command names no velocity command", file=e.recording.path,
            expected="three columns: forward, to the left (m/s), turning (rad/s)", found=f"{source.label}: {width}",
            hint="--use policy_command=VX,VY,WZ; of a Twist, FIELD[item] is one: linear[0],linear[1],angular[2]",
        )  # fmt: skip
    e.settle("policy_command", source, range(3), ("vx", "vy", "wz"), ["as named"], unit="m/s and rad/s")


def _leader(e: Evidence) -> Candidate | None:
    """A field without a telling name that the joints follow: commands, by what they did."""
    home = e.proposal.assignments["joint_pos"]
    taken = {a.source.label for a in e.proposal.assignments.values()}
    found = {}
    for c in e.candidates:
        columns = columns_for(e, c)[0]
        if c.label in taken or len(columns) < len(home.columns) or c.role not in ("", "joint_pos", "joint_vel"):
            continue
        time, field = e.of(c)
        place = e.beside("joint_pos", time)
        if place is not None and (corr := leads(time, field.values[:, columns], place)) > LEADS:
            found[c] = corr
    best = max(found, key=lambda c: found[c], default=None)
    return None if best is None else replace(best, role="command.position", why=BY_VALUES)


def _of_a_body(e: Evidence, target: Target) -> None:
    """Commands of a body without joints, a drone's: a column for each actuator, by name, else in their order."""
    named = [c for c in e.candidates if not c.role and len(match_joints(e.of(c)[1].labels, target.actuators)) > 1]
    found = [c for c in (*e.candidates_for("command"), *e.candidates_for("command.")) if moves(e, c)]
    fitting = [(c, _actuators(e.of(c)[1], target)) for c in found or ("command" not in e.chosen and named) or ()]
    ranked = [(c, columns, how) for c, (columns, how) in fitting if columns]
    if not ranked:
        return
    source, columns, how = min(ranked, key=lambda r: (r[0].unit not in ("N", "N m"), r[0].label))
    thrust = "the thrust that the motors' PWM means is another drone's figure: compare the weight with the mean thrust"
    derived = e.stream(source).type == "crazyflie"
    e.settle("command", source, columns, target.actuators, [f"by {source.why}", how, thrust if derived else ""],
             unit=source.unit or "the actuators' own", doubtful=derived or not source.unit)  # fmt: skip
    e.proposal.command_kind = target.command_kind


def _actuators(field: Field, target: Target) -> tuple[list[int], str]:
    """(column of each actuator, why); none where the field has too few."""
    at = match_joints(field.labels, target.actuators)
    if len(at) == len(target.actuators):
        inverse = {name: column for column, name in at.items()}
        return [inverse[a] for a in target.actuators], "its columns name the actuators"
    if field.width == len(target.actuators):
        return list(range(field.width)), "unnamed columns: in the order of the model's actuators"
    return [], ""


def enabled(e: Evidence) -> None:
    """Which drives are on: 0 and 1, one column for all or one a joint."""
    command = e.proposal.assignments.get("command")
    source = e.nearest(e.candidates_for("enabled"))
    if command is None or source is None:
        return
    values = e.of(source)[1].values
    if not set(np.unique(values[np.isfinite(values)])) <= {0.0, 1.0} or not (values == 1).any():
        e.warn(f"{source.label} is not 0 and 1 for drives that are off and on: left out")
        return
    columns = [0] * len(command.targets)
    if values.shape[1] > 1:
        columns = list(command.columns)
        if values.shape[1] <= max(columns):
            e.warn(f"{source.label} has {values.shape[1]} columns: left out")
            return
    e.settle("enabled", source, columns, command.targets, [f"by {source.why}", "0 and 1"], unit="1")


def _best(e: Evidence, found: Sequence[Candidate], wanted: str) -> Candidate | None:
    """Of the command's kind that the model takes, before others; then the nearest to the joints' topic."""
    for kinds in ((f"command.{wanted}",), ("command",), ("command.position", "command.velocity", "command.torque")):
        ranked = [c for c in found if c.role in kinds and columns_for(e, c)[0]]
        if ranked:
            return e.nearest(ranked)
    named = [c for c in found if c.label in {s.label for s in e.chosen.values() if s is not None}]
    return named[0] if named else None


def moves(e: Evidence, source: Candidate) -> bool:
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


def _scale(
    e: Evidence, kind: str, source: Candidate, columns: Sequence[int], joints: Sequence[str]
) -> tuple[F64, str, F64, list[str], bool]:
    """((K,) factors to the contract's unit, unit, (K,) offsets, what was found, whether that is in doubt).

    A position command is in the positions' unit and signs, unless its name or what the joints did says otherwise.
    """
    declared, units, reasons = e.units(source, columns), list[str](), list[str]()
    if kind != "position":
        scale = np.ones(len(columns))
        both = (TURNING, MOVING) if kind == "velocity" else (TORQUE, FORCE)
        for given, sizes, part in kinds_of(e.target, joints, declared, *both):
            units.append(given if given in sizes else next(iter(sizes)))
            scale[part] = sizes[units[-1]]
        return scale, ", ".join(dict.fromkeys(units)), np.zeros(len(columns)), [], False
    place = e.proposal.assignments["joint_pos"]
    at = [place.targets.index(j) for j in joints]
    scale, offset = np.array(place.scale)[at], np.array(place.offset)[at]
    gains: list[list[float]] = [[] for _ in columns]
    for time, commanded, done in e.in_runs(source, "joint_pos"):
        for k, column in enumerate(columns):
            corr, _, gain, _ = follows(time, scale[k] * (commanded[:, column] - offset[k]), done[:, at[k]])
            gains[k] += [gain] if corr > FOLLOWS else []
    for given, sizes, part in kinds_of(e.target, joints, declared, ANGLE, LENGTH):
        own, known = abs(scale[part[0]]), [g for k in part for g in gains[k]]
        factor, unit = float(np.median(known)) if known else 1.0, given if given in sizes else ""
        if not unit and max(factor, 1 / factor) > OTHER_UNIT:
            near = nearest_unit(1 / (factor * own), sizes)
            if max(factor * own / sizes[near], sizes[near] / (factor * own)) < THE_UNIT:
                unit = near
                text = f"the joints do {factor:.3g} times as much as is commanded in {place.unit}: it is in {near}"
                reasons.append(text)
        if unit and abs(sizes[unit] / own - 1) > 1e-6:
            scale[part], offset[part] = np.sign(scale[part]) * sizes[unit], 0.0
        units.append(unit or place.unit)
    return scale, ", ".join(dict.fromkeys(units)), offset, reasons, place.doubtful


def _order(
    e: Evidence, source: Candidate, columns: Sequence[int], joints: Sequence[str], *, named: bool
) -> tuple[list[int], list[str], bool]:
    """(columns in the joints' order, what was found, whether that is in doubt), by all runs together.

    Names are kept; columns side by side in one table, or of types that define their order, give way to a plain
    difference; the order of another topic is nobody's promise.
    """
    if len(columns) < 2:
        return list(columns), [], False
    place = e.proposal.assignments["joint_pos"]
    at = [place.targets.index(j) for j in joints]
    scale, offset = np.array(place.scale)[at], np.array(place.offset)[at]
    tables = [
        agreement(time, scale * (commanded[:, list(columns)] - offset), done[:, at])
        for time, commanded, done in e.in_runs(source, "joint_pos")
    ]
    found = pair(tables, range(len(columns)))
    moved = [b for b in range(len(joints)) if found.columns[b] != b]
    which = ", ".join(f"{joints[b]} follows column {columns[found.columns[b]]}" for b in moved[:6])
    if named:
        if found.gain < PLAIN:
            return list(columns), [], False
        text = f"the names say otherwise than the signals: {which}: check the names"
        e.proposal.assignments["joint_pos"] = replace(place, evidence=(*place.evidence, text), doubtful=True)
        return list(columns), [text], True
    types = e.stream(source).type, e.stream(place.source).type
    files = types == ("table", "table") and source.member == place.source.member  # of one program
    promised = source.stream == place.source.stream or files or all(map(known_type, types))
    needed = PLAIN if promised else BETTER
    if moved and found.gain > needed and found.steady:
        runs = f" in {len(tables)} runs" if len(tables) > 1 else ""
        reasons = f"in another order than the positions{runs}: {which} (agreement better by {found.gain:.2f})"
        return [columns[i] for i in found.columns], [reasons], found.margin < ALIKE
    if moved and found.gain > BETTER:
        return list(columns), [f"another order fits better by {found.gain:.2f}: {which}: check, or use --use"], True
    if not promised and found.margin < ALIKE:
        return list(columns), ["joints were moved alike: the signals do not tell the order; name it: --use"], True
    return list(columns), [], False


def _measured_torque(e: Evidence) -> None:
    """Torque motors and no command in the log: what was measured is what drove the joints."""
    torque(e, unnamed=True)
    found = e.proposal.assignments.get("joint_torque")
    if found is None or e.target is None or e.proposal.torque_kind != "measured":  # a current is none in N m
        return
    leader = _leader(e)
    doubt = f"but they follow {leader.label}: were they commanded by it? --use command={leader.label}" if leader else ""
    names, at, _ = _driving(e.target, found.targets)
    e.settle(
        "command", found.source, [found.columns[i] for i in at], names,
        ["no command was recorded, and the model's actuators are torque motors: the measured torque drives them",
         doubt],
        scale=[found.scale[i] for i in at], unit=found.unit, doubtful=found.doubtful or bool(doubt),
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
            recorded = np.nanmedian(field.values[:, list(command.columns)], axis=0)
            off = float((field.values[:, list(command.columns)] == 0).all(axis=1).mean())
            if name == "kp" and off > 0.01:
                e.warn(f"kp is 0 in {off:.0%} of the commands: torque is off there; read the rest: --skip, --seconds")
        elif isinstance(facts[name], (int, float)):
            recorded = np.full(len(model), float(facts[name]))
        else:
            continue
        odd = np.abs(recorded - model) > 0.02 * np.maximum(np.abs(model), 1e-6)
        if odd.any():
            j = int(np.argmax(odd))
            e.warn(
                f"{name} of {int(odd.sum())} servos is not the model's: {command.targets[j]} has {recorded[j]:.4g} "
                f"logged, {model[j]:.4g} in the model: set what was sent, if it is in N m/rad"
            )
