"""Scores diagnoses against labels: verdict, cause and place, false alarms, open set, intervals, shrinkage, power."""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np

Label = dict[str, Any]
Diagnosis = dict[str, Any]

PLACELESS = {
    "command_delay",
    "observation_delay",
    "imu_bias",
    "ground_friction",
    "contact_compliance",
    "terrain_tilt",
    "terrain_scale",
    "thrust_gain",
    "tendon_gain",
}
LARGE_SHARE = 0.3


def hit(found: dict[str, Any], truth: Label) -> bool:
    """Same effect, and at least one right place where the effect has one."""
    if found["effect"] != truth["effect"]:
        return False
    if truth["effect"] in PLACELESS:
        return True
    places = set(truth.get("joints") or []) | set(truth.get("bodies") or [])
    return not places or bool(places & (set(found.get("joints") or []) | set(found.get("bodies") or [])))


def same(found: list[dict[str, Any]], truth: list[Label]) -> bool:
    """Every cause of one set is in the other."""
    return len(found) == len(truth) and all(any(hit(f, t) for f in found) for t in truth)


def short(cause: Mapping[str, Any]) -> str:
    """A cause as rows have it: effect@place+place."""
    return f"{cause['effect']}@{'+'.join(cause.get('joints') or cause.get('bodies') or [])}"


class MixedEnginesError(ValueError):
    """Diagnoses of several engines or settings, which no one figure may pool."""


def one_engine(found: dict[str, Diagnosis]) -> dict[str, Any]:
    """`provenance` that all diagnoses share. Raises MixedEnginesError, naming cases of each, where they do not."""
    groups: dict[str, list[str]] = {}
    for name in sorted(found):
        groups.setdefault(json.dumps(found[name].get("provenance"), sort_keys=True), []).append(name)
    if len(groups) > 1:
        kinds = "; ".join(
            f"{_engine(json.loads(key))}: {len(names)} cases, such as {names[0]}" for key, names in groups.items()
        )
        raise MixedEnginesError(f"the diagnoses are not of one engine and one set of settings: {kinds}")
    key = next(iter(groups), "null")
    return dict(json.loads(key) or {"engine": "not recorded"})


def _engine(provenance: dict[str, Any] | None) -> str:
    if not provenance:
        return "engine not recorded"
    settings = json.dumps(provenance.get("settings"), sort_keys=True)
    return f"engine {provenance.get('engine')} with settings {sha256(settings.encode()).hexdigest()[:6]}"


def score(labels: dict[str, Label], found: dict[str, Diagnosis]) -> dict[str, Any]:
    """All figures; shares as [hits, of]. Raises MixedEnginesError for diagnoses of several engines."""

    def of(cls: str) -> list[str]:
        return [n for n in sorted(labels) if labels[n]["cls"] == cls and n in found]

    out: dict[str, Any] = {"provenance": one_engine(found), "diagnosed": [len(found), len(labels)]}
    single = of("single")
    top = [top1(labels[n], found[n]) for n in single]
    out["single_top1"] = share(t == 2 for t in top)
    out["single_top1_with_equivalents"] = share(t >= 1 for t in top)
    out["single_by_robot"] = _by(single, lambda n: labels[n]["robot"], lambda n: top1(labels[n], found[n]) == 2)
    out["single_by_effect"] = _by(
        single, lambda n: labels[n]["effects"][0]["effect"], lambda n: top1(labels[n], found[n]) == 2
    )
    out["power_by_visibility"] = _by(
        single, lambda n: _visible(labels[n]["visibility"][0]), lambda n: top1(labels[n], found[n]) == 2
    )
    out["named_by_visibility"] = _by(
        single, lambda n: _visible(labels[n]["visibility"][0]), lambda n: top1(labels[n], found[n]) >= 1
    )
    both = of("double")
    out["double_both_found"] = share(
        all(any(hit(c, t) for c in found[n]["causes"]) for t in labels[n]["effects"]) for n in both
    )
    out["double_both_found_with_equivalents"] = share(
        any(all(any(hit(c, t) for c in s) for t in labels[n]["effects"]) for s in _sets(found[n])) for n in both
    )
    out["double_one_found"] = share(
        any(any(hit(c, t) for c in found[n]["causes"]) for t in labels[n]["effects"]) for n in both
    )
    named = [(c, labels[n]["effects"]) for n in single + both for c in found[n]["causes"]]
    out["set_precision"] = share(any(hit(c, t) for t in truths) for c, truths in named)
    wanted = [(t, found[n]["causes"]) for n in single + both for t in labels[n]["effects"]]
    out["set_recall"] = share(any(hit(c, t) for c in causes) for t, causes in wanted)
    out["false_alarms"] = share(found[n]["verdict"] != "no_gap" for n in of("none"))
    out["missed_gaps"] = share(found[n]["verdict"] == "no_gap" for n in single + both + of("outside"))
    out["outside_said"] = share(reported_unexplained(found[n]) for n in of("outside"))
    out["confounded_named"] = share(look_alikes_named(labels[n], found[n]) for n in of("confounded"))
    out["outside_partly_explained"] = share(found[n]["verdict"] == "partly_explained" for n in of("outside"))
    causes = [(n, c) for n in sorted(found) for c in found[n]["causes"]]
    out["causes_right_by_verdict"] = {
        v: share(any(hit(c, t) for t in labels[n]["effects"]) for n, c in causes if found[n]["verdict"] == v)
        for v in sorted({found[n]["verdict"] for n, _ in causes})
    }
    stated = [(found[n]["verdict"], c["probability"]) for n, c in causes if c.get("probability") is not None]
    out["causes_probability_stated"] = {
        v: round(float(np.mean([p for verdict, p in stated if verdict == v])), 2)
        for v in sorted({v for v, _ in stated})
    }
    errors, held = _parameters(labels, found, single + both)
    out["parameter_error_median"] = float(np.median(errors)) if errors else None
    out["ci90_holds_truth"] = share(held)
    right = [n for n in single if top1(labels[n], found[n]) == 2]
    gone = [_gone(found[n]) for n in right]
    out["gap_gone_median_where_right"] = float(np.nanmedian(gone)) if gone else None
    out["verdicts"] = {
        c: _count(found[n]["verdict"] for n in of(c)) for c in ("none", "single", "double", "outside", "confounded")
    }
    out["seconds_by_robot"] = _seconds(labels, found)
    out["cases_detail"] = {n: _detail(labels[n], found[n]) for n in sorted(found)}
    return out


