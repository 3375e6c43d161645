"""Positions, velocities and torques of joints: which column is which joint, in which unit, with which sign."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from shlex import quote
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.units import (
    ANGLE,
    LENGTH,
    MOVING,
    NEAR,
    TORQUE,
    TURNING,
    factor,
    nearest_unit,
    speed_factor,
    travelled,
)
from realsim.gap.recordings.evidence import SAME, Evidence
from realsim.gap.recordings.model import ALPHABETICAL, MODELS_ORDER, Target
from realsim.gap.recordings.names import is_electric, is_other, known_type, match_joints, rawness
from realsim.gap.recordings.pairing import ALIKE, BETTER, PLAIN, SLOPE, agreement, pair
from realsim.gap.recordings.proposal import Candidate
from realsim.gap.recordings.recording import Field
from realsim.gap.recordings.signals import at, smooth_derivatives
from realsim.gap.recordings.vocabulary import english

TICKS = 4096
"""Steps a turn of hobby servos' encoders (Dynamixel X, Feetech STS)."""
SLIDE = 2
"""mjJNT_SLIDE."""
MARGIN = 0.05
"""rad or m beyond its range at which a joint may still be read."""
SURELY = 0.99
"""Share of the samples within the ranges, read as turns, from which a missing unit is in doubt. Set by hand."""
IN_RANGE = 0.9
"""Share of a joint's samples within its range below which positions are in doubt. Set by hand on one of twelve
recordings (a biped's, by motors); 42 others stay right, and none is in doubt for it."""
CLEAR = 0.25
"""Difference of two hypotheses' agreement (0 to 1) from which one is preferred to what is declared."""
FEET_LEVEL = 0.02
"""m by which the feet of a standing robot may differ in height."""
CONVENTION = 0.05
"""Agreement by which another order must do better than the numbers in the columns' names."""
NO_UNIT = 3.0
"""Ratio to the positions' slope from which what is in no unit is no velocity that could be used."""
AS_NEEDED = "its values alone: they are what the motion needs"
UNLIKE = 0.2
"""Correlation with inverse dynamics below which a joint's torque is in doubt, where those of most are above 0.5."""
DYNAMICS = 600
"""Samples on which inverse dynamics is evaluated."""


def position(e: Evidence) -> None:
    """Joint positions: the field, the joints of its columns, unit, signs."""
    if e.target is not None and not e.target.joints:
        return
    found = e.candidates_for("joint_pos")
    if not found and e.target is not None and "joint_pos" not in e.chosen:
        # A field without a telling name, as wide as the robot; of known types it is known that it is something else.
        free = [c for c in e.candidates if not c.role and not known_type(e.stream(c).type) and not is_other(c.member)]
        wide = [c for c in free if (f := e.of(c)[1]).width == len(e.target.joints) and not _still(f.values)]
        alone = len(wide) == 1 and any(c.role.startswith("command") for c in e.candidates)
        if len(e.target.joints) > 1 or alone:
            found = [replace(c, why="its width alone: no name and no slope tells it") for c in wide]
    source = _best_positions(e, found)
    if source is None:
        return
    field = e.of(source)[1]
    if e.target is None:
        labels = field.labels or tuple(f"{source.member}[{i}]" for i in range(field.width))
        size = ANGLE.get(source.unit, 1.0)
        e.settle("joint_pos", source, range(field.width), labels, [f"by {source.why}"], scale=size, unit=source.unit)
        return
    columns, names, how, doubtful = _which_joints(e, source, field)
    if not columns:
        e.proposal.missing.append(
            f"joint_pos: {source.label} has {field.width} columns ({', '.join(field.labels[:6]) or 'unnamed'}), the "
            f"model {len(e.target.joints)} joints ({', '.join(e.target.joints[:6])}): no name agrees"
        )
        return
    ranges = e.target.ranges[[e.target.joints.index(n) for n in names]]
    values, sizes, offset, unit, why, odd = _in_si(e.target, names, field.values[:, columns], e.units(source, columns))
    if unit == "deg" and not source.unit and e.stream(source).type == "lerobot" and np.nanmax(np.abs(values)) < 1.75:
        odd, why = True, f"{why}; LeRobot's -100 to 100 of the range look alike: were they recorded with use_degrees?"
    doubtful |= odd
    signs, turned = _signs(ranges, names, values)
    narrow = _narrow(e.target)
    beyond = _within(ranges, names, values * signs)
    nameless = not source.role and "joint_pos" not in e.chosen
    rivals = _rivals(e, source, dict(zip(names, columns, strict=True)), found)
    e.settle("joint_pos", source, columns, names, [f"by {source.why}", how, why, *turned, beyond, narrow, rivals],
             scale=sizes * signs, offset=offset, unit=unit,
             doubtful=doubtful or nameless or bool(narrow or beyond or rivals))  # fmt: skip


