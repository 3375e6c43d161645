"""From a case to an answer by the experimental selection: `python -m realsim.gap.selection.engine CASE`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from realsim.errors import GapError, RealsimError
from realsim.gap.answer.diagnosis import describe_cause
from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.config import DiagnoseConfig
from realsim.gap.evidence.onsets import find_onsets
from realsim.gap.logs.case import Case, load_case
from realsim.gap.logs.split import split_runs
from realsim.gap.selection.figures import LINEARISATIONS
from realsim.gap.selection.fitting import Fit, Fitter
from realsim.gap.selection.likelihood import Likelihood
from realsim.gap.selection.select import Tick, select
from realsim.gap.selection.verdict import Check, judge
from realsim.gap.simulation.simulate import Setting, Simulator, lookup
from realsim.types import F64


def answer(case: Case, config: DiagnoseConfig, tick: Tick = lambda what, share: None) -> dict[str, Any]:
    """Verdict, causes and the check on the run that is held out, as plain data."""
    began = time.process_time()
    with threadpool_limits(1, user_api="blas"), Simulator(case, config) as simulator:
        nominal = simulator.simulate()
        fitted, held = split_runs(case, config)
        comparison = Comparison(case, simulator.channels, nominal, config, fitted)
        simulator.onsets = find_onsets(comparison, nominal, fitted)
        screen = Screen(simulator, comparison, fitted, config.effects, tick)
        fitter, rough = fitters(screen)
        posterior = select(fitter, rough, config.max_causes, tick=tick)
        for _ in range(LINEARISATIONS):
            best = posterior.fits[0]
            if not best.causes:
                break
            screen.look_from(best.settings())  # a robot that moves otherwise answers otherwise
            fitter, rough = fitters(screen)
            posterior = select(fitter, rough, config.max_causes, posterior.fits, tick)
            if posterior.fits[0].named == best.named:
                break
        best = posterior.fits[0]
        checks = check(screen, best, held or fitted, nominal)
        judgement = judge(posterior, checks, ends(fitter, best))
        causes = described(simulator, best, judgement.probabilities)
        equivalent = [described(simulator, f, judgement.probabilities) for f in judgement.alternatives]
        return {
            "verdict": str(judgement.verdict),
            "causes": causes,
            "equivalent": equivalent,
            "check": {
                "runs": [case.runs[i].name for i in held or fitted],
                "unseen": bool(held),
                "signals": [vars(c) for c in checks],
                "removed": judgement.removed,
                "stays_over_floor": judgement.stays,
            },
            "reason": judgement.reason,
            "posterior": [
                {"set": sorted(f"{e}@{','.join(p)}" for e, p in f.named), "probability": p, "evidence": f.evidence}
                for f, p in zip(posterior.fits[:8], posterior.probabilities, strict=False)
            ],
            "trace": posterior.log,
            "evaluations": [fitter.evaluations, rough.evaluations],
            "cpu_seconds": round(time.process_time() - began, 2),
            "simulated_seconds": round(simulator.simulated_seconds, 1),
        }


def fitters(screen: Screen) -> tuple[Fitter, Fitter]:
    """On all fitted runs, and on a few of them for rough searches."""
    fitter = Fitter(screen, Likelihood(screen, screen.comparison))
    few = screen.varied
    return fitter, fitter if few is None else Fitter(screen, Likelihood(screen, screen.comparison, few))


def check(screen: Screen, fit: Fit, runs: Sequence[int], nominal: Sequence[F64]) -> list[Check]:
    """Errors before and after by signal, with the deviations that the fitted runs made most probable."""
    comparison = screen.comparison
    with_all = [*fit.settings(), *_deviations(screen, fit)]
    try:
        after = screen.simulator.simulate(with_all, runs)
    except GapError:
        after = screen.simulator.simulate(fit.settings(), runs)
    found = []
    for signal in dict.fromkeys(c.signal for c in comparison.channels):
        columns = [i for i, c in enumerate(comparison.channels) if c.signal == signal]

        def rms(arrays: Sequence[F64], columns: list[int] = columns) -> float:
            return float(np.sqrt(np.nanmean(np.concatenate([a[:, columns] for a in arrays]) ** 2)))

        motion = [comparison.change(r, nominal[r], nominal[r].mean(axis=0, keepdims=True)) for r in runs]
        found.append(
            Check(
                signal,
                rms(motion),
                rms([comparison.residual(r, nominal[r]) for r in runs]),
                rms([comparison.residual(r, y) for r, y in zip(runs, after, strict=True)]),
                rms([np.sqrt(comparison.floor(r)) for r in runs]),
            )
        )
    return found


def _deviations(screen: Screen, fit: Fit) -> list[Setting]:
    x = fit.marginal.x
    return screen.settings(screen.possible(np.where(np.abs(x) > 0.02 * screen.prior, x, 0.0)))


def ends(fitter: Fitter, fit: Fit) -> tuple[str, ...]:
    """Strengths at an end of their range."""
    strengths = {p.name for p in fitter.parameters([c.candidate for c in fit.causes]) if p.strength}
    return tuple(n for n in fit.at_bounds if n in strengths)


def described(simulator: Simulator, fit: Fit, probabilities: dict[Any, float]) -> list[dict[str, Any]]:
    """The causes in the contract's form, the largest in prior standard deviations first."""
    sigmas = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    found, i = [], 0
    for cause in fit.causes:
        n = len(cause.values)
        p = probabilities.get((cause.candidate.effect, cause.candidate.place), 0.0)
        parameters = lookup(cause.candidate.effect).parameters(simulator.context, cause.candidate.place)
        steps = {q.name: abs(q.step) for q in parameters if q.strength}
        size = max((abs(v) / steps[n] for n, v in cause.named.items() if n in steps), default=0.0)
        found.append((p, size, describe_cause(simulator, cause, sigmas[i : i + n], p)))
        i += n
    return [d for _, _, d in sorted(found, key=lambda f: (-round(f[0], 2), -f[1]))]


def main() -> int:
    for folder in sys.argv[1:]:
        try:
            found = answer(load_case(Path(folder)), DiagnoseConfig(threads=1))
        except RealsimError as error:
            print(error, file=sys.stderr)
            return 2
        print(json.dumps({"case": folder, **found}, indent=1, default=float))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
