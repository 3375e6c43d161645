"""From a case to a diagnosis: simulate, gate, select, check on unseen runs, say it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from realsim.errors import GapError
from realsim.gap.answer.baselines import first_choices, rival_settings
from realsim.gap.answer.diagnosis import Diagnosis, describe_set
from realsim.gap.answer.heldout import Shrinkage, mean_gaps, shrinkage
from realsim.gap.answer.patch import empty_patch, make_patch
from realsim.gap.answer.ranking import ranked_effects
from realsim.gap.answer.sentence import sentence
from realsim.gap.answer.verdict import judge
from realsim.gap.causes.fit import Fitter
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.select import Selection, select, without_causes
from realsim.gap.compare import Comparison
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS
from realsim.gap.evidence.onsets import find_onsets
from realsim.gap.evidence.where import by_signal, change_by_horizon, evidence, localise
from realsim.gap.experiments.proposal import propose, with_text
from realsim.gap.health import examine
from realsim.gap.logs.case import Case
from realsim.gap.logs.repeats import replicates as replicates
from realsim.gap.logs.runs import LEAST_SAMPLES
from realsim.gap.logs.split import split_runs
from realsim.gap.provenance import provenance
from realsim.gap.simulation.simulate import Simulator

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
    began, cpu, made_by = time.perf_counter(), time.process_time(), provenance(config)
    case = limited(case, config)
    # The matrices are too small for BLAS to gain from threads, and with one the sums have one order everywhere.
    with threadpool_limits(1, user_api="blas"), Simulator(case, config) as simulator:
        health = examine(simulator)
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, config)
        for name, at in comparison.parted.items():
            health["warnings"].append(f"{name}: robot and simulator part for good at {at:.1f} s; the rest is left out")
        simulator.onsets = find_onsets(comparison, nominal)
        fitted, held = split_runs(case, config, mean_gaps(comparison, nominal))
        tick("sensitivities", 0.0)
        screen = Screen(simulator, comparison, fitted, config.effects, tick)
        fitter = Fitter(screen)
        selection = select(screen, fitter, config, tick)
        tick("unseen runs", 0.9)
        shrunk = _checked(config, screen, selection, held)
        if (
            selection.fit.causes
            and _harms(shrunk)
            and judge(config, screen, selection, shrunk).verdict == "unexplained"
        ):
            selection = without_causes(selection)
            shrunk = _checked(config, screen, selection, held)
        found = _assemble(case, config, simulator, comparison, screen, selection, shrunk, nominal, health)
        cost = {
            "seconds": round(time.perf_counter() - began, 2),
            "cpu_seconds": round(time.process_time() - cpu, 2),
            "simulated_seconds": round(simulator.simulated_seconds, 1),
        }
        statistics = found.statistics | {
            **cost,
            "logged_seconds": round(sum(r.duration for r in case.runs), 2),
            "fits": fitter.evaluations,
        }
        tick("next experiment", 0.98)
        choices = first_choices(screen, selection) if config.baselines else {}
        rivals = [selection.fit, *selection.equivalent] if found.equivalent else []
        asked = propose(simulator, comparison.noise, rivals, config)
    return replace(
        found,
        sentence=with_text(found.sentence, asked),
        statistics=statistics,
        cost=cost,
        baselines=choices,
        provenance=made_by,
        next_experiment=asked,
    )


def _checked(config: DiagnoseConfig, screen: Screen, selection: Selection, held: list[int]) -> Shrinkage:
    """What becomes of the gap on the runs held out, or on the fitted ones where there is none to spare."""
    comparison = screen.comparison
    rivals = rival_settings(screen, comparison, selection) if config.baselines else {}
    return shrinkage(
        screen, comparison, selection.nominal, selection.fit, held or screen.runs, bool(held),
        config.bootstrap, config.seed, rivals,
    )  # fmt: skip


def _harms(shrunk: Shrinkage) -> bool:
    """Whether the causes make an unseen run worse, with the best small deviations beside them."""
    return shrunk.unseen and shrunk.after_over_floor > shrunk.before_over_floor


def limited(case: Case, config: DiagnoseConfig) -> Case:
    """At most max_runs runs of at most max_seconds each; what is left out is said."""
    notes = []
    runs = list(case.runs)
    if len(runs) > config.max_runs:
        added = [r for r in runs if r.name in case.added]
        others = [r for r in runs if r.name not in case.added]
        room = max(config.max_runs - len(added), 1)
        keep = sorted({round(i) for i in np.linspace(0, len(others) - 1, room)}) if others else []
        notes.append(f"{len(runs)} runs: {len(keep) + len(added)} of them, evenly spread, are used")
        runs = [*(others[i] for i in keep), *added]
    long = [r.name for r in runs if r.duration > config.max_seconds + 0.5]
    if long:
        notes.append(f"{len(long)} runs are longer than {config.max_seconds:g} s: their beginning is used")
        cut = [r.where(r.time <= config.max_seconds) for r in runs]
        few = [r.name for r in cut if len(r.time) < LEAST_SAMPLES]
        notes += [f"left out: {name} has less than {LEAST_SAMPLES} samples until then" for name in few]
        runs = [r for r in cut if r.name not in few]
    if not runs:
        raise GapError(
            "the runs are too short",
            file=case.folder,
            expected=f"at least {LEAST_SAMPLES} samples in the first {config.max_seconds:g} s",
            hint="raise max_seconds (--max-seconds)",
        )
    return case.with_runs(tuple(runs), *notes)


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
    judgement = judge(config, screen, selection, shrunk)
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
        sentence=sentence(judgement, causes, equivalent, shrunk, where, case),
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
            "per_horizon": change_by_horizon(simulator, fit.settings(), shrunk.runs),
            "baselines": shrunk.baselines,
        },
        unexplained_share=judgement.unexplained,
        patch=make_patch(simulator, fit) if causes else empty_patch(),
        ranking=tuple(ranked_effects(selection, screen)),
        health=health,
        statistics={
            "gap_over_floor": shrunk.before_over_floor,
            "left_over_floor": shrunk.after_over_floor,
            "structure_left": shrunk.structure,
            "by_signal": by_signal(comparison, shares),
            **evidence(simulator, comparison, residuals, config.seed),
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
