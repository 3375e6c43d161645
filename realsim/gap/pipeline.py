"""From a case to a diagnosis: split, simulate, search on the fitted runs, check on the others, say it."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.arrays import collect
from realsim.gap.answer.conclusion import Conclusion, conclude
from realsim.gap.answer.diagnosis import Diagnosis, describe_set, ranked_effects
from realsim.gap.answer.patch import empty_patch, make_patch
from realsim.gap.answer.sentence import CUT_SHORT, advice, sentence
from realsim.gap.answer.stays import what_stays
from realsim.gap.case.case import Case
from realsim.gap.case.health import examine
from realsim.gap.case.runs import LEAST_SAMPLES, Run, find_gaps
from realsim.gap.case.split import split_runs
from realsim.gap.case.stuck import without_stuck
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS
from realsim.gap.experiments.proposal import propose, with_text
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.causes.fitted import at_an_end
from realsim.gap.inference.causes.select import Selection, select
from realsim.gap.inference.evidence.onsets import find_onsets
from realsim.gap.inference.evidence.where import by_horizon, by_signal, evidence, localise
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.free_starts import free_starts
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.provenance import provenance
from realsim.gap.simulation.simulate import OutOfTime, Simulator
from realsim.gap.verdicts import GapVerdict

Progress = Callable[[str, float], None]
LIES, WAITING, FLIGHT, GRAVITY = 0.5, 0.25, 1.0, 9.81
"""Share of its usual thrust below which a drone that does not fall lies on the ground, s before and after in which it
would, the shortest flight, s, and m/s2. Not tuned; two Crazyflies on the ground give a fiftieth."""

SEARCHING = 0.85
"""Share of the time limit after which a search ends; what is left is for the answer. Not tuned."""
STRETCH = 0.5
"""s that a stretch between gaps must last: a run's first state is judged by 0.3 s of it. Not tuned."""


