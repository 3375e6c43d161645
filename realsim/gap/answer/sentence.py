"""The verdict as one sentence that a person can act on."""

from collections.abc import Mapping, Sequence
from typing import Any

from realsim.gap.answer.check import Check
from realsim.gap.answer.diagnosis import NOT_DETERMINED
from realsim.gap.answer.verdict import Judgement
from realsim.gap.case.case import Case
from realsim.gap.case.split import replicates
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.base import When
from realsim.gap.effects.lookup import places_of
from realsim.gap.verdicts import GapVerdict

Cause = dict[str, Any]
SIGNALS = {
    "joint_pos": "joint position",
    "joint_vel": "joint velocity",
    "joint_torque": "joint torque",
    "base_pos": "base position",
    "base_rot": "base orientation",
    "imu_gyro": "gyroscope",
    "imu_acc": "accelerometer",
}
_SPELLED = {"ratio": "times", "kg m^2": "kg m²", "m/s^2": "m/s²"}
CUT_SHORT = "The search was cut short before all causes were looked at."
_MOST_ALTERNATIVES = 3
_MOST_RECORDINGS = 2
"""More than two recordings at once nobody makes."""


def sentence(
    judgement: Judgement,
    causes: Sequence[Cause],
    equivalent: Sequence[Sequence[Cause]],
    checked: Check,
    where: Sequence[dict[str, Any]],
    looks_like: Sequence[dict[str, Any]],
    case: Case,
    lead: Cause | None = None,
    unsearched: bool = False,
) -> str:
    """What is wrong, how sure that is, what it brings; or why that is unknown, and what to record. `unsearched`: no
    cause was looked at, so none is ruled out."""
    verdict = judgement.verdict
    nearest = f" The nearest cause is {phrase(lead)}" if lead else ""
    if verdict is GapVerdict.NO_GAP:
        return (
            "No gap that these runs can show: what differs is within sensor noise and the small deviations that every "
            "robot has." + (f"{nearest}: robots of one kind differ by as much." if lead else "")
        )
    if not causes and unsearched:
        return f"A gap{_mostly(where)}: {errors_of(checked, after=False)}{_looks(looks_like)}."
    if not causes:
        return (
            f"No cause that this library knows{_mostly(where)}: {errors_of(checked, after=False)}{_looks(looks_like)}; "
            f"record {_next_for_unknown(where, case)}." + (f"{nearest}; it does not explain the runs." if lead else "")
        )
    pronoun = "it" if len(causes) == 1 else "them"
    gain = gone(checked)
    if verdict is GapVerdict.AMBIGUOUS:
        stays = f" What stays: {errors_of(checked)}." if judgement.stays else ""
        tells = _what_tells([causes, *equivalent], case)
        return f"{_either(causes, equivalent)} {gain}; to tell them apart, record {tells}.{stays}"
    corrected = "" if all(clause(c).startswith("lacks") for c in causes) else " corrected"
    text = f"Your model {' and '.join(clause(c) for c in causes)}; with {pronoun}{corrected}, {gain}"
    if verdict is GapVerdict.PARTLY_EXPLAINED:
        stays = f"A part stays: {errors_of(checked)}{_looks(looks_like)}" if judgement.stays else ""
        doubts = f"Not sure: {'; '.join(judgement.doubts)}" if judgement.doubts else ""
        return f"{text}. {'. '.join(filter(None, (doubts, stays)))}; record {_next_for_unknown(where, case)}."
    if verdict is GapVerdict.UNEXPLAINED:
        ends = f", with {', '.join(judgement.at_an_end)} as far as this library goes" if judgement.at_an_end else ""
        near = "; ".join(phrase(c) for c in causes)
        return (
            f"Not explained{_mostly(where)}. The nearest is {near}{ends}; with {pronoun}, {gain}: it may only imitate "
            f"the cause. What stays: {errors_of(checked)}{_looks(looks_like)}; record {_next_for_unknown(where, case)}."
        )
    return f"{text}."


def gone(checked: Check) -> str:
    """99.9 % of the error is gone (on a run that was kept back)."""
    if not checked.replay_holds and checked.horizons is not None and checked.holds:
        part, windows = share(checked.horizons.fraction), checked.horizons.windows
        return f"{part} of the squared error of predictions over 0.1 to 0.5 s is gone (in {windows} windows kept back)"
    if checked.ci90[0] <= 0 and checked.holds:
        low, high = checked.beside90 or checked.ci90
        return (
            f"{share(low)} to {share(high)} of what everyday deviations leave is gone {_runs(checked)}, and "
            f"{share(checked.fraction)} of all"
        )
    if not checked.holds:
        return f"the squared error does not surely shrink {_runs(checked)} (by {removed(checked)})"
    return f"{share(checked.fraction)} of the squared error is gone {_runs(checked)}"


