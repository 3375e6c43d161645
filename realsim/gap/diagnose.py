"""From a case to a diagnosis: simulate, gate, select, check on unseen runs, say it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from realsim.gap.case import Case
from realsim.gap.compare import Comparison
from realsim.gap.config import DiagnoseConfig
from realsim.gap.diagnosis import Diagnosis, describe_set
from realsim.gap.effects import EFFECTS
from realsim.gap.fit import Fit, Fitter
from realsim.gap.health import examine
from realsim.gap.heldout import Shrinkage, nuisance_settings, shrinkage
from realsim.gap.patch import make_patch
from realsim.gap.screen import Screen
from realsim.gap.select import Selection, select
from realsim.gap.simulate import Simulator
from realsim.gap.verdict import judge
from realsim.gap.where import by_horizon, by_signal, localise

Progress = Callable[[str, float], None]


def diagnose(case: Case, config: DiagnoseConfig | None = None, progress: Progress | None = None) -> Diagnosis:
    """Where the gap lies, which effects cause it, and how far it shrinks on runs that no fit has seen.

    Args:
        case: from `load_case`.
        config: see `DiagnoseConfig`.
        progress: called with (what, share done) now and then.

    Raises:
        GapError: if the log cannot support a diagnosis, with the reason.
    """
    config = config or DiagnoseConfig()
    tick = progress or (lambda what, share: None)
    for name in config.effects:
        EFFECTS[name]  # an unknown name is said with the closest ones
    began = time.perf_counter()
    case = _limited(case, config)
    with Simulator(case, config) as simulator:
        health = examine(simulator)
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, config)
        fitted, held = split_runs(case, config, simulator)
        tick("sensitivities", 0.0)
        screen = Screen(simulator, comparison, fitted, config.effects, tick)
        fitter = Fitter(screen)
        selection = select(screen, fitter, config, tick)
        tick("unseen runs", 0.9)
        unseen = bool(held)
        check = held or fitted
        rivals = _baselines(screen, selection)
        shrunk = shrinkage(
            screen, comparison, selection.nominal, selection.fit, check, unseen, config.bootstrap, config.seed, rivals
        )
        found = _assemble(case, config, simulator, comparison, screen, selection, shrunk, nominal, health)
        seconds = time.perf_counter() - began
        statistics = found.statistics | {
            "seconds": round(seconds, 2),
            "simulated_seconds": round(simulator.simulated_seconds, 1),
            "logged_seconds": round(sum(r.duration for r in case.runs), 2),
            "fits": fitter.evaluations,
        }
    return replace(found, statistics=statistics)


def _limited(case: Case, config: DiagnoseConfig) -> Case:
    """At most max_runs runs of at most max_seconds each; what is left out is said."""
    notes = []
    runs = list(case.runs)
    if len(runs) > config.max_runs:
        keep = np.unique(np.linspace(0, len(runs) - 1, config.max_runs).round().astype(int))
        notes.append(f"{len(runs)} runs: {len(keep)} of them, evenly spread, are used")
        runs = [runs[i] for i in keep]
    long = [r.name for r in runs if r.duration > config.max_seconds + 0.5]
    if long:
        notes.append(f"{len(long)} runs are longer than {config.max_seconds:g} s: their beginning is used")
        runs = [_cut(r, config.max_seconds) for r in runs]
    return case.with_runs(tuple(runs), *notes)


def _cut(run: Any, seconds: float) -> Any:
    keep = run.time <= seconds
    return replace(
        run, time=run.time[keep], command=run.command[keep], signals={k: v[keep] for k, v in run.signals.items()}
    )


def split_runs(case: Case, config: DiagnoseConfig, simulator: Simulator) -> tuple[list[int], list[int]]:
    """(runs for fitting, runs that no fit sees). A replicate of a fitted run is no test, so it is not held out.

    On robots with many joints only some runs carry the sensitivities: the most different ones first.
    """
    count = len(case.runs)
    twins = replicates(case)
    single = [i for i in range(count) if not any(i in g for g in twins)] or list(range(count))
    held = single[-config.holdout :] if config.holdout and count > config.holdout + 1 else []
    fitted = [i for i in range(count) if i not in held]
    most = 6 if len(case.joint_names) <= 8 else 3
    if len(fitted) > most:
        repeated = {i for g in twins for i in g[1:]}
        order = sorted(fitted, key=lambda i: (i in repeated, -_liveliness(case, i)))
        fitted = sorted(order[:most])
    return fitted, held


def _liveliness(case: Case, i: int) -> float:
    run = case.runs[i]
    return float(np.abs(np.diff(run.command, axis=0)).sum())


def replicates(case: Case) -> list[list[int]]:
    """Groups of runs with the same command."""
    groups: list[list[int]] = []
    for i, run in enumerate(case.runs):
        for group in groups:
            other = case.runs[group[0]]
            n = min(len(run.command), len(other.command))
            if abs(len(run.command) - len(other.command)) <= 2 and np.allclose(
                run.command[:n], other.command[:n], atol=1e-6
            ):
                group.append(i)
                break
        else:
            groups.append([i])
    return [g for g in groups if len(g) > 1]


def _baselines(screen: Screen, selection: Selection) -> dict[str, Any]:
    """Settings of the rivals that the shrinkage is printed beside."""
    rivals: dict[str, Any] = {}
    mine = {c.candidate.effect for c in selection.fit.causes}
    same = {c.candidate.effect for f in selection.equivalent for c in f.causes}
    others = [t for t in selection.trials if t.gain is not None and t.stage == 0 and t.effect not in mine | same]
    if others:
        best = max(others, key=lambda t: t.gain or 0.0)
        places = next(c.places for c in screen.candidates if c.effect == best.effect and c.place == best.place)
        rivals[f"best wrong effect ({best.effect})"] = [(best.effect, p, best.values) for p in places]
    wide = replace(
        selection.nominal, prior=np.array([max(a.parameter.nuisance, abs(a.parameter.step)) for a in screen.atoms])
    )
    rivals["all effects at once"] = _everything(screen, wide)
    return rivals


def _everything(screen: Screen, fit: Fit) -> list[Any]:
    settings = nuisance_settings(screen, fit)
    return [s for s in settings if s[0] in EFFECTS]


def _assemble(
    case: Case,
    config: DiagnoseConfig,
    simulator: Simulator,
    comparison: Comparison,
    screen: Screen,
    selection: Selection,
    shrunk: Shrinkage,
    nominal: list[np.ndarray],
    health: dict[str, Any],
) -> Diagnosis:
    runs = list(range(len(case.runs)))
    residuals = [comparison.residual(i, nominal[i]) for i in runs]
    where, shares = localise(comparison, residuals, runs, simulator.nominal_tracks)
    judgement = judge(case, config, screen, selection, shrunk)
    fit = selection.fit
    order = sorted(range(len(fit.causes)), key=lambda i: -selection.gains.get(i, 0.0))
    causes = describe_set(simulator, fit, order, judgement.probabilities)
    if judgement.verdict == "no_gap":
        causes = []
    equivalent = []
    for other in selection.equivalent if causes else []:
        ranking = list(range(len(other.causes)))
        equivalent.append(tuple(describe_set(simulator, other, ranking, [0.5] * len(ranking))))
    if not shrunk.unseen:
        health["warnings"].append("no run was left unseen: the shrinkage is optimistic and the verdict weaker")
    return Diagnosis(
        verdict=judgement.verdict,
        sentence=judgement.sentence(causes, equivalent, shrunk),
        causes=tuple(causes),
        equivalent=tuple(equivalent),
        where=tuple(where),
        shrinkage={
            "before": 1.0,
            "after": shrunk.after,
            "fraction": shrunk.fraction,
            "ci90": list(shrunk.ci90),
            "above_floor": shrunk.above_floor,
            "runs": list(shrunk.runs),
            "unseen": shrunk.unseen,
            "per_signal": shrunk.per_signal,
            "baselines": shrunk.baselines,
        },
        unexplained_share=judgement.unexplained,
        patch=make_patch(simulator, fit)
        if causes
        else {"format": "realsim.gap.patch/1", "settings": [], "wrappers": {}},
        ranking=tuple(_ranking(selection, screen)),
        health=health,
        statistics={
            "gap_over_floor": shrunk.before_over_floor,
            "left_over_floor": shrunk.after_over_floor,
            "structure_left": shrunk.structure,
            "by_signal": by_signal(comparison, shares),
            "error_by_horizon_rad": by_horizon(comparison, residuals),
            "atoms": len(screen.atoms),
            "candidates": len(screen.candidates),
            "fitted_runs": [case.runs[i].name for i in screen.runs],
            "reasons": list(judgement.reasons),
            "notes": selection.notes,
        },
        evidence={
            "shares": shares,
            "residuals": residuals,
            "comparison": comparison,
            "fit": fit,
            "simulator": simulator,
            "check": list(shrunk.runs),
        },
    )


def _ranking(selection: Selection, screen: Screen) -> list[dict[str, Any]]:
    """One line an effect: its best place, with what came of it; effects that could not be tried, with the reason."""
    best: dict[str, Any] = {}
    for t in selection.trials:
        old = best.get(t.effect)
        key = (t.gain is not None, t.gain if t.gain is not None else t.linear_gain)
        if old is None or key > (old.gain is not None, old.gain if old.gain is not None else old.linear_gain):
            best[t.effect] = t
    rows = [
        {
            "effect": t.effect,
            "place": list(t.place),
            "linear_gain": t.linear_gain,
            "gain": t.gain,
            "heldout_gain": t.heldout_gain,
            "heldout_se": t.heldout_se,
            "stage": t.stage,
            "outcome": t.outcome,
        }
        for t in best.values()
    ]
    rows.sort(key=lambda r: -(r["gain"] if r["gain"] is not None else min(r["linear_gain"], 0.0) - 1e6))
    rows += [
        {"effect": name, "outcome": f"not tried: {reason}"}
        for name, reason in screen.skipped.items()
        if name in EFFECTS and name not in best
    ]
    return rows
