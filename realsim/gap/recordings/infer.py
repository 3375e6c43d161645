"""Recordings -> a proposal: roles by names first, then order, unit and sign by what signals and model say.

Each hypothesis is measured against the others (a velocity against the positions' slope, gravity in the accelerometer,
a torque against inverse dynamics, ranges of the joints), and the measure is what is shown as its evidence.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from realsim.core.errors import GapError, did_you_mean
from realsim.gap.case.runs import find_gaps
from realsim.gap.recordings import body, commands, joints, overrides
from realsim.gap.recordings.clocks import Clocked, clocked
from realsim.gap.recordings.confirm import confirm
from realsim.gap.recordings.depth import choose, is_frames
from realsim.gap.recordings.evidence import Evidence
from realsim.gap.recordings.model import NO_SERVOS, Target
from realsim.gap.recordings.names import meaning
from realsim.gap.recordings.pairing import LEADS, MOST_COLUMNS, blocks, leads
from realsim.gap.recordings.proposal import Candidate, Proposal
from realsim.gap.recordings.recording import Field, Recording, Stream
from realsim.gap.recordings.vocabulary import english
from realsim.gap.recordings.world import World

LETTERS = {"r": "target position", "y": "measured position", "u": "control torque"}
"""Reference, output and input of a plant in textbooks of control, where y and u stand side by side."""
DESIRED = re.compile(r"(^|[\W_])(d?q|theta|tau(_?J)?)_d$")
"""As papers and libfranka write what is desired: q_d, tau_J_d; it may be a slope where velocities have no name."""


def propose(
    recordings: Sequence[Recording],
    target: Target | None = None,
    *,
    use: Sequence[str] = (),
    only: str = "",
    camera: str = "",
    world: World | None = None,
) -> Proposal:
    """Content of recordings of one layout, and the proposed case.

    Args:
        recordings: one a run.
        target: the model that the case is for; without it, order and signs are not tested.
        use: what the user knows better (see `realsim.gap.recordings.overrides`).
        only: topics whose names begin so; for recordings of several robots.
        camera: of the model, by which depth frames were seen (see `realsim.gap.recordings.depth.choose`).
        world: of the scene into whose frame base poses are put.

    Raises:
        GapError: two robots, a name in `use` or `only` that is not there.
    """
    kept, uses = overrides.apply([_only(r, only) for r in recordings], use)
    main = max(kept, key=lambda r: (len(r.streams), max((s.count for s in r.streams), default=0)))
    frames = {s.name for s in main.streams if is_frames(s)}
    times = clocked(main)
    by_values = _by_values(main, target, uses)
    if by_values:
        kept, more = overrides.apply(kept, by_values)
        uses = more | uses
        main = next(r for r in kept if r.name == main.name)
    candidates = _candidates(main)
    chosen = {
        role: next((c for c in candidates if (c.stream, c.member) == (u.stream, u.member)), None)
        for role, u in uses.items()
    }
    proposal = Proposal(list(kept), model=str(target.path) if target else "")
    proposal.jointless = target is not None and not target.joints
    proposal.base = "floating" if target is not None and target.floating else "fixed"
    _describe_clocks(proposal, times, frames)
    proposal.warnings += list(dict.fromkeys(n for r in kept for n in r.notes))

    evidence = Evidence(main, times, target, candidates, chosen, proposal, kept)
    joints.position(evidence)
    joints.velocity(evidence)
    commands.command(evidence)
    commands.enabled(evidence)
    joints.torque(evidence)
    body.orientation(evidence)
    body.accelerometer(evidence)
    body.gyroscope(evidence)
    body.place(evidence)
    body.contact(evidence)
    commands.of_the_policy(evidence)
    if target is not None:
        proposal.depth, lacks = choose(main, target, camera)
        proposal.missing += [lacks] if lacks else []
    for text in by_values:
        role = text.partition("=")[0]
        if role in proposal.assignments:
            found = proposal.assignments[role]
            why = (f"{text}: by its values alone, no name tells it", *found.evidence)
            proposal.assignments[role] = replace(found, doubtful=True, evidence=why)
    if world is not None and "base_pos" not in proposal.assignments:
        raise GapError(
            "there is no base pose to put into the scene", file=main.path,
            expected="an Odometry or PoseStamped of the base, and the model of a robot that moves",
            found=", ".join(proposal.assignments) or "nothing",
        )  # fmt: skip
    proposal.world = world
    confirm(proposal, target)
    _missing(evidence)
    used = {a.source.label for a in proposal.assignments.values()}
    proposal.unused = sorted({_label(s, n) for s in main.streams if not is_frames(s) for n in s.fields} - used)
    return proposal


def _only(recording: Recording, prefix: str) -> Recording:
    if not prefix:
        return recording
    kept = tuple(s for s in recording.streams if s.name.startswith(prefix))
    if not kept:
        names = [s.name for s in recording.streams]
        raise GapError(
            f"no topic begins with {prefix!r}", file=recording.path, found=", ".join(names[:20]),
            hint=did_you_mean(prefix, names),
        )  # fmt: skip
    return replace(recording, streams=kept)


def _candidates(recording: Recording) -> list[Candidate]:
    found = []
    for stream in (s for s in recording.streams if not is_frames(s)):
        for name, field in stream.fields.items():
            letter = LETTERS.get(name) if {"y", "u"} <= set(stream.fields) else None
            role, unit, why = meaning(stream.name, stream.type, letter or name)
            why = f"the letter {name!r} of control engineering" if letter else why
            if role in ("", "joint_pos") and (found_ := _by_axes(name, field.labels)):
                role, unit, why = found_, "", f"the axes {', '.join(field.labels)} of {name!r}"
            found.append(Candidate(stream.name, name, role, field.unit or unit, why))
    known = {c.role.partition(".")[0] for c in found if not DESIRED.search(c.member)}
    if "joint_vel" not in known or "command" in known:
        return found
    roles = {c: meaning("", "", f"{c.member[:-2]}_desired")[0] for c in found if DESIRED.search(c.member)}
    return [replace(c, role=roles[c], why=f"the letter d of {c.member!r}") if c in roles else c for c in found]


def _by_axes(name: str, labels: Sequence[str]) -> str:
    """The role of axes whose names say no more than that a state was measured or estimated: `stateEstimate.x`."""
    if {*labels} == {*"xyzw"}:
        return "base_quat"
    return "base_pos" if {*labels} == {*"xyz"} and {*english(name)} <= {"measured", "filtered"} else ""


def _by_values(recording: Recording, target: Target | None, uses: Mapping[str, overrides.Use]) -> list[str]:
    """`--use` texts for a table in which no name tells positions, from what its columns do."""
    role_of = {c.member: c.role for c in _candidates(recording)}
    named = {r.partition(".")[0] for r in role_of.values()} | set(uses)
    if target is None or not target.joints or "joint_pos" in named or len(recording.streams) != 1:
        return []
    stream, width = recording.streams[0], len(target.joints)
    open_ = {n: f for n, f in stream.fields.items() if role_of.get(n) in ("", "joint_vel")}
    columns = [(name, f.values[:, k]) for n, f in open_.items() for k, name in enumerate(_columns(n, f))]
    if not columns:
        return []
    time = clocked(recording)[stream.name].time
    values = np.stack([v for _, v in columns[:MOST_COLUMNS]], axis=1)
    found = blocks(time, values, width)
    commanded = [stream.fields[n] for n, r in role_of.items() if r in ("command", "command.position")]
    for field in (
        f for f in commanded if f.width == width and "joint_pos" not in found
    ):  # positions follow their command
        ways = {k: leads(time, field.values, values[:, k : k + width]) for k in range(values.shape[1] - width + 1)}
        best = max(ways, key=lambda k: ways[k], default=-1)
        found |= {"joint_pos": best} if best >= 0 and ways[best] > LEADS else {}
    texts = {role: ",".join(n for n, _ in columns[k : k + width]) for role, k in found.items() if role not in named}
    whole = {",".join(_columns(n, f)): n for n, f in open_.items()}
    return [f"{role}={whole.get(text, text)}" for role, text in texts.items()]


def _columns(name: str, field: Field) -> list[str]:
    """How each column of a field is named in `--use`."""
    if len(field.columns) == field.width:
        return list(field.columns)
    return [f"{name}[{k}]" for k in range(field.width)]


def _describe_clocks(proposal: Proposal, times: Mapping[str, Clocked], frames: set[str]) -> None:
    for name, found in times.items():
        stamps = np.sort(found.time[np.isfinite(found.time)])
        step = np.diff(stamps)
        rate = 1 / float(np.median(step)) if len(step) and np.median(step) > 0 else 0.0
        proposal.clocks.append(f"{name or 'table'}: {rate:.4g} Hz; " + "; ".join(found.notes))
        proposal.warnings += list(found.warnings)
        if name in frames:
            continue
        if 0 < rate < 20:
            proposal.warnings.append(
                f"{name or 'table'}: {rate:.3g} samples per second are few: delay, friction and gains blur"
            )
        if gaps := find_gaps(stamps):
            proposal.warnings.append(f"{name or 'table'}: {len(gaps)} gaps in time, the longest of {step.max():.3g} s")


def _missing(e: Evidence) -> None:
    proposal, target, have, missing = e.proposal, e.target, e.proposal.assignments, e.proposal.missing
    example = _example(proposal)
    if proposal.place not in have and proposal.jointless:
        missing.append("base_pos (needed): no field of the body's position; name it: --use base_pos=STREAM:FIELD")
    elif proposal.place not in have:
        what = "no field of joint positions is known by its name"
        missing.append(f"joint_pos (needed): {what}; name it: --use joint_pos={example}")
    candidates = [c for c in e.candidates if c.role.startswith("command")]
    labels, still = ", ".join(c.label for c in candidates[:3]), not any(commands.moves(e, c) for c in candidates)
    if "command" not in have and candidates:
        what = "never changes, which tells nothing of the joints: record motion"
        what = what if still else f"is no command of these joints by its columns; name them: --use command={example}"
        missing.append(f"command (needed): {labels} {what}")
    elif "command" not in have:
        what = f"no field of commands is known by its name; name it: --use command={example}"
        missing.append(f"command (needed): {what}; or record the command topic too")
    optional = {} if proposal.jointless else {
        "joint_vel": "velocities", "joint_torque": "torques: gains, friction and payload are distinguished by them",
    }  # fmt: skip
    if proposal.base == "floating":
        optional |= {
            "base_quat": "the base's orientation", "base_pos": "the base's position",
            "imu_gyro": "angular velocity of the base", "contact": "which foot stands",
        }  # fmt: skip
    optional.pop(proposal.place, None)  # needed: named above
    missing += [f"{role}: {what}{_why_not(e, role)}" for role, what in optional.items() if role not in have]
    if target is None:
        missing.append("--model: without it the order, signs and units of joints are not tested")
    elif not target.actuators:
        missing.append(f"actuators of the model (needed): {NO_SERVOS}")
    elif proposal.joints:
        left = [j for j in target.joints if j not in proposal.joints]
        if left:
            proposal.warnings.append(f"joints of the model that are not in the log stay at rest: {', '.join(left[:8])}")


def _why_not(e: Evidence, role: str) -> str:
    """Why the fields that may have been this array are not it, in brackets."""
    if role in e.chosen and e.chosen[role] is None:
        return f" (left out by --use {role}=none)"
    labels = [c.label for c in e.candidates if c.role == role]
    lines = [*e.proposal.warnings, *e.proposal.missing]
    why = [w for w in lines if w.startswith(tuple(f"{n}{end}" for n in labels for end in " :"))]
    why = why or [f"{n} does not fit the model" for n in labels[:3]]
    return f" ({'; '.join(why)})" if why else ""


def _example(proposal: Proposal) -> str:
    """How a field is named in this recording."""
    first = proposal.recordings[0].streams[0]
    if not any(f.columns for f in first.fields.values()):
        return f"STREAM:FIELD, as {_label(first, next(iter(first.fields)))}"
    names = list(dict.fromkeys(c for n, f in first.fields.items() for c in _columns(n, f)))
    return f'"COLUMN,COLUMN,..." of {", ".join(names if len(names) < 8 else [*names[:3], "...", names[-1]])}'


def _label(stream: Stream, name: str) -> str:
    return f"{stream.name}:{name}" if stream.name else name
