"""Effects and nuisances by name."""

from __future__ import annotations

from realsim.gap.effects import EFFECTS
from realsim.gap.effects.base import Effect
from realsim.gap.effects.nuisances import NUISANCES


def lookup(name: str) -> Effect:
    """An effect of the library, or one of the nuisances."""
    return NUISANCES[name] if name in NUISANCES else EFFECTS[name]
