"""What a fit depends on beside its causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from realsim.core.types import F64
from realsim.gap.inference.likelihood.comparison import Weights


@dataclass(frozen=True, eq=False)
class Conditions:
    """Two fits compare where these are the same."""

    about: F64
    """(p,) nuisance parameters that every simulation contains; the others are linear about them."""
    weights: Weights
    onsets: Mapping[str, float] = field(default_factory=dict)
    """Run -> seconds at which something sudden begins there; see realsim.gap.inference.evidence.onsets."""
    gap: bool = False
    """Whether everyday deviations alone leave a gap; the search finds out."""