def _rivals(e: Evidence, source: Candidate, taken: Mapping[str, int], found: Sequence[Candidate]) -> str:
    """Which other fields name joints that are left out, or the same ones in another topic but say something else."""
    assert e.target is not None
    time, field = e.of(source)
    rivals: list[str] = []
    for other in found:
        times, beside = e.of(other)
        named = {joint: k for k, joint in match_joints(beside.labels or beside.columns, e.target.joints).items()}
        moving = [j for j in named if j in taken and np.nanstd(field.values[:, taken[j]]) > MARGIN]
        if other.stream != source.stream and moving:
            values = at(times, beside.values[:, [named[j] for j in moving]], time)
            same = [alike(field.values[:, taken[j]], values[:, k]) for k, j in enumerate(moving)]
            rivals += [other.label] if np.median(same) < SAME else []
        elif set(named) - set(taken):
            rivals.append(other.label)
    return f"{', '.join(rivals[:4])} may be the positions, or others of them: check" if rivals else ""


def _best_positions(e: Evidence, found: Sequence[Candidate]) -> Candidate | None:
    """The field that names most of the model's joints; of equal ones that say the same, the fastest."""
    if not found:
        return None
    if e.target is None:
        widest = max(e.of(c)[1].width for c in found)
        ranked = [c for c in found if e.of(c)[1].width == widest]
    else:
        counts = {c.label: _known(e.target, e.of(c)[1]) for c in found}
        best = max(counts.values())
        ranked = [c for c in found if counts[c.label] == best]
    moved = {c.label: len(ranked) < 2 or _moved_by(e, c) for c in ranked}
    ranked.sort(
        key=lambda c: (
            c.role != "joint_pos", "position" not in english(c.member), not moved[c.label],
            e.target is not None and not match_joints(e.of(c)[1].labels, e.target.joints), rawness(c.member),
            -len(e.of(c)[0]), c.label,
        )
    )  # fmt: skip
    first = ranked[0]
    for other in ranked[1:]:
        if other.stream != first.stream and e.stream(other).type == e.stream(first).type:
            labels = e.of(first)[1].labels, e.of(other)[1].labels
            if labels[0] == labels[1] and not e.same_robot(first, other):
                place = first.stream.rsplit("/", 1)[0] or first.stream
                raise GapError(
                    "two robots are in the recording", file=e.recording.path, expected="joints of one robot",
                    found=f"{first.label} and {other.label} name the same joints and disagree",
                    hint=f"choose one: realsim log {quote(str(e.recording.path))} --only {place}",
                )  # fmt: skip
    return first


def _moved_by(e: Evidence, source: Candidate) -> bool:
    """Whether a field of its stream is the slope of this one: what `q_current` is, a name does not tell."""
    time, field = e.of(source)
    speeds = [e.of(c)[1] for c in e.candidates if c.role == "joint_vel" and c.stream == source.stream]
    for speed in (s.values for s in speeds if s.width == field.width):
        found = (speed_factor(*travelled(time, field.values[:, k], speed[:, k])).corr for k in range(field.width))
        if (moving := [abs(c) for c in found if c]) and np.median(moving) > SLOPE:
            return True
    return False


