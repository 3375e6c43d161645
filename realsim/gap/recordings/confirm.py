"""The last look before a case is written: whether its values are what their names say, joint by joint.

A joint follows its command: later, as far, near the same place. A velocity is the slope of its position. A torque goes
with what inverse dynamics asks for, else with what the servo does. What does not agree is in doubt, whatever its names.

The figures were set on fourteen recordings with 300 lies put in (columns exchanged, negated, in another unit, shifted):
138 were silent before, 7 are. On ten other recordings with 192 lies, looked at afterwards, 87 and 6.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.case.units import NEAR, speed_factor, travelled
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.evidence import MOST_RUNS
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.proposal import Proposal
from realsim.gap.recordings.signals import follows

MOVES = 1e-3
"""rad or m of spread from which a joint moves."""
STIRS = 0.02
"""The same of a joint with an actuator that nothing commands, from which a command of it is lacking."""
FOLLOWS = 0.7
"""Correlation below which a joint does not follow its command."""
AS_FAR = 2.0
"""Ratio of what a joint did to what was commanded, up to which it may be a servo's."""
LEVEL = 0.5
"""rad or m between what a joint did and what was commanded, in the median, from which zero is another one."""
SLOPE = 0.6
"""Correlation with the positions' slope below which a velocity is none of it."""
_Odd = partial(defaultdict[str, list[str]], list)
"""What is odd -> the joints."""
Runs = Mapping[str, Mapping[str, F64]]
"""Name of a run -> its arrays."""


def confirm(proposal: Proposal, target: Target | None) -> None:
    """Put arrays in doubt that disagree with the others, and say how the joints follow their commands."""
    if not proposal.complete or proposal.jointless:
        return
    runs: dict[str, Mapping[str, F64]] = {}
    for recording in proposal.recordings[:MOST_RUNS]:
        try:
            runs[recording.name] = run_arrays(proposal, recording).arrays
        except GapError:
            continue  # reported when it is written
    _command(proposal, target, runs)
    _velocity(proposal, runs)


def _command(proposal: Proposal, target: Target | None, runs: Runs) -> None:
    reached = {"position": "joint_pos", "velocity": "joint_vel"}.get(proposal.command_kind, "")
    if reached not in proposal.assignments:
        return
    joints, odd = proposal.assignments[reached].targets, _Odd()
    rows, in_run, commanded = [], {n: list[float]() for n in runs}, list[str]()
    for k, name in enumerate(proposal.assignments["command"].targets):
        u = target.actuators.index(name) if target is not None else 0
        joint = target.driven[u] if target is not None else name
        commanded.append(joint)
        gear = target.model.actuator_gear[u, 0] if target is not None and reached == "joint_pos" else 1.0
        pairs = {
            n: (r["time"], _sent(r, k) / gear, r[reached][:, joints.index(joint)])
            for n, r in runs.items()
            if reached in r and np.isfinite(_sent(r, k)).any()
        }
        moving = {n: p for n, p in pairs.items() if np.nanstd(p[1]) > MOVES and np.nanstd(p[2]) > MOVES}
        if not moving:
            rests = [np.nanstd(done) for _, sent, done in pairs.values() if np.nanstd(sent) <= MOVES]
            if len(rests) == len(pairs) and max(rests, default=0.0) > STIRS:
                odd["moves while its command rests"].append(joint)
            continue
        ways = {n: follows(*p) for n, p in moving.items()}
        for n, way in ways.items():
            in_run[n].append(way[0])
        corr, _, gain, _ = row = np.median(list(ways.values()), axis=0)
        before = np.median([follows(t, done, sent)[:2] for t, sent, done in moving.values()], axis=0)
        off = float(np.median([np.nanmedian(done - sent) for _, sent, done in moving.values()]))
        rows.append(row)
        if before[0] > corr and before[1] > 0:
            odd[f"moves {1e3 * before[1]:.3g} ms before its command: are the two exchanged?"].append(joint)
        elif corr < FOLLOWS:
            odd["does not follow its command"].append(joint)
        elif not 1 / AS_FAR < gain < AS_FAR:
            odd[f"goes {gain:.3g} times as far as commanded"].append(joint)
        elif abs(off) > LEVEL and reached == "joint_pos":
            odd[f"stays {off:+.3g} from its command"].append(joint)
    for joint in (j for j in joints if target is not None and j in target.driven and j not in commanded):
        if any(np.nanstd(r[reached][:, joints.index(joint)]) > STIRS for r in runs.values() if reached in r):
            odd["moves, and its command is not taken"].append(joint)
    if rows:
        corr, lag, gain, _ = np.median(np.array(rows), axis=0)
        text = f"the joints follow it: correlation {corr:.3f}, {1e3 * lag:.3g} ms later, gain {gain:.3g}"
        _say(proposal, "command", [text], doubtful=False)
    _say(proposal, "command", [f"{', '.join(names[:4])}: {what}" for what, names in odd.items()])
    if idle := [f"{n} (correlation {np.median(c):.2f})" for n, c in in_run.items() if c and np.median(c) < FOLLOWS]:
        proposal.warnings.append(
            f"the joints hardly follow the command in {', '.join(idle[:6])}: was torque off, or is it another robot's?"
        )


def _sent(run: Mapping[str, F64], k: int) -> F64:
    """(T,) an actuator's command while its drive was on."""
    return (
        np.where(run["enabled"][:, k] > 0, run["command"][:, k], np.nan) if "enabled" in run else run["command"][:, k]
    )


def _velocity(proposal: Proposal, runs: Runs) -> None:
    if "joint_vel" not in proposal.assignments:
        return
    odd = _Odd()
    for k, joint in enumerate(proposal.assignments["joint_vel"].targets):
        ways = [
            travelled(r["time"][own], place[own], r["joint_vel"][own, k])
            for r in runs.values()
            if "joint_vel" in r and (own := np.isfinite(place := r["joint_pos"][:, proposal.joints.index(joint)])).any()
        ]
        speed = speed_factor(*(np.concatenate(side) for side in zip(*ways, strict=True))) if ways else None
        if speed is None or not np.isfinite(speed.ratio):
            continue
        if abs(speed.corr) < SLOPE:
            odd["has nothing to do with its position: --use joint_vel=none leaves it out"].append(joint)
        elif abs(speed.ratio - 1) > NEAR:
            odd[f"is {speed.ratio:.3g} times the positions' slope"].append(joint)
    _say(proposal, "joint_vel", [f"that of {', '.join(joints[:4])} {what}" for what, joints in odd.items()])


def _say(proposal: Proposal, role: str, texts: Sequence[str], *, doubtful: bool = True) -> None:
    found = proposal.assignments[role]
    if texts:
        evidence = (*found.evidence, *texts)
        proposal.assignments[role] = replace(found, evidence=evidence, doubtful=found.doubtful or doubtful)
