"""`next_experiment` of a diagnosis."""

from __future__ import annotations

from typing import Any

from realsim.gap.answer.diagnosis import describe_set
from realsim.gap.answer.sentence import phrase
from realsim.gap.causes.fitted import Fit
from realsim.gap.experiments.rivals import Rival, rival_of
from realsim.gap.simulation.simulate import Simulator


def rivals_of(simulator: Simulator, fits: list[Fit]) -> tuple[Rival, ...]:
    """Fits that explain the runs equally well as rivals, the first the best."""
    found = []
    for fit in fits:
        order = list(range(len(fit.causes)))
        said = "; ".join(phrase(c) for c in describe_set(simulator, fit, order, [0.5] * len(order)))
        found.append(rival_of(fit, said))
    return tuple(found)


def propose(simulator: Simulator, fits: list[Fit]) -> dict[str, Any]:
    """`next_experiment` of a diagnosis whose rivals are these fits."""
    return {"rivals": [r.as_dict() for r in rivals_of(simulator, fits)]}
