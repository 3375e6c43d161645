"""What a diagnosis says, in the form of the contract."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import to_json, write_text
from realsim.core.statistics import Z90
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.arrays import Arrays
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.lookup import PLACES, lookup
from realsim.gap.inference.causes.fit import Cause, Fit
from realsim.gap.inference.causes.fitted import Trial, with_errors
from realsim.gap.inference.causes.select import Selection
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.verdicts import GapVerdict

ROUNDING = 1e-6
"""Of a parameter's step: less is what arithmetic leaves of zero."""
NOT_DETERMINED = "not determined"
"""Note of a value that the runs do not tell from none, nor from a size worth a name."""
MODEL_ERROR = 0.07
"""Relative error of a fitted value that comes from the simplified form of an effect (measured on made cases)."""


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with its evidence. `as_dict` is the contract's diagnosis.json."""

    verdict: GapVerdict
    sentence: str
    """The verdict as one sentence that a person can act on."""
    advice: str
    """What to do about it: one thing."""
    causes: tuple[dict[str, Any], ...]
    equivalent: tuple[tuple[dict[str, Any], ...], ...]
    where: tuple[dict[str, Any], ...]
    shrinkage: dict[str, Any]
    unexplained_share: float
    """Share of the check's gap above the floor that stays beside causes and everyday deviations."""
    patch: dict[str, Any]
    next_experiment: dict[str, Any] | None = None
    since: dict[str, Any] | None = None
    """What changed since an earlier log, where one was given; see `realsim.gap.drift.since`."""
    ranking: tuple[dict[str, Any], ...] = ()
    """All effects tried, with their gains."""
    health: dict[str, Any] = field(default_factory=dict)
    statistics: dict[str, Any] = field(default_factory=dict)
    cost: dict[str, float] = field(default_factory=dict)
    """`seconds` of wall time, `cpu_seconds`, `simulated_seconds` (of the robot's time, all replays together)."""
    looks_like: tuple[dict[str, Any], ...] = ()
    """What stays beside the causes, by joint: {joint, what, explains}."""
    lead: dict[str, Any] | None = None
    """Where no cause is named: the nearest one in the form of a cause, of a size that robots of one kind differ by."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Which engine gave this answer, and its settings; see `realsim.gap.provenance`."""
    evidence: Arrays | None = field(default=None, repr=False)
    """What the report draws; not part of the JSON."""

    def as_dict(self) -> dict[str, Any]:
        """JSON-able, the contract's fields first."""
        return {
            "verdict": str(self.verdict),
            "causes": list(self.causes),
            "equivalent": [list(s) for s in self.equivalent],
            "where": list(self.where),
            "shrinkage": self.shrinkage,
            "unexplained_share": self.unexplained_share,
            "next_experiment": self.next_experiment,
            **({} if self.since is None else {"since": self.since}),
            "patch": self.patch,
            "sentence": self.sentence,
            "advice": self.advice,
            "ranking": list(self.ranking),
            "health": self.health,
            "statistics": self.statistics,
            "looks_like": list(self.looks_like),
            "lead": self.lead,
            **self.cost,
            "provenance": self.provenance,
        }

    def write(self, folder: Path) -> Path:
        """Write diagnosis.json."""
        path = Path(folder) / "diagnosis.json"
        write_text(path, to_json(self.as_dict()))
        return path


def describe_cause(cause: Cause, sigmas: F64, onsets: Mapping[str, float]) -> dict[str, Any]:
    """A cause in the contract's form: places, values and intervals in reported units.

    `probability` is null: none is stated that was not calibrated.
    """
    effect = lookup(cause.candidate.effect)
    parameters = {p.name: p for p in cause.candidate.parameters}
    reported = {}
    for name, value, sigma in zip(cause.candidate.names, cause.values, sigmas, strict=True):
        p = parameters[name]
        # The robot's own everyday deviation of this very kind, and the model's imperfection, belong to the interval.
        relative = MODEL_ERROR * value if p.strength else 0.0
        sigma = float(np.sqrt(sigma**2 + p.nuisance**2 + relative**2))
        low, high = (float(np.clip(value + s * Z90 * sigma, *p.bounds)) for s in (-1, 1))
        ends = sorted((p.report(low), p.report(high)))
        value = 0.0 if abs(value) < ROUNDING * abs(p.step) else value
        note = p.note
        if low <= 0 <= high and sigma > figures.CLOSED * abs(p.step) and p.default == 0:
            note = NOT_DETERMINED
        if (when := effect.law.passing.get(name)) and when.onset:
            since = cause.named[when.onset]
            starts = [f"{run} from {at + since:.2f} s" for run, at in onsets.items()]
            note = f"in {', '.join(starts)}; in no other run"
        reported[p.label or name] = {"value": p.report(value), "unit": p.unit, "ci90": ends}
        if note:
            reported[p.label or name]["note"] = note
    places = {key: list(cause.candidate.place)} if (key := PLACES.get(effect.scope)) and cause.candidate.place else {}
    return {"effect": cause.candidate.effect, **places, "parameters": reported, "probability": None}


def describe_set(fit: Fit, order: list[int] | None = None, sigmas: F64 | None = None) -> list[dict[str, Any]]:
    """All causes of a fit, in `order`; `sigmas`: see `with_errors`."""
    rows = with_errors(fit, sigmas)
    return [describe_cause(*rows[i], fit.conditions.onsets) for i in (range(len(rows)) if order is None else order)]


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
