"""What changed, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from realsim.gap.effects import EFFECTS

Change = dict[str, Any]


def sentence(verdict: str, changes: Sequence[Change], equivalent: Sequence[Sequence[Change]]) -> str:
    """The verdict as one sentence."""
    if verdict == "unchanged":
        return "Nothing changed that these two logs can show, beyond what comes and goes from day to day."
    said = "; ".join(phrase(c) for c in changes)
    if verdict == "ambiguous":
        either = ", or ".join("; ".join(phrase(c) for c in s) for s in (changes, *equivalent))
        return f"Something changed, and cannot tell what: {either}."
    if verdict == "unexplained":
        near = f" The nearest is {said}: it may only imitate the change." if changes else ""
        return f"Something changed that no effect of this library explains.{near}"
    hints = [by for c in changes if (by := EFFECTS[c["effect"]].words.changed_by)]
    return f"{said}{f' (often {hints[0]})' if len(hints) == 1 == len(changes) else ''}."


def phrase(change: Change) -> str:
    """elbow: Coulomb friction grew by 0.31 N m [0.26, 0.36], from 0 to 0.31."""
    title = EFFECTS[change["effect"]].title
    names = ", ".join(change.get("joints") or change.get("bodies") or [])
    every, place = change["parameters"], ""
    if all(a in every and every[a]["change"] is None for a in "xyz"):  # where a mass sits that was not there
        place = f" at ({', '.join(_number(round(every[a]['now'], 3)) for a in 'xyz')}) m"
        every = {n: p for n, p in every.items() if n not in ("x", "y", "z")}
    parts = [_amount(name, p, len(every) > 1) for name, p in every.items()]
    parts[-1] += place
    return f"{names}: {title} {', '.join(parts)}" if names else f"{title} {', '.join(parts)}"


def _amount(name: str, p: dict[str, Any], named: bool) -> str:
    label = f"{name.replace('_', ' ')} " if named else ""
    unit = "" if p["unit"] == "ratio" else f" {p['unit']}"
    if p["change"] is None:
        low, high = p["now_ci90"]
        return f"{label}is now {_number(p['now'])}{unit} [{_number(low)}, {_number(high)}]"
    low, high = p["ci90"]
    if p["unit"] == "ratio" and p["before"] > 0 and abs(p["change"] - p["now"] / p["before"]) < 1e-9:
        return f"{label}is {_number(p['change'])} times [{_number(low)}, {_number(high)}] what it was"
    grew, sign = ("grew", 1) if p["change"] >= 0 else ("fell", -1)
    low, high = sorted((sign * low, sign * high))
    ends = f"from {_number(p['before'])} to {_number(p['now'])}"
    return f"{label}{grew} by {_number(sign * p['change'])}{unit} [{_number(low)}, {_number(high)}], {ends}"


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")