def _known(target: Target, field: Field) -> int:
    """How many joints of the model a field can be: by its labels, else by an order of that width."""
    return max(len(match_joints(field.labels, target.joints)), *map(len, target.orders(field.width).values()), 0)


def _which_joints(e: Evidence, source: Candidate, field: Field) -> tuple[list[int], list[str], str, bool]:
    """(columns, their joints, why, whether that is in doubt)."""
    assert e.target is not None
    at_ = match_joints(field.labels, e.target.joints)
    if at_:
        left = [label for i, label in enumerate(field.labels) if i not in at_]
        how = "its columns name the model's joints" + (f"; not in the model: {', '.join(left[:6])}" if left else "")
        inverse = {j: i for i, j in at_.items()}
        names = [j for j in e.target.joints if j in inverse]
        moving = [i for i in range(field.width) if i not in at_ and not _still(field.values[:, [i]])]
        return [inverse[j] for j in names], names, how, bool(moving) and len(names) < len(e.target.joints)
    if len(e.target.joints) == 1 and field.width == 1:
        return [0], list(e.target.joints), "one column, one joint", False
    orders = e.target.orders(field.width)
    if not orders:
        return [], [], "", False
    commanded = _command_columns(e, source, field)
    scores = {name: _order_score(e, field, order, source) for name, order in orders.items()}
    for name, order in orders.items() if commanded else ():
        known = dict(sorted((commanded[k], joint) for k, joint in order.items())) in orders.values()
        scores[name] = (scores[name][0] + known) / 2, f"{scores[name][1]}, commands in a known order {known:d}"
    listed = source.label in {c.label for c in e.chosen.values() if c is not None} and "," in source.member
    usual = MODELS_ORDER if (listed or _numbered(field)) and MODELS_ORDER in scores else ""
    lead = {n: scores[n][0] + (CONVENTION if n == usual else 0.0) for n in scores}
    ranked = sorted(lead, key=lambda n: -lead[n])
    best = ranked[0]
    text = f"unnamed columns: {best}, agreement {scores[best][0]:.2f} ({scores[best][1]})"
    # Numbers count the columns of any controller's order; only a sorted one is likely to come with names.
    own = lead if best != usual else {n: lead[n] if n == ALPHABETICAL else scores[n][0] + CONVENTION for n in lead}
    rivals = [] if listed else [n for n in ranked[1:] if own[n] > own[best] - 0.02]
    if rivals:
        text += f"; as likely by the data: {', '.join(rivals)}: check, or name the columns"
    elif len(ranked) > 1:
        text += f"; next {ranked[1]} {scores[ranked[1]][0]:.2f}"
    moving = [c for c in range(field.width) if c not in orders[best] and not _still(field.values[:, c])]
    if moving:
        text += f"; {len(moving)} more columns that move are left out: is it another robot's model?"
    strange = bool(field.labels) and not listed and not _numbered(field)
    if strange:
        text += f"; the columns' names ({', '.join(field.labels[:4])}) are none of the model's: check, or use --use"
    e.unordered = bool(rivals or moving or strange)
    return list(orders[best]), list(orders[best].values()), text, e.unordered


def _numbered(field: Field) -> bool:
    """Whether numbers count the columns of a table: q1, q2 are the first and the second joint."""
    numbers = [re.findall(r"\d+", c) for c in field.columns]
    if field.width < 2 or len(numbers) != field.width or len({len(n) for n in numbers}) > 1:
        return False
    counted = [[int(n) for n in place] for place in zip(*numbers, strict=True) if len(set(place)) > 1]
    return len(counted) == 1 and bool((np.diff(counted[0]) == 1).all())


