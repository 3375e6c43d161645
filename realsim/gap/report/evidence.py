"""Tables below the plots: causes, equivalents, ranking, health, patch, assumptions."""

from collections.abc import Iterable, Mapping, Sequence
from difflib import unified_diff
from typing import Any

from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.lookup import places_of
from realsim.gap.report.words import after, interval, percent, places, title_of
from realsim.report import page, svg

APPLY = """\
import mujoco
import realsim as rs

spec = mujoco.MjSpec.from_file("{model}")
wrappers = rs.apply_patch(spec, rs.load_diagnosis("."))
model = spec.compile()"""


# ---------------------------------------------------------------- causes


def causes_card(found: Diagnosis) -> list[str]:
    """What to add, with intervals."""
    if not found.causes:
        return []
    body = _cause_table(found.causes) + _explained(found.causes)
    note = "Changes against model.xml, with 90 % intervals: × multiplies, a unit adds, limits and delays are absolute."
    return [page.card("Causes and their size", body, note)]


def _cause_table(causes: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for c in causes:
        named = c["parameters"].items()
        values = "".join(f"<div>{page.esc(_parameter(n, p, len(named)))}</div>" for n, p in named)
        what = f"<b>{page.esc(title_of(c['effect']))}</b><small>{page.esc(places(places_of(c)))}</small>"
        rows.append([what, values])
    return page.table(["effect", "value [90 % interval]"], rows, raw=[0, 1])


def _parameter(name: str, parameter: dict[str, Any], count: int) -> str:
    text = interval(parameter) if count == 1 else f"{name.replace('_', ' ')} {interval(parameter)}"
    return f"{text}, {parameter['note']}" if parameter.get("note") else text


def _explained(causes: Sequence[Mapping[str, Any]]) -> str:
    names = dict.fromkeys(c["effect"] for c in causes)
    rows = [[title_of(n), EFFECTS[n].words.description, EFFECTS[n].words.signature] for n in names if n in EFFECTS]
    return page.fold("What these effects look like", page.table(["", "what it is", "in a log"], rows)) if rows else ""


_ARRAYS = ("rivals", "looked_at")
"""Of `next_experiment`, for `realsim excite`."""


def equivalents_card(found: Diagnosis) -> list[str]:
    """Sets that the log cannot tell from the causes, and what to record next."""
    if not found.equivalent and found.next_experiment is None:
        return []
    parts = []
    for i, other in enumerate(found.equivalent, 1):
        parts.append(f"<h4>Alternative {i}</h4>" + _cause_table(other))
    if found.next_experiment is not None:
        rows = [[k.replace("_", " "), _plain(v)] for k, v in found.next_experiment.items() if k not in _ARRAYS]
        parts.append("<h4>What to record to decide</h4>" + page.table(["", ""], rows))
    else:
        effects = dict.fromkeys(c["effect"] for s in (found.causes, *found.equivalent) for c in s)
        lines = [f"{title_of(n)}: {'; '.join(EFFECTS[n].words.excitation)}" for n in effects if n in EFFECTS]
        parts.append("<h4>What to record to decide: what shows each of these</h4>" + page.bullets(lines))
    note = "These explain the log as well as the causes above. Until a run tells them apart, trust none of them alone."
    return [page.card("Cannot be distinguished", "".join(parts), note)]


# ---------------------------------------------------------------- ranking


def ranking_card(found: Diagnosis) -> str:
    """All effects of the library, best first, with what became of each."""
    here = {c["effect"] for c in found.causes}
    same = {c["effect"] for s in found.equivalent for c in s} - here
    fitted, screened, untried = [], [], []
    top = _tops(found.ranking)
    for r in found.ranking:
        badge = page.badge("good", "cause") if r["effect"] in here else ""
        badge = page.badge("look", "equivalent") if r["effect"] in same else badge
        what = f"<b>{page.esc(title_of(r['effect']))}</b> {badge}<small>{page.esc(r['effect'])}</small>"
        where = places(r.get("place", []))
        if "linear_gain" not in r:
            untried.append([what, r["outcome"].removeprefix("not tried: ")])
        elif r.get("gain") is None:
            screened.append([what, where, _gain(r, "linear_gain", top), _outcome(r, here, same)])
        else:
            gains = [_spread(r, top), _gain(r, "gain", top), _gain(r, "linear_gain", top)]
            fitted.append([what, where, *gains, _outcome(r, here, same)])
    head = ["effect", "best place", "left-out run", "all runs", "linear", "outcome"]
    parts = ["<h4>Fitted with the full simulation</h4>", page.table(head, fitted, raw=[0])] if fitted else []
    if screened:
        rows = page.table(["effect", "best place", "linear", "outcome"], screened, raw=[0])
        parts.append(page.fold(f"{_effects(len(screened))} that the linear screen ruled out", rows))
    if untried:
        rows = page.table(["effect", "why not"], untried, raw=[0])
        parts.append(page.fold(f"{_effects(len(untried))} that this log cannot show", rows))
    if not parts:
        parts = [page.bullets([], "No effect had to be tried.")]
    note = (
        "How much each effect explains, in percent of the best one: on runs left out of its fit (mean and standard "
        "error), on all fitted runs together, and as a linear screen foretold."
    )
    return page.card("All effects", "".join(parts), note, wide=True)


def _outcome(r: dict[str, Any], here: set[str], same: set[str]) -> str:
    """Why an effect is not among the causes, in words."""
    outcome = r["outcome"]
    if r["effect"] in here:
        outcome = "accepted"
    elif r["effect"] in same:
        outcome = "explains the log as well"
    elif outcome == "refitted":
        outcome = "no better than what was accepted"
    elif outcome == "screened":
        outcome = "gains too little to be fitted" if r["linear_gain"] > 0 else "does not explain the error"
    return f"{outcome}, {after(r['stage'])}" if r.get("stage") else outcome


def _effects(count: int) -> str:
    return f"{count} effect{'s' * (count != 1)}"


def _tops(rows: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """The largest gain of each kind."""
    kinds = ("heldout_gain", "gain", "linear_gain")
    return {k: max([r[k] for r in rows if r.get(k) is not None and r[k] > 0], default=1.0) for k in kinds}


def _gain(r: dict[str, Any], kind: str, top: dict[str, float]) -> str:
    value = r[kind] / top[kind]
    return percent(value) if value > 0 else "none"


def _spread(r: dict[str, Any], top: dict[str, float]) -> str:
    if r.get("heldout_gain") is None:
        return "–"
    error = percent((r.get("heldout_se") or 0.0) / top["heldout_gain"])
    return f"{_gain(r, 'heldout_gain', top)}\u00a0±\u00a0{error}"


# ---------------------------------------------------------------- patch


def patch_card(found: Diagnosis) -> list[str]:
    """How to use the result, to copy and paste."""
    if not found.causes:
        return []
    kept = found.evidence
    folder = kept.case.folder.name if kept is not None else ""
    parts = [page.code(APPLY.format(model=f"{folder}/model.xml" if folder else "model.xml"))]
    wrappers = found.patch.get("wrappers", {})
    if wrappers:
        rows = [[k.replace("_", " "), _plain(v)] for k, v in wrappers.items()]
        parts += [
            "<h4>For the loop that steps the simulator</h4>",
            page.table(["wrapper", "value, and what to do"], rows),
        ]
    if kept is not None and (changed := model_changes(kept)):
        parts.append(page.fold("What changes in model.xml", page.code(changed)))
    note = (
        "model.xml beside this page has what MJCF can express; the code patches your own copy of the model. "
        f"{'The loop must do the rest, see below.' if wrappers else 'Nothing else is needed.'}"
    )
    return [page.card("Apply the patch", "".join(parts), note)]


def model_changes(kept: Arrays) -> str:
    """Lines of MJCF that differ, nominal (-) and patched (+), both as MuJoCo writes them."""
    before, after = kept.nominal_xml.splitlines(), kept.patched_xml.splitlines()
    lines = list(unified_diff(before, after, lineterm="", n=0))[2:]
    return "\n".join(line[0] + " " + line[1:].strip() for line in lines if not line.startswith("@@"))


# ---------------------------------------------------------------- assumptions


def assumptions_card(found: Diagnosis) -> str:
    """What the figures rest on."""
    statistics = found.statistics
    came = [found.sentence, *statistics.get("reasons", []), *statistics.get("notes", [])]
    parts = ["<h4>How the verdict came about</h4>", page.bullets(came)]
    assumed = [
        "Every part of the robot may differ a little from the model; only what is larger than that can be a cause.",
        "Slow errors are taken as correlated over a tenth of a second when intervals are computed.",
    ]
    kept = found.evidence
    if kept is not None:
        assumed += [
            f"Samples are averaged over bins of {1e3 * kept.bin_seconds:g} ms before they are compared.",
            f"A run at rest begins after the first command was held for {kept.settle_seconds:g} s; one recorded in "
            "motion begins in the state of the log.",
        ]
    parts += ["<h4>Assumed</h4>", page.bullets(assumed)]
    rows = [
        ["runs that were fitted", ", ".join(statistics.get("fitted_runs", []))],
        ["runs of the check", ", ".join(found.shrinkage.get("runs", []))],
        ["candidates screened", str(statistics.get("candidates", "–"))],
        ["full simulations in fits", str(statistics.get("fits", "–"))],
        [
            "simulated / logged",
            f"{statistics.get('simulated_seconds', 0):g} s / {statistics.get('logged_seconds', 0):g} s",
        ],
        ["time", f"{statistics.get('seconds', 0):g} s"],
    ]
    parts += ["<h4>Made with</h4>", page.table(["", ""], rows)]
    return page.card("What this rests on", "".join(parts))


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return svg.number(value)
    if isinstance(value, dict):
        if set(value) >= {"value", "unit"}:
            figure = " ".join(filter(None, [_plain(value["value"]), str(value["unit"])]))
            return ": ".join(filter(None, [figure, str(value.get("what", ""))]))
        return ", ".join(f"{k}: {_plain(v)}" for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return ("; " if any(isinstance(v, dict) for v in value) else ", ").join(_plain(v) for v in value)
    return "–" if value is None else str(value)
