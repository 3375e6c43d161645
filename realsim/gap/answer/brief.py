"""A diagnosis in a few lines, for the terminal and for the head of the page: cause, size, evidence, what to do."""

from collections.abc import Mapping, Sequence
from typing import Any

from realsim.gap.answer.sentence import SIGNALS, amount, phrase, share

MOST_CAUSES, MOST_SIGNALS, MOST_WHERE = 3, 2, 1
"""Rows of each kind: a terminal's dozen lines hold them all."""
NOTHING_KNOWN = "–"

Row = tuple[str, str]
"""(label, text)"""


def brief(data: Mapping[str, Any]) -> dict[str, list[Row]]:
    """`cause`, `size`, `evidence` and `next`, each some rows; from the content of diagnosis.json."""
    return {
        "cause": _causes(data),
        "size": _size(data),
        "evidence": _evidence(data),
        "next": [("next", data["advice"])] if data.get("advice") else [],
    }


def _causes(data: Mapping[str, Any]) -> list[Row]:
    rows = [("cause" if i == 0 else "and", phrase(c)) for i, c in enumerate(data["causes"][:MOST_CAUSES])]
    if not rows and data.get("lead"):
        small = data["verdict"] == "no_gap"
        why = "within what robots of one kind differ by" if small else "it does not explain the runs"
        rows = [("nearest", f"{phrase(data['lead'])}: {why}")]
    others = data["equivalent"]
    if others:
        first = " with ".join(phrase(c) for c in others[0])
        more = f"; {len(others) - 1} more sets in the report" if len(others) > 1 else ""
        rows.append(("or", f"{first}{more}"))
    return rows


def _size(data: Mapping[str, Any]) -> list[Row]:
    """The error of the check before and after, in the signal's unit, beside the motion."""
    shrunk, causes = data["shrinkage"], data["causes"]
    if data["verdict"] == "no_gap":
        return []
    rows = []
    if causes:
        low, high = map(share, shrunk["ci90"])
        ends = f"90 % interval {low} to {high}" if low != high else "the 90 % interval is narrower than its last digit"
        rows.append(("check", f"{share(shrunk['fraction'])} of the squared error goes, {ends}, {on_what(shrunk)}"))
        if beside := shrunk.get("beside_deviations"):
            rows.append(("", f"of what everyday deviations leave there, {share(beside[0])} to {share(beside[1])} goes"))
    by_size = sorted(shrunk["per_signal"].items(), key=lambda item: -item[1]["rms_before"] / item[1]["floor"])
    for i, (signal, v) in enumerate(by_size[:MOST_SIGNALS]):
        now = f", now {amount(v['rms_after'], v['unit'])}" if causes else ""
        off, motion = amount(v["rms_before"], v["unit"]), amount(v["motion"], v["unit"])
        text = f"{SIGNALS.get(signal, signal)} off by {off} rms{now}; the motion is {motion} rms"
        rows.append(("error" if i == 0 else "", text))
    return rows


def on_what(shrunk: Mapping[str, Any]) -> str:
    """The runs of the check, and what they are."""
    runs = shrunk["runs"]
    names = ", ".join(runs[:3]) + (f" and {len(runs) - 3} more" if len(runs) > 3 else "")
    if shrunk.get("unseen", True):
        return f"on {names} (held out)"
    in_turn = shrunk.get("kind") == "left_out_in_turn"
    return f"on {names} ({'each left out in turn' if in_turn else 'fitted: no run to spare'})"


def _evidence(data: Mapping[str, Any]) -> list[Row]:
    rows = [
        ("where" if i == 0 else "", where_text(entry))
        for i, entry in enumerate([] if data["verdict"] == "no_gap" else data["where"][:MOST_WHERE])
    ]
    looks: Sequence[Mapping[str, Any]] = data.get("looks_like", ())
    if looks:
        rows.append(("rest", "; ".join(f"{e['what']} at {e['joint']}" for e in looks[:2])))
    reasons = data["statistics"].get("reasons", [])
    if reasons and data["verdict"] in ("no_gap", "unexplained"):
        rows.append(("because", reasons[-1]))
    return rows


def where_text(entry: Mapping[str, Any]) -> str:
    """left_knee, joint position, at reversal: 43 % of the gap."""
    place = entry.get("joint") or " ".join(filter(None, [entry.get("body"), entry.get("axis")]))
    signal = SIGNALS.get(entry["signal"], entry["signal"])
    return f"{place}, {signal}, {entry['phase']}: {share(entry['share'])} of the gap"