def _sets(d: Diagnosis) -> list[list[dict[str, Any]]]:
    return [d["causes"], *d["equivalent"]]


def top1(label: Label, d: Diagnosis) -> int:
    """2: the true cause stands first. 1: it is named among the equivalents, or an equivalent of it stands first."""
    if d["verdict"] == "no_gap" or not d["causes"]:
        return 0
    if hit(d["causes"][0], label["effects"][0]):
        return 2
    named = [d["causes"], *d["equivalent"]]
    accepted = [label["effects"], *label["equivalents"]]
    return int(any(same(n, a) for n in named for a in accepted))


def reported_unexplained(d: Diagnosis) -> bool:
    share = d.get("unexplained_share")
    return d["verdict"] == "unexplained" or (d["verdict"] != "no_gap" and share is not None and share >= LARGE_SHARE)


def look_alikes_named(label: Label, d: Diagnosis) -> bool:
    """At least two of the sets that no log can tell apart are named, and the verdict does not pretend to know one."""
    members = [label["effects"], *label["equivalents"]]
    named = [d["causes"], *d["equivalent"]]
    return d["verdict"] == "ambiguous" and sum(any(same(n, m) for n in named) for m in members) >= 2


def intervals_hold(label: Label, d: Diagnosis) -> list[bool]:
    """Of each true cause that is named, whether its interval holds the true value."""
    return _parameters({"": label}, {"": d}, [""] if label["cls"] in ("single", "double") else [])[1]


def _parameters(
    labels: dict[str, Label], found: dict[str, Diagnosis], names: Iterable[str]
) -> tuple[list[float], list[bool]]:
    """Relative error of each found cause's first parameter, and whether its interval holds the truth."""
    errors, held = [], []
    for n in names:
        for truth in labels[n]["effects"]:
            cause = next((c for c in found[n]["causes"] if hit(c, truth)), None)
            if cause is None or not truth["parameters"]:
                continue
            value = truth["parameters"][0]
            given = _parameter(cause["parameters"], value)
            if given is None or given.get("value") is None:
                continue
            errors.append(abs(given["value"] - value["value"]) / max(abs(value["value"]), 1e-9))
            ci = given.get("ci90")
            if ci and None not in ci and all(map(math.isfinite, ci)):
                held.append(bool(min(ci) <= value["value"] <= max(ci)))
    return errors, held


def _parameter(parameters: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any] | None:
    """The parameter of that name, else the only one of that unit."""
    if truth["name"] in parameters:
        return parameters[truth["name"]]
    unit = truth["unit"].replace(" ", "")
    alike = [p for p in parameters.values() if str(p.get("unit", "")).replace(" ", "") == unit]
    if len(alike) == 1:
        return alike[0]
    return next(iter(parameters.values())) if len(parameters) == 1 else None