def diagnose(case: Case, config: DiagnoseConfig | None = None, progress: Progress | None = None) -> Diagnosis:
    """Where the gap lies, which effects cause it, and how far it shrinks on runs that nothing was fitted to.

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
        EFFECTS[name]  # an unknown name is refused with the closest ones
    began, cpu, made_by = time.perf_counter(), time.process_time(), provenance(config)
    case = limited(case, config)
    fitted, held = split_runs(case, config)
    # The matrices are too small for BLAS to gain from threads, and with one the sums have one order everywhere.
    with threadpool_limits(1, user_api="blas"), Simulator(case, config, fitted) as simulator:
        health = examine(simulator)
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, config, fitted)
        free_starts(simulator, comparison)
        for name, at in comparison.parted.items():
            health["warnings"].append(f"{name}: robot and simulator diverge at {at:.1f} s; the rest is left out")
        tick("sensitivities", 0.0)
        end = began + 60 * SEARCHING * config.time_limit
        simulator.stop_after(end - time.perf_counter())
        screen = Screen(simulator, comparison, fitted, config.effects, tick)
        selection = select(Fitter.of(screen, find_onsets(comparison, nominal, fitted)), config, tick)
        tick("unseen runs", 0.9)
        simulator.stop_after(end - time.perf_counter() if not selection.cut_short else np.inf)
        try:
            concluded = conclude(config, selection, held, nominal)
        except OutOfTime:
            simulator.stop_after(np.inf)  # what a search that was cut short comes to takes little
            selection.cut_short = True
            concluded = conclude(config, selection, held, nominal)
        simulator.stop_after(np.inf)
        found = _assemble(config, screen, selection, concluded, nominal, health)
        cost = {
            "seconds": round(time.perf_counter() - began, 2),
            "cpu_seconds": round(time.process_time() - cpu, 2),
            "simulated_seconds": round(simulator.simulated_seconds, 1),
        }
        statistics = found.statistics | {
            **cost,
            "logged_seconds": round(sum(r.duration for r in case.runs), 2),
            "fits": selection.fitter.evaluations,
        }
        tick("next experiment", 0.98)
        rivals = [concluded.fit, *concluded.equivalent] if found.equivalent else []
        proposal = propose(simulator, comparison.noise, rivals, config)
    return replace(
        found,
        advice=with_text(found.advice, proposal),
        statistics=statistics,
        cost=cost,
        provenance=made_by,
        next_experiment=proposal,
    )


def limited(case: Case, config: DiagnoseConfig) -> Case:
    """At most max_runs runs of at most max_seconds each, and no stuck joint; what is left out is noted."""
    case = without_stuck(case)
    usual = figures.WALKED if case.floating and case.joint_names else figures.LONGEST
    notes, seconds = [], usual if config.max_seconds is None else config.max_seconds
    parts = {run.name: unbroken(case, run) for run in case.runs}
    if broken := [run for run in case.runs if parts[run.name] != [run]]:
        steps = np.concatenate([np.diff(run.time)[np.array(find_gaps(run.time)) - 1] for run in broken])
        kept = sum(p.duration for run in broken for p in parts[run.name]) / sum(run.duration for run in broken)
        notes.append(
            f"{len(steps)} gaps in time in {len(broken)} runs, the longest {steps.max():.2g} s: each stretch between "
            f"them is a run ({kept:.0%} of these runs)"
        )
    later = tuple(part.name for name in case.added for part in parts[name])
    case = replace(case, runs=tuple(part for of in parts.values() for part in of), added=later)
    runs = [part for run in case.runs for part in aloft(case, run)]
    if [r.name for r in runs] != [r.name for r in case.runs]:
        notes.append("where the robot lies on the ground, which its model falls through, its runs are cut")
    if len(runs) > config.max_runs:
        added = [r for r in runs if r.name in case.added]
        others = [r for r in runs if r.name not in case.added]
        room = max(config.max_runs - len(added), 1)
        keep = sorted({round(i) for i in np.linspace(0, len(others) - 1, room)}) if others else []
        notes.append(f"{len(runs)} runs: {len(keep) + len(added)} of them, evenly spread, are used")
        runs = [*(others[i] for i in keep), *added]
    long = [r.name for r in runs if r.duration > seconds + 0.5]
    if long:
        notes.append(f"{len(long)} runs are longer than {seconds:g} s: their beginning is used")
        cut, late = [], []
        for run in runs:
            begin = _stirs(run) if run.name in long else 0.0
            late += [f"{run.name} from {begin:.1f} s"] if begin else []
            cut.append(run.part((run.time >= begin) & (run.time <= begin + seconds)))
        if late:
            notes.append(f"where their commands never change before, the part from then on: {', '.join(late)}")
        few = [r.name for r in cut if len(r.time) < LEAST_SAMPLES]
        notes += [f"left out: {name} has less than {LEAST_SAMPLES} samples until then" for name in few]
        runs = [r for r in cut if r.name not in few]
    if not runs:
        raise GapError(
            "the runs are too short",
            file=case.folder,
            expected=f"at least {LEAST_SAMPLES} samples in the first {seconds:g} s",
            hint="raise max_seconds (--max-seconds)",
        )
    return case.with_runs(tuple(runs), *notes)


def unbroken(case: Case, run: Run) -> list[Run]:
    """The stretches of a run between gaps in its clock; of a floating robot whose base is not logged only the first, as
    nothing tells where the others begin. The run itself where none lasts as long as a first state is judged by."""
    parts = run.stretches(STRETCH)
    unknown = case.floating and "base_pos" not in run.signals
    return (parts[:1] if unknown else parts) or [run]


def aloft(case: Case, run: Run) -> list[Run]:
    """Stretches of a run in which a robot without joints is in the air: it lies where it gives less than half of its
    usual thrust and does not fall. The run itself where that is all of it, or none."""
    place, push = run.signals.get("base_pos"), np.abs(run.command).sum(axis=1)
    if case.joint_names or not case.floating or place is None or not push.any():
        return [run]
    known = np.isfinite(place[:, 2])
    if not known.any():
        return [run]
    before, now, after = (
        np.interp(run.time + late, run.time[known], place[known, 2]) for late in (-WAITING, 0.0, WAITING)
    )
    falling = 2 * now - before - after > 0.5 * (1 - LIES) * GRAVITY * WAITING**2
    usual = float(np.median(push[push > LIES * push.max()]))
    edges = np.flatnonzero(np.diff(falling | (push >= LIES * usual), prepend=False, append=False)).reshape(-1, 2)
    long = [(b, e) for b, e in edges if run.time[e - 1] - run.time[b] > FLIGHT]
    if not long or long == [(0, len(run.time))]:
        return [run]
    return [replace(run.part(slice(*ends)), name=f"{run.name}_{k}") for k, ends in enumerate(long, 1)]


def _stirs(run: Run) -> float:
    """Seconds at which a run's commands first change, less one in which it shows how it rests."""
    changed = (run.command != run.command[0]).any(axis=1)
    return max(float(run.time[np.argmax(changed)]) - 1.0, 0.0)