def _command_columns(e: Evidence, source: Candidate, field: Field) -> tuple[int, ...]:
    """Of each column the command beside it that it follows, where those are plainly in another order; else nothing."""
    for c in e.candidates:
        command = e.of(c)[1] if c.stream == source.stream and c.role in ("command", "command.position") else None
        if command is not None and command.width == field.width > 1:
            found = pair([agreement(e.of(c)[0], command.values, field.values)], range(field.width))
            if found.gain > PLAIN and found.margin > ALIKE:
                return found.columns
    return ()


def _still(values: F64) -> bool:
    """Whether columns hold one value each, as the entry of a motor that a robot does not have."""
    spread = np.nan_to_num(values, nan=-np.inf).max(axis=0) - np.nan_to_num(values, nan=np.inf).min(axis=0)
    return bool((spread < 1e-6).all())


def _order_score(e: Evidence, field: Field, order: Mapping[int, str], source: Candidate) -> tuple[float, str]:
    """(agreement 0 to 1 of an order of unnamed columns with the model, what it consists of)."""
    assert e.target is not None
    columns, names = list(order), list(order.values())
    ranges = e.target.ranges[[e.target.joints.index(n) for n in names]]
    values, *_ = _in_si(e.target, names, field.values[:, columns], e.units(source, columns))
    parts = {"in range": _share_within(ranges, values)}
    level = _feet_level(e, names, values)
    if level is not None:
        parts["feet level"] = level
    torque = next((c for c in e.candidates if c.role == "joint_torque" and c.stream == source.stream), None)
    if torque is not None and not e.target.floating and e.of(torque)[1].width == field.width:
        need = _needed(e, tuple(names), values)
        if need is not None:
            rows, tau = need
            logged = e.of(torque)[1].values[rows][:, columns]
            found = [abs(alike(logged[:, k], tau[:, k])) for k in range(len(names))]
            parts["torques"] = float(np.median(found))
    rest = [_still(field.values[:, c]) for c in range(field.width) if c not in order]
    idle = float(np.mean(rest)) if rest else 1.0  # an order that leaves out motors which move is not the robot's
    text = ", ".join(f"{k} {v:.2f}" for k, v in (parts | ({"the rest idle": idle} if rest else {})).items())
    return float(np.mean(list(parts.values()))) * idle, text


