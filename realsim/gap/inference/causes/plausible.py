"""Whether a cause has a size that a robot like the model could have: beyond it, a cause imitates another one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from realsim.gap import figures
from realsim.gap.effects.base import Parameter
from realsim.gap.inference.causes.fitted import Cause


def implausible(causes: Sequence[Cause]) -> list[str]:
    """One sentence for each value that is larger than the model's own figures make plausible."""
    found = []
    for cause in causes:
        for p, value in zip(cause.candidate.parameters, cause.values, strict=True):
            most, of_what = _most(p)
            if abs(value) > most:
                name = f"{cause.candidate.effect} {', '.join(cause.candidate.place)}".strip()
                size = f"{p.name} {p.report(value):.3g} {p.unit}"
                found.append(f"{name}: {size} is more than {of_what}, so it imitates something")
    return found


def _most(p: Parameter) -> tuple[float, str]:
    """(largest plausible size of a parameter's coordinate, what that is in words); infinite where nothing says so."""
    if p.logarithmic:
        return float(np.log(figures.RATIO)), f"{figures.RATIO:g} times more or less than in the model"
    return p.plausible
