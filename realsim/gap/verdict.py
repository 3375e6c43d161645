"""The verdict, and the sentence that says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.gap.case import Case
from realsim.gap.config import DiagnoseConfig
from realsim.gap.heldout import Shrinkage, leftover
from realsim.gap.screen import Screen
from realsim.gap.select import Selection, is_gap
from realsim.gap.simulate import lookup
from realsim.types import F64


@dataclass(frozen=True)
class Judgement:
    verdict: str
    unexplained: float
    probabilities: list[float]
    """By cause of the fit, in the fit's order."""
    reasons: tuple[str, ...]

    def sentence(self, causes: Sequence[dict[str, Any]], equivalent: Sequence[Any], shrunk: Shrinkage) -> str:
        """One sentence that a person can act on."""
        if self.verdict == "no_gap":
            return "No gap: what differs is within sensor noise and the small deviations that every robot has."
        if not causes:
            return (
                "A gap that nothing in the library explains: "
                f"{self.unexplained:.0%} of what lies above the noise floor stays on unseen runs."
            )
        said = "; ".join(phrase(c) for c in causes)
        low, high = shrunk.ci90
        runs = "runs it has not seen" if shrunk.unseen else "the runs it was fitted on (no other was left)"
        text = f"{said}; adding it removes {shrunk.fraction:.0%} [{low:.0%}, {high:.0%}] of the squared error on {runs}"
        if self.verdict == "ambiguous":
            others = " or ".join(" with ".join(phrase(c) for c in s) for s in equivalent[:3])
            return f"{text}; the log cannot tell this from: {others}."
        if self.verdict == "unexplained":
            return f"{text}, but {self.unexplained:.0%} of the gap stays unexplained: treat this as a partial answer."
        return text + "."


def phrase(cause: dict[str, Any]) -> str:
    """left knee: Coulomb friction 1.9 N m [1.6, 2.2]."""
    place = ", ".join(cause.get("joints") or cause.get("bodies") or []) or "everywhere"
    title = lookup(cause["effect"]).title
    values = []
    for name, p in list(cause["parameters"].items())[:4]:
        low, high = p["ci90"]
        unit = "times" if p["unit"] == "ratio" else p["unit"]
        label = f"{name} " if len(cause["parameters"]) > 1 else ""
        values.append(f"{label}{p['value']:.3g} {unit} [{low:.3g}, {high:.3g}]")
    return f"{place}: {title} {', '.join(values)}"


def judge(case: Case, config: DiagnoseConfig, screen: Screen, selection: Selection, shrunk: Shrinkage) -> Judgement:
    """No gap, identified, ambiguous or unexplained, with the reasons."""
    del case
    reasons = []
    fit = selection.fit
    first, left, unexplained = remains(screen, selection)
    gains = [min(selection.gains.get(i, 0.0), 30.0) for i in range(len(fit.causes))]
    probabilities = [float(1 / (1 + np.exp(5 - g))) for g in gains]
    gap = is_gap(left)
    if not fit.causes:
        reasons.append(f"{left.mean():.2f} times the floor stays beside the small deviations (nominal {first:.1f})")
        if gap:
            return Judgement("unexplained", max(unexplained, 0.5), probabilities, tuple(reasons))
        return Judgement("no_gap", 0.0, probabilities, tuple(reasons))
    reasons.append(f"{first:.1f} -> {left.mean():.2f} in units of the floor")
    if gap and unexplained > config.unexplained_share:
        reasons.append(f"{unexplained:.0%} of the gap stays")
        return Judgement("unexplained", unexplained, probabilities, tuple(reasons))
    if selection.equivalent:
        count = 1 + len(selection.equivalent)
        probabilities = [p / count if p / count > 0.5 else max(p / count, 0.5) for p in probabilities]
        return Judgement("ambiguous", unexplained, probabilities, tuple(reasons))
    return Judgement("identified", unexplained, probabilities, tuple(reasons))


def remains(screen: Screen, selection: Selection) -> tuple[float, F64, float]:
    """(nominal, final, share): mean squares in units of the floor, and the share of the gap above it that stays.

    The final one is after causes and small deviations. The share is taken run by run, so that one run that diverges
    does not speak for all.
    """
    before = []
    for k, run in enumerate(screen.runs):
        r0 = screen.comparison.residual(run, selection.nominal.predictions[k])
        before.append(float(np.nanmean(r0**2 / screen.comparison.floor(run))))
    a, b = leftover(screen, selection.fit), np.array(before)
    weight = np.log1p(np.maximum(b - 1, 0))
    shares = np.clip((a - 1) / np.maximum(b - 1, 1e-9), 0, 1)
    share = float((weight * shares).sum() / weight.sum()) if weight.sum() > 0 else 0.0
    return float(b.mean()), a, share