def _gone(d: Diagnosis) -> float:
    """Share of the gap above the noise floor that is gone on unseen runs."""
    s = d.get("statistics") or {}
    before, after = s.get("gap_over_floor"), s.get("left_over_floor")  # mean squares there, in units of the floor
    if before is None or after is None or before <= 1:
        return float("nan")
    return 1 - max(after - 1, 0.0) / (before - 1)


def _detail(label: Label, d: Diagnosis) -> dict[str, Any]:
    return {
        "cls": label["cls"],
        "robot": label["robot"],
        "truth": list(map(short, label["effects"])),
        "verdict": d["verdict"],
        "causes": list(map(short, d["causes"])),
        "equivalent": [list(map(short, s)) for s in d["equivalent"]][:4],
        "unexplained_share": d.get("unexplained_share"),
        "visibility": [round(v, 1) for v in label.get("visibility", [])],
        "cpu_seconds": d.get("cpu_seconds"),
    }


def _seconds(labels: dict[str, Label], found: dict[str, Diagnosis]) -> dict[str, list[float]]:
    """Robot -> [median, largest] CPU seconds a case, and [.., ..] seconds of the robot's time that were simulated."""
    out: dict[str, list[float]] = {}
    for robot in sorted({v["robot"] for v in labels.values()}):
        for key, name in (("cpu_seconds", robot), ("simulated_seconds", f"{robot} simulated")):
            s = [found[n][key] for n in found if labels[n]["robot"] == robot and found[n].get(key) is not None]
            if s:
                out[name] = [round(float(np.median(s)), 1), round(float(np.max(s)), 1)]
    return out


def _visible(ratio: float) -> str:
    """Change of the signals in units of sensors and everyday deviations."""
    return "1: below 3" if ratio < 3 else "2: 3 to 10" if ratio < 10 else "3: above 10"


def share(flags: Iterable[bool]) -> list[int]:
    """[hits, of]."""
    flags = list(flags)
    return [int(sum(flags)), len(flags)]


def _by(names: list[str], key: Callable[[str], str], good: Callable[[str], bool]) -> dict[str, list[int]]:
    groups = sorted({key(n) for n in names})
    return {g: share(good(n) for n in names if key(n) == g) for g in groups}


def _count(values: Iterable[str]) -> dict[str, int]:
    values = list(values)
    return {v: values.count(v) for v in sorted(set(values))}


BARS = {
    "single_top1": ">= 0.85",
    "single_top1_with_equivalents": ">= 0.95",
    "double_both_found": ">= 0.60",
    "false_alarms": "<= 0.05",
    "outside_said": ">= 0.80",
    "confounded_named": ">= 0.80",
    "ci90_holds_truth": "0.80 .. 0.97",
    "gap_gone_median_where_right": ">= 0.70",
}


def exactly_right(verdict: str, causes: Sequence[str], truth: Sequence[str]) -> bool:
    """Whether an answer is `identified` and names the true causes, at all their places, and nothing else.

    Causes are written `effect@place+place`.
    """
    return verdict == "identified" and _parts(causes) == _parts(truth)


def _parts(causes: Sequence[str]) -> set[tuple[str, frozenset[str]]]:
    split = (text.partition("@") for text in causes)
    return {(effect, frozenset(re.split(r"[+,]", places))) for effect, _, places in split}


def table(figures: Mapping[str, Any], bars: Mapping[str, str] = BARS) -> str:
    """The figures for people; of shares, those that have a case."""
    lines = []
    for name, value in figures.items():
        if name == "provenance":
            lines.append(f"{name:<36} {_engine(value)}, realsim {value.get('version')}, mujoco {value.get('mujoco')}")
            continue
        if name == "cases_detail" or value == [0, 0]:
            continue
        bar = f"   (bar {bars[name]})" if name in bars else ""
        if isinstance(value, list) and len(value) == 2 and all(isinstance(v, int) for v in value):
            text = f"{value[0]}/{value[1]}" + (f" = {value[0] / value[1]:.2f}" if value[1] else "")
        elif isinstance(value, dict):
            text = ", ".join(f"{k} {'/'.join(map(str, v)) if isinstance(v, list) else v}" for k, v in value.items())
        else:
            text = f"{value:.3f}" if isinstance(value, float) else str(value)
        lines.append(f"{name:<36} {text}{bar}")
    return "\n".join(lines)