def clause(cause: Cause) -> str:
    """What the model lacks, has too much of or is to be changed by, without intervals: `lacks 0.21 kg on forearm`."""
    effect, parameters = EFFECTS[cause["effect"]], cause["parameters"]
    words, passing = effect.words, effect.law.passing
    names = ", ".join(_plain(n) for n in places_of(cause))
    place = f" {'on' if cause.get('bodies') else 'at'} {names}" if names else ""
    if words.ratio_of:
        parameters = {n: _percent(p, words.ratio_of) for n, p in parameters.items()}
    bare = {n: {k: v for k, v in p.items() if k != "ci90"} for n, p in parameters.items()}
    name, first = next(iter(bare.items()))
    thing, where = words.sort == "thing", _at(parameters)
    sized = {name: first} if thing else bare
    less = first["value"] < 0 and (thing or (words.sort == "amount" and len(bare) == 1))
    size = _size(sized, passing, -1 if less else 1)
    if first["unit"] == "kg" and thing:
        size = "a mass" if size == NOT_DETERMINED else size
        return f"{'has' if less else 'lacks'} {size}{' too much' if less else ''}{place}{where}"
    if word := words.comparatives[0 if first["value"] < 0 else 1]:
        return f"should be {_size(sized, passing, -1 if first['value'] < 0 else 1)} {word}{place}"
    if first["unit"] == "ratio" and len(bare) == 1:
        return f"needs {size} its {effect.title}{place}"
    if words.sort == "direction" and first["unit"] == "m":
        return f"needs its {effect.title} changed by {size}{place}"
    if less:
        return f"has {size} too much {effect.title}{place}"
    return f"lacks {'a ' if thing else ''}{effect.title} of {size}{place}"


def errors_of(checked: Check, after: bool = True) -> str:
    """Joint position 14 mrad rms of a motion of 0.4 rad (51 mrad before); signals within their floor are left out."""
    size = "rms_after" if after else "rms_before"
    above = {name: s for name, s in checked.signals.items() if s[size] > s["floor"]} or checked.signals
    found = []
    for name, s in above.items():
        before = f" ({amount(s['rms_before'], s['unit'])} before)" if after else ""
        motion = amount(s["motion"], s["unit"])
        found.append(f"{SIGNALS.get(name, name)} {amount(s[size], s['unit'])} rms of a motion of {motion} rms{before}")
    return ", ".join(found)


def amount(value: float, unit: str) -> str:
    """14 mrad, 0.41 rad, 3.1 mm."""
    small = {"rad": "mrad", "m": "mm", "rad/s": "mrad/s", "m/s": "mm/s"}
    if unit in small and abs(value) < 0.1:
        value, unit = 1000 * value, small[unit]
    return f"{number(float(f'{value:.2g}'))} {_SPELLED.get(unit, unit)}"


def advice(
    judgement: Judgement,
    causes: Sequence[Cause],
    equivalent: Sequence[Sequence[Cause]],
    where: Sequence[dict[str, Any]],
    case: Case,
    lead: Cause | None = None,
) -> str:
    """What to do about a verdict: one thing."""
    verdict = judgement.verdict
    if verdict is GapVerdict.NO_GAP and lead:
        return f"if it matters, record {_what_tells([[lead]], case)}: the nearest cause is {phrase(lead)}"
    if verdict is GapVerdict.NO_GAP:
        return "change nothing in the model; record livelier runs to look closer"
    if verdict is GapVerdict.IDENTIFIED:
        return "simulate with the patched model.xml, and check it on a new run"
    if verdict is GapVerdict.AMBIGUOUS:
        return f"to tell them apart, record {_what_tells([causes, *equivalent], case)}"
    return f"record {_next_for_unknown(where, case)}"


def _looks(found: Sequence[dict[str, Any]]) -> str:
    """What a rest looks like: `; at left knee it looks friction-like`."""
    by_what: dict[str, list[str]] = {}
    for entry in found:
        by_what.setdefault(entry["what"], []).append(_plain(entry["joint"]))
    said = " and ".join(f"{what} ({', '.join(joints)})" for what, joints in by_what.items())
    return f"; it looks {said}" if said else ""