def _assemble(
    config: DiagnoseConfig,
    screen: Screen,
    selection: Selection,
    concluded: Conclusion,
    nominal: Sequence[F64],
    health: dict[str, Any],
) -> Diagnosis:
    simulator, comparison, case = screen.simulator, screen.comparison, screen.simulator.case
    fit, checked, judgement = concluded.fit, concluded.check, concluded.judgement
    runs = list(range(len(case.runs)))
    residuals = [comparison.residual(i, nominal[i]) for i in runs]
    where, shares = localise(comparison, residuals, runs, simulator.nominal_tracks)
    gains = selection.gains if fit.causes is selection.fit.causes else {}
    # What is at an end of its range only imitates something: what is not goes before it.
    order = sorted(range(len(fit.causes)), key=lambda i: (bool(at_an_end(fit.causes[i])), -gains.get(i, 0.0)))
    gap = judgement.verdict is not GapVerdict.NO_GAP
    causes = describe_set(fit, order, concluded.sigmas) if gap else []
    equivalent = [tuple(describe_set(other)) for other in (concluded.equivalent if causes else ())]
    looks_like = what_stays(simulator, comparison, fit, runs) if gap else []
    lead = describe_set(concluded.lead)[0] if concluded.lead else None
    text = sentence(judgement, causes, equivalent, checked, where, looks_like, case, lead, screen.cut_short)
    todo = advice(judgement, causes, equivalent, where, case, lead)
    if selection.cut_short:
        text, todo = f"{text} {CUT_SHORT}", f"give the search more time (--time-limit), or {todo}"
    health["warnings"] += concluded.warnings
    of_check = [i for i, run in enumerate(case.runs) if run.name in checked.runs]
    arrays = collect(simulator, comparison, residuals, shares, of_check, fit)
    return Diagnosis(
        verdict=judgement.verdict,
        sentence=text,
        advice=todo,
        causes=tuple(causes),
        equivalent=tuple(equivalent),
        where=tuple(where),
        shrinkage={
            "before": 1.0,
            "after": 1 - checked.fraction,
            "fraction": checked.fraction,
            "ci90": list(checked.ci90),
            "beside_deviations": list(checked.beside90) if checked.beside90 and checked.ci90[0] <= 0 else None,
            "above_floor": checked.above_floor,
            "where_it_acts": checked.where_it_acts,
            "horizons": None if checked.horizons is None else asdict(checked.horizons),
            "runs": list(checked.runs),
            "unseen": checked.unseen,
            "kind": checked.kind,
            "per_signal": checked.signals,
            "per_horizon": by_horizon(arrays.shots),
        },
        unexplained_share=checked.unexplained if gap else 0.0,
        looks_like=tuple(looks_like),
        lead=lead,
        patch=make_patch(simulator, fit.settings(), fit.conditions.onsets) if causes else empty_patch(),
        ranking=tuple(ranked_effects(selection, screen)),
        health=health,
        statistics={
            "gap_over_floor": checked.before,
            "left_over_floor": checked.beside,
            "by_signal": by_signal(comparison, shares),
            **evidence(simulator, comparison, residuals, config.seed),
            "atoms": len(screen.atoms),
            "candidates": len(screen.candidates),
            "fitted_runs": [case.runs[i].name for i in screen.runs],
            "left_out_over_floor": None if concluded.left_out is None else concluded.left_out.after.tolist(),
            "cut_short": selection.cut_short,
            "reasons": list(judgement.reasons),
            "notes": list(concluded.notes),
        },
        evidence=arrays,
    )