def _feet_level(e: Evidence, order: Sequence[str], values: F64) -> float | None:
    """How level the feet of a floating robot are in its calmest postures, 0 to 1; None without gravity in the log."""
    assert e.target is not None
    acc = next((c for c in e.candidates if c.role == "imu_acc"), None)
    if len(e.target.feet) < 3 or acc is None:
        return None
    time, _ = e.of(next(c for c in e.candidates if e.of(c)[1].values.shape[0] == len(values)))
    t, field = e.of(acc)
    up = at(t, field.values[:, :3], time)
    size = np.linalg.norm(up, axis=1)
    calm = np.flatnonzero(np.isfinite(size) & (np.abs(size / np.nanmedian(size) - 1) < 0.05))[
        :: max(1, len(size) // 60)
    ]
    if len(calm) < 5:
        return None
    heights = e.target.foot_heights(tuple(order), values[calm], up[calm] / size[calm, None])
    return float(np.exp(-np.median(np.ptp(heights, axis=1)) / (4 * FEET_LEVEL)))


# ---------------------------------------------------------------- units and signs of positions


def _in_si(
    target: Target, names: Sequence[str], values: F64, declared: Sequence[str]
) -> tuple[F64, F64, F64, str, str, bool]:
    """(values (T, K) in rad and m, (K,) factors, (K,) offsets, unit, why, whether in doubt): hinges, then slides."""
    ranges = target.ranges[[target.joints.index(n) for n in names]]
    size, offset, found, reasons, doubtful = np.ones(len(names)), np.zeros(len(names)), [], [], False
    for given, units, kind in kinds_of(target, names, declared, ANGLE, LENGTH):
        unit, offset[kind], why = _unit(ranges[kind], values[:, kind], given, units)
        size[kind] = units.get(unit, 2 * np.pi / TICKS)
        usual, free = next(iter(units)), not np.isfinite(ranges[kind]).all(axis=1).any()
        turned = _share_within(ranges[kind], 2 * np.pi * values[:, kind])
        if unit == "rad" and given not in units and turned > SURELY:
            doubtful = True  # joints without ranges are within them in any unit
            why += "; in turns they may be, too: give the unit in the column's name, q1 [rad]"
        # How many steps a turn has, where zero is, and what unit a size alone tells, is nowhere in the data.
        doubtful |= unit == "ticks" or ((free or units is LENGTH) and unit not in (given, usual))
        found.append(unit)
        reasons.append(f"slides {why}" if units is LENGTH else why)
    return (values - offset) * size, size, offset, ", ".join(dict.fromkeys(found)), "; ".join(reasons), doubtful


def kinds_of(
    target: Target | None, names: Sequence[str], declared: Sequence[str], *units: Mapping[str, float]
) -> list[tuple[str, Mapping[str, float], list[int]]]:
    """(declared unit, units of that kind, columns) of joints of one kind and unit: hinges, then slides."""
    slide = [target is not None and target.model.joint(n).type[0] == SLIDE for n in names]
    kinds: dict[tuple[bool, str], list[int]] = {}
    for k, kind in sorted(enumerate(zip(slide, declared, strict=True)), key=lambda item: item[1][0]):
        kinds.setdefault(kind, []).append(k)
    return [(given, units[int(is_slide)], columns) for (is_slide, given), columns in kinds.items()]


def _unit(ranges: F64, values: F64, declared: str, units: Mapping[str, float]) -> tuple[str, float, str]:
    """(unit, offset in it, why): what puts the joints into their ranges; what is declared unless plainly wrong."""
    largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    whole = values[np.isfinite(values)]
    steps = bool((whole == np.round(whole)).all()) and largest > 400 and "rad" in units
    in_steps = f"whole numbers up to {largest:.0f}: encoder steps, {TICKS} a turn, zero in the middle"
    if not np.isfinite(ranges).all(axis=1).any():
        if declared in units:
            return declared, 0.0, f"in {declared}, as is declared"
        if steps:
            return "ticks", TICKS / 2, in_steps
        unit = next(iter(units)) if largest < 4 * np.pi else "deg" if "deg" in units else "mm"
        return unit, 0.0, f"largest value {largest:.3g}: taken as {unit} (the model's joints have no ranges to test)"
    read = {u: values * f for u, f in units.items() if u == declared or u not in ("mrad", "mdeg")}
    if steps:
        read["ticks"] = (values - TICKS / 2) * 2 * np.pi / TICKS
    shares = {u: _share_within(ranges, v) for u, v in read.items()}
    # A unit that shrinks everything to nothing is in range too: of equal ones the one that fills the range wins.
    score = {u: shares[u] + 0.3 * _filling(ranges, v) for u, v in read.items()}
    usual = declared if declared in score else next(iter(units))
    best = max(score, key=lambda u: score[u])
    fits = not declared and not steps and shares[usual] > SURELY  # small motion in rad fills more as turns
    unit = best if score[best] > score[usual] + CLEAR and not fits else usual
    if unit == "ticks":
        return unit, TICKS / 2, in_steps
    why = f"in {unit}: {shares[unit]:.0%} of the samples within the joints' ranges"
    if unit != usual:
        why += f" ({usual}, as {'declared' if declared else 'usual'}, {shares[usual]:.0%})"
    return unit, 0.0, why


def _share_within(ranges: F64, values: F64) -> float:
    inside = (values >= ranges[:, 0] - MARGIN) & (values <= ranges[:, 1] + MARGIN)
    return float(inside[np.isfinite(values)].mean()) if np.isfinite(values).any() else 0.0


def _filling(ranges: F64, values: F64) -> float:
    """How much of its range the widest moving joint uses, 0 to 1."""
    width = np.ptp(ranges, axis=1)
    used = np.nanmax(np.abs(values), axis=0) / np.maximum(np.max(np.abs(ranges), axis=1), 1e-9)
    used = used[np.isfinite(width)]
    return float(np.clip(used.max(), 0, 1)) if len(used) else 0.0


def _signs(ranges: F64, names: Sequence[str], values: F64) -> tuple[F64, list[str]]:
    """((K,) 1 or -1, what was turned): joints that lie in their range only the other way round."""
    signs, notes = np.ones(len(names)), []
    for k, name in enumerate(names):
        here, there = (_share_within(ranges[[k]], s * values[:, [k]]) for s in (1.0, -1.0))
        if here < 0.5 and there > 0.95:
            signs[k] = -1.0
            notes.append(
                f"{name} is turned: {here:.0%} of its samples within its range, {there:.0%} with the other sign"
            )
    return signs, notes


def _within(ranges: F64, names: Sequence[str], values: F64) -> str:
    """The joint that lies most outside its range."""
    share, k = min((_share_within(ranges[[k]], values[:, [k]]), k) for k in range(len(names)))
    if share >= IN_RANGE:
        return ""
    return f"{names[k]} is outside its range in {1 - share:.0%} of the samples: another order, unit, zero or model?"


def _narrow(target: Target) -> str:
    """Ranges in radians that were read as degrees, MJCF's default: no robot turns all joints by less than 13 deg."""
    hinges = [r for n, r in zip(target.joints, target.ranges, strict=True) if target.model.joint(n).type[0] != SLIDE]
    widths = [float(np.ptp(r)) for r in hinges if np.isfinite(r).all()]
    if not widths or max(widths) >= np.radians(4 * np.pi):
        return ""
    most = np.degrees(max(widths))
    return f'the model\'s joints turn by {most:.1f} deg at most: is <compiler angle="radian"/> missing in it?'


# ---------------------------------------------------------------- velocities and torques


def columns_for(e: Evidence, source: Candidate) -> tuple[list[int], list[str], str]:
    """Columns of a field for the joints that are settled, by label, by the order of its stream, else one by one."""
    joints = list(e.proposal.joints)
    field = e.of(source)[1]
    home = e.proposal.assignments["joint_pos"].source
    at_ = match_joints(field.labels, joints)
    if len(at_) < len(joints) and source.stream == home.stream and field.width == e.of(home)[1].width:
        return list(e.proposal.assignments["joint_pos"].columns), joints, ""  # side by side in one message
    if at_:
        inverse = {j: i for i, j in at_.items()}
        names = [j for j in joints if j in inverse]
        return [inverse[j] for j in names], names, "its columns name the joints"
    if field.width == e.of(home)[1].width:
        return list(e.proposal.assignments["joint_pos"].columns), joints, f"unnamed columns: as in {home.label}"
    if field.width == len(joints):
        return list(range(len(joints))), joints, "unnamed columns: in the order of the model's joints"
    return [], [], ""


def velocity(e: Evidence) -> None:
    """Joint velocities, by the slope of the positions."""
    if "joint_pos" not in e.proposal.assignments:
        return
    for source in e.ranked(_with_samples(e, e.candidates_for("joint_vel"))):
        columns, names, how = columns_for(e, source)
        if len(columns) == len(e.proposal.joints) and _velocity(e, source, columns, names, [f"by {source.why}", how]):
            return


def _velocity(e: Evidence, source: Candidate, columns: list[int], names: list[str], evidence: list[str]) -> bool:
    """Settle a field as the joints' velocity; False where it is not the slope of their positions."""
    time, field = e.of(source)
    place = e.beside("joint_pos", time)
    assert place is not None
    found = [speed_factor(*travelled(time, place[:, k], field.values[:, c])) for k, c in enumerate(columns)]
    kinds, moving = kinds_of(e.target, names, e.units(source, columns), TURNING, MOVING), [f for f in found if f.corr]
    scale, units, texts = np.ones(len(columns)), list[str](), list[str]()
    if moving and np.median([abs(f.corr) for f in moving]) < 0.6 and "joint_vel" not in e.chosen:
        corr = np.median([abs(f.corr) for f in moving])
        e.warn(f"{source.label} is no velocity of the joints: correlation {corr:.2f} with what their positions travel")
        return False
    for given, sizes, kind in kinds:
        usual, known = given if given in sizes else next(iter(sizes)), [found[k] for k in kind if found[k].corr]
        units.append(usual)
        scale[kind] = sizes[usual]
        if not known:
            continue
        ratio = float(np.median([abs(f.ratio) for f in known]))
        corr = float(np.median([abs(f.corr) for f in known]))
        unit, values = nearest_unit(ratio, sizes), field.values[:, [columns[k] for k in kind]]
        close = abs(ratio * sizes[unit] - 1) < NEAR
        steps = not close and corr > SLOPE and bool((values[np.isfinite(values)] % 1 == 0).all())
        far = max(ratio * sizes[usual], 1 / max(ratio * sizes[usual], 1e-9)) > NO_UNIT
        if far and not (close or steps or "joint_vel" in e.chosen):
            e.warn(
                f"{source.label} is {ratio:.3g} times the positions' slope, no unit: it is left out; give its unit in "
                f"the columns' names, or keep it: --use joint_vel={source.label}"
            )
            return False
        text = f"its integral against the positions: correlation {corr:.3f}, factor {ratio:.4g}"
        text += f" -> {unit}" if close else f" -> steps of {1 / ratio:.3g} rad/s" if steps else f", left in {usual}"
        negated = all(f.ratio < 0 for f in known)
        texts.append(text + (", and negated" if negated else ""))
        units[-1] = unit if close else "steps" if steps else usual
        scale[kind] = (1 / ratio if steps else sizes[units[-1]]) * (-1.0 if negated else 1.0)
    texts = texts or ["no joint moves: nothing tests it"]
    unit = ", ".join(dict.fromkeys(units))
    e.settle("joint_vel", source, columns, names, [*evidence, *texts], scale=scale, unit=unit, doubtful=not moving)
    return True


def torque(e: Evidence, *, unnamed: bool = False) -> None:
    """Joint torques, by inverse dynamics (a fixed base) or only by name; `unnamed` ones by inverse dynamics alone."""
    if "joint_pos" not in e.proposal.assignments or "joint_torque" in e.proposal.assignments:
        return
    found = e.ranked(_with_samples(e, e.candidates_for("joint_torque"))) or (_as_needed(e) if unnamed else [])
    for source in sorted(found, key=lambda c: is_electric(c.member)):
        columns, names, how = columns_for(e, source)
        if len(columns) < len(e.proposal.joints):
            continue
        if np.nanstd(e.of(source)[1].values[:, columns]) > 0:
            break
        e.warn(f"{source.label} never changes: it is left out")
    else:
        return
    time, field = e.of(source)
    current = is_electric(source.member)
    evidence = [f"by {source.why}", how]
    if current:
        evidence.append("a current, or a load without a unit: its factor to N m is not known")
    place, need = e.beside("joint_pos", time), None
    if e.target is not None and not e.target.floating and place is not None:
        need = _needed(e, tuple(names), place, time)
    turned = np.sign(
        e.proposal.assignments["joint_pos"].scale
    )  # who counts an angle the other way does so with its torque
    unit = source.unit or "N m"
    scale, text, doubtful = TORQUE.get(unit, 1.0), "nothing here tests its size", True
    if need is not None:
        rows, tau = need
        logged = field.values[rows][:, columns] * turned
        whose = np.array([[alike(column, needed) for column in logged.T] for needed in tau.T])
        corrs = np.diagonal(whose)
        factors = [f for k in range(len(names)) if np.isfinite(f := factor(logged[:, k], tau[:, k]))]
        ratio = float(np.median(factors)) if factors else np.nan
        scale, unit, text, doubtful = _torque_unit(ratio, corrs, source.unit, current)
        doubtful |= unit != (source.unit or "N m") and e.proposal.assignments["joint_pos"].doubtful
        odd = [n for n, c in zip(names, corrs * np.sign(scale), strict=True) if c < UNLIKE]
        if np.median(np.abs(corrs)) > 0.5 and odd:
            text, doubtful = f"{text}; that of {', '.join(odd[:4])} is not what its motion needs", True
        if pair([np.maximum(whose * np.sign(scale), 0.0)], range(len(names))).gain > BETTER:
            text, doubtful = f"{text}; in another order they agree better", True
    doubtful |= source.why == AS_NEEDED
    e.settle(
        "joint_torque", source, columns, names, [*evidence, text], scale=scale * turned, unit=unit, doubtful=doubtful
    )
    e.proposal.torque_kind = "current_times_constant" if current else "measured"


def _as_needed(e: Evidence) -> list[Candidate]:
    """Fields that no name tells, and that are what the motion needs by inverse dynamics."""
    joints, found = list(e.proposal.joints), []
    if e.target is None or e.target.floating or "joint_torque" in e.chosen:
        return []
    for c in (c for c in e.candidates if not c.role and not known_type(e.stream(c).type)):
        columns, names, _ = columns_for(e, c)
        time, field = e.of(c)
        place = e.beside("joint_pos", time)
        if names != joints or place is None or (need := _needed(e, tuple(names), place, time)) is None:
            continue
        corrs = [abs(alike(field.values[need[0], column], need[1][:, k])) for k, column in enumerate(columns)]
        if np.median(corrs) > SAME:
            found.append(replace(c, role="joint_torque", why=AS_NEEDED))
    return found


def _torque_unit(ratio: float, corrs: F64, declared: str, current: bool) -> tuple[float, str, str, bool]:
    """(factor to N m with sign, unit, why, whether in doubt) from logged = ratio x inverse dynamics."""
    corr = float(np.median(np.abs(corrs)))
    text = f"against the model's inverse dynamics: correlation {corr:.2f}, factor {ratio:.3g}"
    if corr < 0.5:
        unit = declared or "N m"
        return TORQUE.get(unit, 1.0), unit, f"{text}: tells nothing; {unit} is assumed", True
    sign = -1.0 if np.median(corrs) < -0.5 else 1.0
    if current:  # whose gain the diagnosis leaves open
        return sign / abs(ratio), declared or "steps", f"{text}: one is taken as {sign / abs(ratio):.3g} N m", True
    unit = nearest_unit(ratio, TORQUE)
    if declared in TORQUE and 0.3 < abs(ratio) * TORQUE[declared] < 3:
        unit = declared
    fits = 0.4 < abs(ratio) * TORQUE[unit] < 2.5
    return sign * TORQUE[unit], unit, f"{text} -> {unit}{', negated' if sign < 0 else ''}", not fits


def _needed(e: Evidence, names: tuple[str, ...], place: F64, time: F64 | None = None) -> tuple[Any, F64] | None:
    """(rows, (rows, K) N m by inverse dynamics) where joints move; None where nothing does."""
    assert e.target is not None
    if time is None:
        time = next(t.time for t in e.times.values() if len(t.time) == len(place))
    good = np.isfinite(place).all(axis=1)
    if good.sum() < 50 or np.nanstd(place) < 1e-3:
        return None
    filled = np.stack([np.interp(time, time[good], place[good, k]) for k in range(place.shape[1])], axis=1)
    q, qd, qdd = smooth_derivatives(time, filled)
    rows = np.flatnonzero(good)[:: max(1, int(good.sum()) // DYNAMICS)]
    return rows, e.target.inverse(names, q[rows], qd[rows], qdd[rows])


def _with_samples(e: Evidence, found: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in found if np.isfinite(e.of(c)[1].values).any()]