def _either(causes: Sequence[Cause], equivalent: Sequence[Sequence[Cause]]) -> str:
    """What the sets share, once, and what they differ in."""
    alternatives = [list(s) for s in (causes, *equivalent[:_MOST_ALTERNATIVES])]
    shared = [c for c in causes if all(any(_same(c, other) for other in s) for s in alternatives)]
    rest = [[c for c in s if not any(_same(c, known) for known in shared)] for s in alternatives]
    if not all(rest):
        shared, rest = [], alternatives
    sure = f"{'; '.join(phrase(c) for c in shared)}. Beside that, cannot" if shared else "Cannot"
    either = ", or ".join(" with ".join(phrase(c) for c in s) for s in rest)
    return f"{sure} tell: {either}; each explains these runs as well. With the first,"


def _same(a: Cause, b: Cause) -> bool:
    return a["effect"] == b["effect"] and places_of(a) == places_of(b)


def phrase(cause: Cause) -> str:
    """left knee: Coulomb friction 1.9 N m [1.6, 2.2] is missing."""
    effect, parameters = EFFECTS[cause["effect"]], cause["parameters"]
    words, passing = effect.words, effect.law.passing
    names = ", ".join(_plain(n) for n in places_of(cause))
    place = f"{names}: " if names else ""
    if words.ratio_of:
        parameters = {n: _percent(p, words.ratio_of) for n, p in parameters.items()}
    name, first = next(iter(parameters.items()))
    negative = first["value"] < 0
    thing = words.sort == "thing"
    where = _at(parameters) if thing else ""
    sized = {name: first} if where else parameters
    if word := words.comparatives[0 if negative else 1]:
        what = names if thing else f"{place}{effect.title}"
        return f"{what} is {_size(sized, passing, -1 if negative else 1)} {word} than in the model{where}"
    size = _size(sized, passing)
    if thing:
        return f"{place}a {effect.title} of {size}{where} is missing"
    if first["unit"] == "ratio" and len(parameters) == 1:
        return f"{place}{effect.title} is {size} the model's"
    if negative and len(parameters) == 1 and words.sort == "amount":
        return f"{place}{effect.title} is {_size(parameters, passing, -1)} too large in the model"
    notes = [p["note"] for p in parameters.values() if p.get("note") not in (None, NOT_DETERMINED)]
    note = f" ({'; '.join(notes)})" if notes else ""
    if words.sort == "direction" and first["unit"] == "m":
        return f"{place}{effect.title} is to be changed by {size} in the model{note}"
    return f"{place}{effect.title} {size} is missing{note}"


def _percent(parameter: dict[str, Any], of: str) -> dict[str, Any]:
    """A share in percent: beside no friction of this kind, "0.2 times" says nothing."""
    low, high = parameter["ci90"]
    return parameter | {
        "value": 100 * parameter["value"],
        "ci90": [100 * low, 100 * high],
        "unit": f"% of {of}",
    }


def removed(checked: Check) -> str:
    """83 % [74, 88]; with a decimal where whole numbers would say all or nothing."""
    low, high = checked.ci90
    values = (checked.fraction, low, high)
    digits = 1 if any(0.985 < v < 1 for v in values) else 0
    return f"{_share(checked.fraction, digits)} % [{_share(low, digits)}, {_share(high, digits)}]"


def share(value: float) -> str:
    """A share in percent; what is nearly all or nothing keeps a decimal."""
    return f"{_share(value, 1 if 0.985 < value < 1 or 0 < value < 0.0095 else 0)} %"


def _share(value: float, digits: int) -> str:
    return ">99.9" if 0.9995 <= value < 1 else f"{100 * value:z.{digits}f}".replace("-", "−")


def _size(parameters: dict[str, dict[str, Any]], passing: Mapping[str, When], sign: int = 1) -> str:
    """1.9 N m [1.6, 2.2]; several parameters by name, of a vector those that matter; when, if not always."""
    times = "".join(
        f" {when.text.format(number(p['value']))} {p['unit']}"
        for n, when in passing.items()
        if when.text and (p := parameters.get(n)) and when.least <= p["value"] <= when.most
    )
    sizes = {n: p for n, p in parameters.items() if n not in passing}
    listed = []
    for name, p in [item for item in sizes.items() if not _minor(*item, sizes)][:5]:
        label = f"{name.replace('_', ' ')} " if len(sizes) > 1 or _component(name) or name in ("roll", "pitch") else ""
        listed.append(label + _interval(p, sign))
    return ", ".join(listed) + times


