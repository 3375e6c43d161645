"""All effects of the library in one table: what each would gain, at which stage, and what became of it."""

from __future__ import annotations

from typing import Any

from realsim.gap.effects import EFFECTS
from realsim.gap.inference.causes.fitted import Trial
from realsim.gap.inference.causes.select import Selection
from realsim.gap.inference.likelihood.screen import Screen


def ranked_effects(selection: Selection, screen: Screen) -> list[dict[str, Any]]:
    """One line an effect: its best place, and its gains stage by stage; effects that could not be tried, with why."""
    of: dict[str, list[Trial]] = {}
    for trial in selection.trials:
        of.setdefault(trial.candidate.effect, []).append(trial)
    rows = [_row(trials) for trials in of.values()]
    rows.sort(key=lambda r: -(r["gain"] if r["gain"] is not None else min(r["linear_gain"], 0.0) - 1e6))
    rows += [
        {"effect": name, "outcome": f"not tried: {reason}"}
        for name, reason in screen.skipped.items()
        if name in EFFECTS and name not in of
    ]
    return rows


def _row(trials: list[Trial]) -> dict[str, Any]:
    best = max(trials, key=_merit)
    stages = [max((t for t in trials if t.stage == s), key=_merit) for s in sorted({t.stage for t in trials})]
    return {
        "effect": best.candidate.effect,
        **_said(best),
        "stages": [_said(t) for t in stages],
    }


def _merit(trial: Trial) -> tuple[bool, bool, bool, float]:
    """What was accepted goes first, then what was judged, what was only fitted, and what was only screened."""
    gain = trial.linear_gain if trial.gain is None else trial.gain
    return trial.outcome == "accepted", trial.held is not None, trial.gain is not None, gain


def _said(trial: Trial) -> dict[str, Any]:
    return {
        "place": list(trial.candidate.place),
        "linear_gain": trial.linear_gain,
        "gain": trial.gain,
        "heldout_gain": None if trial.held is None else trial.held[0],
        "heldout_se": None if trial.held is None else trial.held[1],
        "stage": trial.stage,
        "outcome": trial.outcome,
    }
