"""`next_experiment` of a diagnosis: which recording would tell its rivals apart."""

from collections.abc import Mapping, Sequence
from typing import Any

from realsim.core.errors import GapError
from realsim.gap.answer.diagnosis import describe_set
from realsim.gap.answer.sentence import phrase
from realsim.gap.case.model.context import Context
from realsim.gap.config import DiagnoseConfig, ExciteConfig
from realsim.gap.experiments.choose import FINALISTS, Looked, look
from realsim.gap.experiments.limits import limits_of
from realsim.gap.experiments.plan import rig_of
from realsim.gap.experiments.rivals import Rival, rival_of
from realsim.gap.experiments.separation import Bench
from realsim.gap.inference.causes.fitted import Fit
from realsim.gap.inference.likelihood.comparison import Noise
from realsim.gap.simulation.simulate import Simulator

TELLS = "to tell them apart, record "
"""How the advice of an ambiguous verdict begins (realsim.gap.answer.sentence)."""
MOST_FREEDOM = 8
"""Degrees of freedom up to which a diagnosis simulates everyday deviations for its proposal; beyond, that takes
minutes, and `realsim excite` does it."""


def bench_of(context: Context, noise: Noise, config: ExciteConfig, diagnose: DiagnoseConfig) -> Bench:
    """Where experiments of a case are tried."""
    rig = rig_of(context, config.seconds, config.seed)
    return Bench(rig, noise, limits_of(context, config.max_speed, config.max_torque), diagnose)


def propose(simulator: Simulator, noise: Noise, fits: Sequence[Fit], config: DiagnoseConfig) -> dict[str, Any] | None:
    """`next_experiment` of a diagnosis whose rivals are these fits; None with fewer than two."""
    rivals = tuple(rival_of(fit, "; ".join(phrase(c) for c in describe_set(fit))) for fit in fits)
    if len(rivals) < 2:
        return None
    finalists = FINALISTS if simulator.case.model.nv <= MOST_FREEDOM else 0
    try:
        bench = bench_of(simulator.context_of_all_runs(), noise, ExciteConfig(), config)
        looked = look(bench, rivals, finalists=finalists)
    except GapError as error:  # a log that no command file can be planned from
        return {"text": f"no experiment was planned: {error.message}", "decides": False,
                "rivals": [r.as_dict() for r in rivals]}  # fmt: skip
    return described(looked, rivals)


def with_text(advice: str, proposal: Mapping[str, Any] | None) -> str:
    """The advice of an ambiguous verdict with the experiment in place of a kind of signal."""
    if proposal is None or not advice.startswith(TELLS):
        return advice
    return f"{TELLS}{proposal['text']} (realsim excite)" if proposal.get("excitation") else str(proposal["text"])


def described(looked: Sequence[Looked], rivals: Sequence[Rival]) -> dict[str, Any]:
    """The contract's `next_experiment`."""
    best = looked[0]
    found: dict[str, Any] = {
        "text": text(looked, len(rivals)),
        "excitation": best.name if best.helps else None,
        "decides": best.decides,
        "expected_posterior": round(best.posterior, 3),
        "expected_log_bayes_factor": round(best.worst / 2, 2),
    }
    if best.helps and best.predicted is not None:
        experiment = best.predicted.experiment
        found |= {"seconds": round(experiment.seconds, 1), "instructions": list(experiment.instructions)}
    found["looked_at"] = [
        {
            "excitation": one.name,
            "size": one.size,
            "expected_posterior": round(one.posterior, 3),
            "expected_log_bayes_factor": round(one.worst / 2, 2),
            "everyday_deviations": one.with_deviations,
            "refused": one.refused or None,
        }
        for one in looked
    ]
    found["rivals"] = [r.as_dict() for r in rivals]
    return found


def text(looked: Sequence[Looked], count: int) -> str:
    """What to record, in a sentence."""
    best = looked[0]
    if best.predicted is None:
        return "every excitation of the library leaves the robot's limits under one of the rivals"
    if not best.helps:
        return (
            "no excitation of the library tells these apart with the signals that are logged; log others too (joint "
            "torque, an IMU, the pose of the base)"
        )
    experiment = best.predicted.experiment
    start = f"{experiment.title}, {len(experiment.runs)} runs of {experiment.runs[0].time[-1]:.0f} s"
    if best.decides:
        return f"{start}: the true one of {count} rivals may then expect a probability of {best.posterior:.2f}"
    return f"{start}: the best of the library, which may not decide (expected probability {best.posterior:.2f})"