def _component(name: str) -> bool:
    """Whether it is one of a vector's: z, fx, gyro_x."""
    return name.rpartition("_")[2] in ("x", "y", "z", "fx", "fy", "fz")


def _minor(name: str, parameter: dict[str, Any], among: dict[str, dict[str, Any]]) -> bool:
    """A component of a vector that is under a tenth of the largest one."""
    if not _component(name):
        return False
    vector = [abs(p["value"]) for n, p in among.items() if _component(n) and n[:-1] == name[:-1]]
    return bool(abs(parameter["value"]) < 0.1 * max(vector))


def _at(parameters: dict[str, dict[str, Any]]) -> str:
    """At (0.02, 0, 0.1) m."""
    if not all(axis in parameters for axis in "xyz"):
        return ""
    known = [p["value"] if (p := parameters[axis]).get("note") != NOT_DETERMINED else None for axis in "xyz"]
    return f" at ({', '.join(NOT_DETERMINED if v is None else number(round(v, 3)) for v in known)}) m"


def _interval(parameter: dict[str, Any], sign: int) -> str:
    """1.9 N m [1.6, 2.2], or without the interval where there is none."""
    if parameter.get("note") == NOT_DETERMINED:
        return NOT_DETERMINED
    unit, factor = parameter["unit"], float(sign)
    if unit == "s" and abs(parameter["value"]) < 0.5:
        unit, factor = "ms", 1000.0 * sign
    text = f"{number(factor * parameter['value'])} {_SPELLED.get(unit, unit)}"
    if "ci90" not in parameter:
        return text
    low, high = sorted(factor * v for v in parameter["ci90"])
    return f"{text} [{number(low)}, {number(high)}]"


def number(value: float) -> str:
    """Three digits, with a real minus."""
    value += 0.0  # no minus before a zero
    text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return text.replace("-", "−") if "e" not in text else text


def _runs(checked: Check) -> str:
    if checked.kind == "left_out_in_turn":
        return "(on the fitted runs, each left out in turn)"
    if not checked.unseen:
        return "(on the run that it was fitted to: no other was left)"
    return f"(on {'a run that was' if len(checked.runs) == 1 else 'runs that were'} kept back)"


def _plain(name: str) -> str:
    return name.removesuffix("_joint").removesuffix("_link").replace("_", " ")


def _mostly(where: Sequence[dict[str, Any]]) -> str:
    """Most of it in ..., from the largest entry of `where`."""
    if not where:
        return ""
    first = where[0]
    name = first.get("joint")
    return f", most of it in {_plain(name) if name else first['signal'].replace('_', ' ')} ({first['phase']})"


def _what_tells(sets: Sequence[Sequence[Cause]], case: Case) -> str:
    """What to record: what distinguishes each effect from its rivals, where all name that and the log lacks it, else
    what excites each."""
    names = [{c["effect"] for c in s} for s in sets]
    rivals = set.union(*names) - set.intersection(*names) or set.union(*names)
    words = [EFFECTS[n].words for n in dict.fromkeys(c["effect"] for s in sets for c in s) if n in rivals]
    telling = [[d.record for d in w.told_by if not any(_logged(signal, case) for signal in d.signals)] for w in words]
    chosen = telling if all(telling) else [w.excitation for w in words]
    return "; ".join(list(dict.fromkeys(text for texts in chosen for text in texts))[:_MOST_RECORDINGS])


def _logged(signal: str, case: Case) -> bool:
    """Whether a log has a signal; a torque that is commanded need not be measured."""
    return case.has(signal) or (signal == "joint_torque" and case.command_kind == "torque")


def _next_for_unknown(where: Sequence[dict[str, Any]], case: Case) -> str:
    """One recording: the signal that a robot like this can log and has not, else the motion that tells most."""
    if case.floating and not case.has("base_pos"):
        return "the pose of the base too, which tells the ground from the joints"
    if case.floating and not case.has_imu:
        return "the IMU too, which tells the robot's motion from delays of its readings"
    if not replicates(case):
        return "one run twice: a rest that comes back is the model's, one that does not is the robot's"
    joint = next((_plain(w["joint"]) for w in where if "joint" in w), "each joint")
    motion = f"{joint} alone, slowly and fast, over its whole range"
    logged = case.has("joint_torque") or case.command_kind == "torque"
    return motion if logged else f"{motion}, with the motor's current where the drive reports it"
