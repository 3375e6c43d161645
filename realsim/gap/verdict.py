"""The verdict, and the sentence that says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.gap.case import Case
from realsim.gap.config import DiagnoseConfig
from realsim.gap.heldout import Shrinkage
from realsim.gap.screen import Screen
from realsim.gap.select import Selection
from realsim.gap.simulate import lookup


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
    left = misfit_per_sample(screen, fit)
    first = misfit_per_sample(screen, selection.nominal)
    unexplained = left_share(screen, selection)
    if shrunk.before_over_floor > 2.0:
        unexplained = max(unexplained, shrunk.unexplained)
    probabilities = [
        float(1 / (1 + np.exp(-min(selection.gains.get(i, 0.0), 30.0) + 5))) for i in range(len(fit.causes))
    ]
    if not fit.causes:
        if left > GATE:
            reasons.append(f"{left:.2f} times the floor is left after the small deviations, and no effect holds")
            return Judgement("unexplained", max(unexplained, 0.5), probabilities, tuple(reasons))
        reasons.append(f"{left:.2f} times the floor is left after the small deviations: within the floor")
        return Judgement("no_gap", 0.0, probabilities, tuple(reasons))
    reasons.append(f"misfit {first:.2f} -> {left:.2f} in units of the floor")
    if unexplained > config.unexplained_share and left > GATE:
        reasons.append(f"{unexplained:.0%} of the gap stays")
        return Judgement("unexplained", unexplained, probabilities, tuple(reasons))
    if selection.equivalent:
        count = 1 + len(selection.equivalent)
        probabilities = [p / count if p / count > 0.5 else max(p / count, 0.5) for p in probabilities]
        return Judgement("ambiguous", unexplained, probabilities, tuple(reasons))
    return Judgement("identified", unexplained, probabilities, tuple(reasons))


GATE = 1.0
"""Misfit in units of the floor above which something is there."""


def misfit_per_sample(screen: Screen, fit: Any) -> float:
    """Weighted squared residual after the nuisances, a sample, in units of what the floor alone gives."""
    count = sum(float((screen.comparison.weights[r] > 0).sum()) for r in screen.runs)
    expected = 0.0
    for r in screen.runs:
        w = screen.comparison.weights[r]
        expected += float((w * screen.comparison.floor(r)).sum())
    del count
    return 2 * fit.misfit / max(expected, 1e-9)


def left_share(screen: Screen, selection: Selection) -> float:
    """Share of the misfit above the floor that the causes leave on the fitted runs."""
    before, after = misfit_per_sample(screen, selection.nominal), misfit_per_sample(screen, selection.fit)
    raw = 2 * 0.5 * sum(selection.nominal.evidence.c)
    del raw
    return float(np.clip((after - 1) / max(before - 1, 1e-9), 0, 1)) if before > 1 and after > 1 else 0.0
